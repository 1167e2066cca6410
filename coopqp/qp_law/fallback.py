"""The declared order of sacrifice, for a tick in which not everything can hold."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from coopqp.checked import Array
from coopqp.controller import ControlProblem
from coopqp.qp_law.bounds import Bounds
from coopqp.qp_law.equations import loop_rows
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
        kappa: gain of the drift correction [1/s].
    """

    gives_up: Status
    level: Level
    bounds: Bounds
    kappa: float


class Fallback:
    """Smaller problems, from what gives up least to what gives up most.

    Args:
        problem: what to control.
        start: the state from which references set out.
        damping: cost of |v|^2.
    """

    def __init__(self, problem: ControlProblem, start: State, damping: float) -> None:
        chain, limits = problem.chain, problem.limits
        kept = [limit for limit in limits if not limit.sacrificed_first]
        every_limit = Bounds(chain, limits, start, problem.dt)
        kept_limits = Bounds(chain, kept, start, problem.dt)
        rows = chain.loops.solver_rows
        self._tasks = TaskStack(problem.tasks, start)
        soft = Level(problem, self._tasks, rows, every_limit, damping)
        free = Level(problem, self._tasks, rows, kept_limits, damping)
        self._attempts = []
        if any(task.mode != "soft" for task in problem.tasks):
            self._attempts.append(_Attempt(Status.TASKS_GIVEN_UP, soft, every_limit, problem.kappa))
        if len(kept) < len(limits):
            self._attempts.append(
                _Attempt(Status.ACCELERATION_GIVEN_UP, free, kept_limits, problem.kappa)
            )
        self._attempts.append(_Attempt(Status.DRIFT_GIVEN_UP, free, kept_limits, 0.0))

    def solve(
        self, state: State, failed: Status, recovery: Recovery | None
    ) -> tuple[Status, Array]:
        """The first attempt that has an answer, and what it gave up; else the first failure.

        That something left no motion is said only where the solver found so each time: one that
        ran out of iterations or broke a row tells nothing about the problem.
        """
        self._tasks.update(state)
        conflict = failed is Status.INFEASIBLE
        for attempt in self._attempts:
            status = self._solve(attempt, state, recovery)
            if status.usable:
                said = attempt.gives_up if conflict else Status.SOLVER_FAILED
                return said, attempt.level.v
            conflict = conflict and status is Status.INFEASIBLE
        return failed, self._attempts[-1].level.v

    def _solve(self, attempt: _Attempt, state: State, recovery: Recovery | None) -> Status:
        level, bounds = attempt.level, attempt.bounds
        bounds.update(state)
        level.assemble(bounds)
        if recovery:
            recovery.pull(state, level.qp)
        loop_rows(state.J_loop, state.e_loop, attempt.kappa, level.A, level.b)
        if attempt.gives_up is Status.DRIFT_GIVEN_UP:
            # The last one: nothing may ask for a motion, so that v = 0 is feasible.
            np.maximum(level.qp.h, 0.0, out=level.qp.h)
        return level.solve()
