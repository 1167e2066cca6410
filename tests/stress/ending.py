"""Where a rollout ended, and why there.

reached     every task within its tolerance
blocked     loops or limits of place, by name, leave no motion along the tasks that are missed
at rest     short of the goal, at a singular pose or between tasks that ask for different things
moving      the tasks still get nearer when its time is up, or follow a twist
recovering  a joint is still outside its limits
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np

from coopqp.assessment.thresholds import AT_LIMIT, within
from coopqp.base.rank import null_space
from coopqp.base.spec import Array
from coopqp.controller import ControlProblem, Law
from coopqp.controllers import QPController
from coopqp.kernel.law import KernelLaw
from coopqp.model.state import State
from coopqp.qp_law.bounds import Bounds
from coopqp.solver import written
from coopqp.study.explanation import explain
from coopqp.study.tick_record import record_tick
from coopqp.task import TaskStack

from . import signs
from .signs import Record

INWARD = 1e-4  # a joint that could come back faster than this must [rad/s, m/s]
SINGULAR = 0.05  # least motion of the object for a unit of joint motion [m/rad]
OF_SPEED = ("limit.velocity", "limit.acceleration", "limit.object_speed")
BEFORE, CHANGE = 50, 0.01  # a task whose error changes by less in so many ticks has come to rest
OUTCOMES = ("reached", "blocked", "at rest", "moving", "recovering")


@dataclass(frozen=True)
class Ending:
    """How a rollout ended: one of ``OUTCOMES``, and what blocked it, or why it rests.

    Attributes:
        frozen: it stands still, and nothing that has a name is in its way.
        never_back: a joint is outside though it could come back.
    """

    outcome: str
    reason: str = ""
    frozen: bool = False
    never_back: bool = False


class PartErrors:
    """Error of each part of each task over its tolerance.

    Args:
        problem: with the tasks.
        start: the state from which their references set out; the chain's when omitted.
    """

    def __init__(self, problem: ControlProblem, start: State | None = None) -> None:
        self._problem = problem
        self._seen, self._found = -1, np.zeros(0)  # after how many ticks what was found
        self._tasks = TaskStack(problem.tasks, start or State(problem.chain))
        parts = [(task, part) for task in problem.tasks for part in task.parts(problem.chain)]
        ends = itertools.accumulate((part.rows for _, part in parts), initial=0)
        self._parts = [
            (slice(a, b), part.tolerance, task.asks_velocity)
            for (task, part), (a, b) in zip(parts, itertools.pairwise(ends), strict=True)
        ]

    def at_end(self, state: State, record: Record) -> Array:
        """Of a rollout whose state is up to date."""
        if self._seen != len(record.v):
            self._seen, self._found = len(record.v), self._errors(state, record.v[-1])
        return self._found

    def before(self, state: State, record: Record) -> Array:
        """Of a rollout, some ticks before its end."""
        t = state.t - BEFORE * self._problem.dt
        return self._errors(
            State(self._problem.chain, record.q[-1 - BEFORE], t), record.v[-1 - BEFORE]
        )

    def stack(self, state: State) -> TaskStack:
        """The tasks at a state."""
        self._tasks.update(state)
        return self._tasks

    def _errors(self, state: State, v: Array) -> Array:
        tasks, errors = self.stack(state), list[float]()
        for rows, tolerance, asks_velocity in self._parts:
            error = tasks.J[rows] @ v - tasks.rate[rows] if asks_velocity else tasks.e[rows]
            errors.append(math.sqrt(error.dot(error)) / tolerance)
        return np.array(errors)


def ending(law: Law, state: State, record: Record, errors: PartErrors) -> Ending:
    """Judge the end of a rollout, with the state where it ended."""
    problem, said = law.problem, written(record.causes[-1])
    stands = problem.on_infeasible != "scale" and not record.causes[-1][0].usable
    asked = Ending("blocked", f"on_infeasible: {problem.on_infeasible}, {said}")
    outside, missed = signs.outside(record) > signs.EXCESS, errors.at_end(state, record)
    if not outside and within(float(missed.max()), 1.0):
        return Ending("reached")
    if stands and problem.on_infeasible == "stop":
        return asked
    if outside:
        way = limit_recovery(problem, state)
        stuck = way > INWARD and signs.at_rest(record)
        return Ending("recovering", f"could come back at {way:.2g} rad/s", never_back=stuck)
    if stands:
        return asked
    rests = signs.at_rest(record)
    if signs.held_up(record) and rests:
        return Ending("at rest", said, frozen=True)
    change = np.abs(missed - errors.before(state, record)).max() if not rests else 0.0
    if change > CHANGE * missed.max():
        speed = signs.slowest(record)
        return Ending("moving", f"moving at {speed:.2g} of the speed limits, {said}")
    return _rest(law, state, record, errors)


def _rest(law: Law, state: State, record: Record, errors: PartErrors) -> Ending:
    """Why the tasks rest short of the goal; a speed limit blocks nobody who stands still."""
    problem, tasks = law.problem, errors.stack(state)
    plain = law.plain if isinstance(law, KernelLaw) else QPController().plain(problem)
    tick = record_tick(plain, state, scenario="random", controller="qp", tick=0, by=law)
    why = explain(tick)
    limits = [r.name for r in why.relaxations]
    names = [name for name in limits if not name.startswith(OF_SPEED)]
    names += [f"loops|{name}" for name in why.impossible]
    if names:
        return Ending("blocked", ", ".join(names))
    held = _at_limits(problem, state)
    if _near_singular(tasks.J, state, list(held)):
        return Ending("at rest", ", ".join(["singular pose", *held.values()]))
    if limits:
        return Ending("at rest" if signs.at_rest(record) else "blocked", ", ".join(limits))
    return Ending("at rest", why.sentence, frozen=signs.slowest(record) < signs.STILL)


def limit_recovery(problem: ControlProblem, state: State) -> float:
    """Fastest way inward of a joint outside, that loops and limits leave [rad/s, m/s].

    A linear program of its own, that knows nothing of the QP law: most sum of inward speeds.
    """
    from scipy.optimize import linprog  # which takes a sixth of a second to come

    chain = problem.chain
    kept = [limit for limit in problem.limits if not limit.sacrificed_first]
    bounds = Bounds(kept, State(chain), problem.dt)
    bounds.update(state)
    inward = (state.q < chain.lower).astype(float) - (state.q > chain.upper)
    found = linprog(
        -inward,
        A_ub=bounds.G if len(bounds.G) else None,
        b_ub=np.maximum(bounds.h, 0.0) if len(bounds.G) else None,
        A_eq=state.J_loop,
        b_eq=np.zeros(len(state.J_loop)),
        bounds=list(zip(bounds.lb, bounds.ub, strict=True)),
    )
    return float((inward * found.x).max()) if found.success else 0.0


def _at_limits(problem: ControlProblem, state: State) -> dict[int, str]:
    """Joints that rest at a position limit, with the limit's name."""
    chain = problem.chain
    margin = max((getattr(limit, "margin", 0.0) for limit in problem.limits), default=0.0)
    low, high = state.q - chain.lower < margin + AT_LIMIT, chain.upper - state.q < margin + AT_LIMIT
    names = chain.joint_names
    lowest = {i: f"limit.position[{names[i]}].lower" for i in np.flatnonzero(low).tolist()}
    highest = {i: f"limit.position[{names[i]}].upper" for i in np.flatnonzero(high).tolist()}
    return {**lowest, **highest}


def _near_singular(J: Array, state: State, held: list[int]) -> bool:
    """Whether loops and joints at their limits leave a direction of the tasks next to nothing."""
    locked = np.eye(J.shape[1])[held]
    free: Array = null_space(np.vstack([state.J_loop, locked]))
    values = np.linalg.svd(J @ free, compute_uv=False)
    return len(values) < len(J) or bool(values.min(initial=np.inf) < SINGULAR)
