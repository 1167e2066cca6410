"""The declared order of sacrifice, for a tick in which not everything can hold."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from coopqp.checked import Array
from coopqp.controller import ControlProblem
from coopqp.qp_law.bounds import Bounds
from coopqp.qp_law.equations import (
    ALL_OF_IT,
    drift_damping,
    loop_rows,
    slowed_loop_rows,
    step_damping,
)
from coopqp.qp_law.level import Level
from coopqp.qp_law.recovery import Recovery
from coopqp.solver import Status
from coopqp.state import State
from coopqp.task import TaskStack


@dataclass(frozen=True)
class _Attempt:
    """A smaller problem.

    Attributes:
        gives_up: what it leaves out, with all that was left out before it.
        level, bounds: its QP and limits.
        slows: whether it may do a share of the drift correction only.
        last: whether standing still must be feasible.
    """

    gives_up: Status
    level: Level
    bounds: Bounds
    slows: bool = True
    last: bool = False


@dataclass(frozen=True)
class Outcome:
    """What the fallback came to.

    Attributes:
        v: the velocity, shape (n,).
        drift: share of the drift correction that v does.
        causes: what was given up, or the first failure when nothing has an answer.
    """

    v: Array
    drift: float
    causes: tuple[Status, ...]


class Fallback:
    """Smaller problems, from what gives up least to what gives up most.

    Hard and scaled tasks become soft; the drift correction is done in part; acceleration limits
    go, with the share of the correction that is possible then. Never the loop rows, never position
    and velocity limits.

    Args:
        problem: what to control.
        start: the state from which references set out.
        damping: cost of |v|^2.
        error_damping: share of the damping that rules out any overshoot.
    """

    def __init__(
        self, problem: ControlProblem, start: State, damping: float, error_damping: float
    ) -> None:
        chain, limits = problem.chain, problem.limits
        kept = [limit for limit in limits if not limit.sacrificed_first]
        every_limit = Bounds(chain, limits, start, problem.dt)
        rows = chain.loops.solver_rows
        self._tasks = tasks = TaskStack(problem.tasks, start)
        self._dt, self._error_damping, self._reach = problem.dt, error_damping, chain.reach
        self._attempts = []
        if any(task.mode != "soft" for task in problem.tasks):
            soft = Level(problem, tasks, rows, every_limit, damping)
            self._attempts.append(_Attempt(Status.TASKS_GIVEN_UP, soft, every_limit, slows=False))
        slowed = Level(problem, tasks, rows, every_limit, damping, shares=["drift correction"])
        self._attempts.append(
            _Attempt(Status.DRIFT_SLOWED, slowed, every_limit, last=len(kept) == len(limits))
        )
        if len(kept) < len(limits):
            bounds = Bounds(chain, kept, start, problem.dt)
            free = Level(problem, tasks, rows, bounds, damping, shares=["drift correction"])
            self._attempts.append(_Attempt(Status.ACCELERATION_GIVEN_UP, free, bounds, last=True))

    def solve(
        self, state: State, drift: Array, kappa: float, failed: Status, recovery: Recovery
    ) -> Outcome:
        """The first attempt that has an answer, and what it gave up; else the first failure.

        That something left no motion is said only where the solver found so each time: one that
        ran out of iterations or broke a row tells nothing about the problem.

        Args:
            state: of the tick.
            drift: what the loops must lose, shape (m,).
            kappa: gain of the drift correction [1/s].
            failed: why the whole problem has no answer.
            recovery: of joints outside their limits.
        """
        self._tasks.update(state)
        extra = step_damping(self._tasks.bend(state.v), self._dt, self._error_damping)
        extra += drift_damping(drift, kappa, self._dt, self._reach, state.corrected)
        conflict, given_up = failed is Status.INFEASIBLE, list[Status]()
        for attempt in self._attempts:
            given_up.append(attempt.gives_up)
            status = self._solve(attempt, state, drift, kappa, extra, recovery)
            if status.usable:
                share = attempt.level.scale
                said = [c for c in given_up if c is not Status.DRIFT_SLOWED or share < ALL_OF_IT]
                causes = tuple(reversed(said)) if conflict and said else (Status.SOLVER_FAILED,)
                return Outcome(attempt.level.v, share, causes)
            conflict = conflict and status is Status.INFEASIBLE
        return Outcome(self._attempts[-1].level.v, 0.0, (failed,))

    def _solve(
        self,
        attempt: _Attempt,
        state: State,
        drift: Array,
        kappa: float,
        extra: float,
        recovery: Recovery,
    ) -> Status:
        level, bounds = attempt.level, attempt.bounds
        bounds.update(state)
        if recovery.active:
            recovery.tighten(bounds)
        level.assemble(bounds, extra)
        rows = slowed_loop_rows if attempt.slows else loop_rows
        rows(state.J_loop, drift, kappa, level.qp.A, level.b)
        if attempt.last:  # nothing may ask for a motion, so that v = 0 is feasible
            np.maximum(level.qp.h, 0.0, out=level.qp.h)
        return level.solve()
