"""Rows and answer of a tick, what held it back, and hard and scaled tasks not met in full.

In ticks in which the tasks were not followed, multipliers tell what held them back:

    minimise |Z' (J' W (wanted - J v) - sum mu_i n_i)|,   mu_i >= 0

with n_i the limits active in that tick, Z the motions that keep the loops closed. Of a run the
shares mu_i |Z' n_i| are summed over the ticks, each by |J v - wanted|.

A task that wants the rate w and gets u = J v gets the share 1 - |u - w| / max(|w|, |u - w|) of it,
that is s where u = s w.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from coopqp.assessment.thresholds import AT_LIMIT
from coopqp.base.qp import Row
from coopqp.base.rank import null_space
from coopqp.base.spec import Array
from coopqp.controller import Command, ControlProblem
from coopqp.model.state import State
from coopqp.qp_law.bounds import Bounds
from coopqp.qp_law.safety import drift_gain
from coopqp.solver import Status, causes_of
from coopqp.study.explanation.explained_phase import ExplainedPhase
from coopqp.study.explanation.room import PLACE_UNITS, Share, forces, shares
from coopqp.study.tick_record import NamedBounds, TickRecord
from coopqp.task import Mode, TaskStack

#: Number of ticks of a run that are evaluated at most; error from which one counts [m/s, rad/s].
TICKS, BEHIND = 150, 1e-3
#: A task that lacks more than this share of its rate counts, as does the one that lacks most.
WORTH_COUNTING = 0.02


@dataclass(frozen=True, kw_only=True)
class Asked:
    """A tick without its solver's program.

    Attributes:
        A, b: rows of the closed loops, A v = b.
        lb, ub, G, h: the limits, lb <= v <= ub and G v <= h.
        J, wanted, task_rows: rows of all tasks, J v = wanted.
        modes: soft, hard or scaled, by the task's name.
        v: the answer, followed by shares of scaled tasks if there are any.
        name_limits: finds ``limit_rows``, which few need.
    """

    causes: tuple[Status, ...]
    dt: float
    A: Array
    b: Array
    lb: Array
    ub: Array
    G: Array
    h: Array
    J: Array
    wanted: Array
    task_rows: Sequence[Row]
    modes: Mapping[str, Mode]
    v: Array
    name_limits: Callable[[], Sequence[Row]]

    @cached_property
    def slack(self) -> Array:
        """Slack of lb, ub and h at the answer."""
        return np.concatenate([self.v - self.lb, self.ub - self.v, self.h - self.G @ self.v])

    @cached_property
    def limit_rows(self) -> Sequence[Row]:
        """The limits that lb, ub and h come from, in this order."""
        return self.name_limits()

    def at_limits(self, near: float) -> list[tuple[Row, Array]]:
        """Limits with less slack than ``near``, each with the joint motion that violates it."""
        eye = np.eye(len(self.v))
        ways = np.vstack([-eye, eye, self.G])
        at = np.flatnonzero(self.slack < near).tolist()
        return [(self.limit_rows[i], ways[i]) for i in at]

    def forces(self, near: float, weights: Array | float = 1.0) -> list[tuple[Row, float]]:
        """Forces, :func:`forces`, of the limits with less slack than ``near``."""
        Z, missed = null_space(self.A), self.wanted - self.J @ self.v
        return forces(Z.T @ self.J.T @ (weights * missed), Z, self.at_limits(near))


def asked_then(record: TickRecord) -> Asked:
    """Of a saved tick; hard and scaled tasks are tasks here."""
    qp = record.qp()
    loops = [i for i, row in enumerate(record.equality_rows) if row.kind == "loop"]
    return Asked(
        causes=causes_of(record.status), dt=record.dt,
        A=qp.A[loops], b=qp.b[loops], lb=qp.lb, ub=qp.ub, G=qp.G, h=qp.h,
        J=np.array(record.J).reshape(-1, qp.n), wanted=np.array(record.wanted),
        task_rows=record.task_rows, modes=record.modes, v=np.array(record.answer),
        name_limits=lambda: [*record.lb_rows, *record.ub_rows, *record.inequality_rows],
    )  # fmt: skip


def asked_now(problem: ControlProblem, state: State, tasks: TaskStack, command: Command) -> Asked:
    """Of a tick at an updated state with its joints inside their limits, and updated tasks."""
    bounds = Bounds(problem.chain, problem.limits, state, problem.dt)
    bounds.update(state)
    causes, v = command.causes, command.v
    return _asked(
        problem, state, tasks, bounds, causes, v, lambda: NamedBounds(problem, state).rows
    )


def _asked(
    problem: ControlProblem,
    state: State,
    tasks: TaskStack,
    limits: Bounds | NamedBounds,
    causes: tuple[Status, ...],
    v: Array,
    name_limits: Callable[[], Sequence[Row]],
) -> Asked:
    return Asked(
        causes=causes, dt=problem.dt,
        A=state.J_loop, b=state.e_loop * -drift_gain(problem, state),
        lb=limits.lb, ub=limits.ub, G=limits.G, h=limits.h,
        J=tasks.J, wanted=tasks.wanted, task_rows=tasks.rows,
        modes={task.name: task.mode for task in problem.tasks}, v=v, name_limits=name_limits,
    )  # fmt: skip


class TickBatch:
    """The ticks of a phase whose law commands velocities, evaluated again one by one.

    ``state`` and ``stack`` of tasks are those of the last one.
    """

    def __init__(self, leg: ExplainedPhase) -> None:
        self._leg, problem = leg, leg.problem
        self.state = State(problem.chain)
        self.stack = TaskStack(problem.tasks, State(problem.chain))

    def look(self, k: int) -> Array:
        """Evaluate tick k; what its tasks missed, wanted - J v."""
        state, leg = self.state, self._leg
        state.q[:], state.t = leg.q[k], k * leg.problem.dt
        state.v[:] = leg.v[k - 1] if k else 0.0
        state.inputs = leg.followed(k)
        state.update()
        self.stack.update(state)
        return np.asarray(self.stack.wanted - self.stack.J @ leg.v[k], float)

    @cached_property
    def _limits(self) -> NamedBounds:
        return NamedBounds(self._leg.problem, self.state)

    def forces(self, k: int) -> list[tuple[Row, float]]:
        """What held tick k back, each limit with its force; their sum is what was missed."""
        missed, leg, limits = self.look(k), self._leg, self._limits
        if np.abs(missed).max(initial=0.0) <= BEHIND:
            return []
        limits.update(self.state)
        tick = _asked(
            leg.problem, self.state, self.stack, limits,
            leg.causes[k], leg.v[k], lambda: limits.rows,
        )  # fmt: skip
        held = tick.forces(AT_LIMIT, self.stack.weights)
        total, size = sum(amount for _, amount in held), float(np.linalg.norm(missed))
        return [(row, amount / total * size) for row, amount in held if total > 0.0]


def held_up(leg: ExplainedPhase, ticks: range | None = None) -> tuple[Share, ...]:
    """Which limits slowed a run in some ticks or all, the largest share first."""
    look, ticks = TickBatch(leg), ticks or range(len(leg.v))
    some = ticks[:: max(1, len(ticks) // TICKS)]
    return shares(force for k in some for force in look.forces(k))


def speed_share(shares: Sequence[Share]) -> float:
    """Share of the limits of speeds and accelerations."""
    rates = (s for s in shares if not s.row.of_place and s.row.unit not in PLACE_UNITS)
    return sum(share.share for share in rates)


@dataclass(frozen=True)
class Unmet:
    """A hard or scaled task that gets only a share of its rate in a tick."""

    task: str
    mode: Mode
    share: float

    @property
    def words(self) -> str:
        return f"{self.mode} task '{self.task}'"


@dataclass(frozen=True, kw_only=True)
class Relaxed:
    """A hard or scaled task that is not met in full in some ticks of a run.

    ``missing`` is the share of its rate that it lacks in the last tick.
    """

    task: str
    mode: Mode
    ticks: int
    missing: float

    @property
    def words(self) -> str:
        ticks = f"{self.ticks} tick{'' if self.ticks == 1 else 's'}"
        end = f"lacks {percent(self.missing)} of its rate" if self.missing else "is met"
        return f"{self.mode} task '{self.task}' is not met in full in {ticks} and {end} at the end"


def part_of_rate(got: Array, wanted: Array) -> float:
    """The share of its rate that a task gets."""
    off, size = float(np.linalg.norm(got - wanted)), float(np.linalg.norm(wanted))
    return 1.0 - off / max(size, off, 1e-300)


def relaxed(explained_phases: Sequence[ExplainedPhase]) -> tuple[Relaxed, ...]:
    """Tasks not met in full in relaxed ticks, the most frequent first; none under torque laws."""
    modes: dict[str, Mode] = {}
    ticks, missing = Counter[str](), dict[str, float]()
    for leg in explained_phases:
        if leg.controller.commands_torques:
            break
        missing = {}
        modes |= {task.name: task.mode for task in leg.problem.tasks}
        for k, lacks in _lacks(leg):
            ticks.update(lacks.keys())
            missing = lacks if k == len(leg.v) - 1 else {}
    return tuple(
        Relaxed(task=name, mode=modes[name], ticks=count, missing=missing.get(name, 0.0))
        for name, count in ticks.most_common()
    )


def _lacks(leg: ExplainedPhase) -> Iterator[tuple[int, dict[str, float]]]:
    """Relaxed ticks of a phase, with the share that each task lacks."""
    look = TickBatch(leg)
    every = zip(leg.problem.tasks, look.stack.slices, strict=True)
    firm = [(task.name, rows) for task, rows in every if task.mode != "soft"]
    for k in (k for k, causes in enumerate(leg.causes) if Status.TASKS_RELAXED in causes):
        off, wanted = look.look(k), look.stack.wanted
        got = wanted - off
        lacks = {name: 1.0 - part_of_rate(got[rows], wanted[rows]) for name, rows in firm}
        least = min(max(lacks.values(), default=0.0), WORTH_COUNTING)
        yield k, {name: x for name, x in lacks.items() if x >= least > 0.0}


def percent(share: float) -> str:
    """A share, in words."""
    if share < 0.01:
        return "less than 1 %"
    return "more than 99 %" if 0.99 < share < 1.0 else f"{100.0 * share:.0f} %"
