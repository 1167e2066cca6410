"""The declared order of sacrifice, for a tick in which not everything can hold."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from coopqp.checked import Array
from coopqp.controller import ControlProblem
from coopqp.qp_law.bounds import Bounds
from coopqp.qp_law.equations import ALL_OF_IT, Damping
from coopqp.qp_law.level import Level
from coopqp.qp_law.safety import drift_gain
from coopqp.qp_law.way_back import WayBack
from coopqp.solver import Status
from coopqp.state import State
from coopqp.task import TaskStack


class _Attempt(NamedTuple):
    """A smaller problem: what it leaves out beside all before it, its QP and limits."""

    gives_up: Status
    level: Level
    bounds: Bounds


class Fallback:
    """Smaller problems, from what gives up least to what gives up most.

    Hard and scaled tasks become soft; the drift correction is done in part; acceleration limits
    go, with the share of the correction that is possible then. Never the loop rows, never position
    and velocity limits.

    Args:
        problem: what to control.
        start: the state from which references set out.
        way_back: the limits, and of joints outside of them.
        damping: cost of |v|^2.

    Attributes:
        drift: share of the drift correction that the last answer does.
    """

    def __init__(
        self, problem: ControlProblem, start: State, way_back: WayBack, damping: Damping
    ) -> None:
        self._problem, self._way_back, self._damping = problem, way_back, damping
        self.drift = 0.0
        self._tasks = TaskStack(problem.tasks, start)
        rows, bounds = problem.chain.loops.solver_rows, way_back.bounds
        self._attempts = []
        if any(task.mode != "soft" for task in problem.tasks):
            soft = Level(problem, self._tasks, rows, bounds, damping)
            self._attempts.append(_Attempt(Status.TASKS_GIVEN_UP, soft, bounds))
        slowed = Level(problem, self._tasks, rows, bounds, damping, slows=True)
        self._attempts.append(_Attempt(Status.DRIFT_SLOWED, slowed, bounds))
        kept = [limit for limit in problem.limits if not limit.sacrificed_first]
        if len(kept) < len(problem.limits):
            wider = Bounds(problem.chain, kept, start, problem.dt)
            free = Level(problem, self._tasks, rows, wider, damping, slows=True)
            self._attempts.append(_Attempt(Status.ACCELERATION_GIVEN_UP, free, wider))

    def solve(self, state: State, failed: Status) -> tuple[Array, tuple[Status, ...]]:
        """The first answer of an attempt, and what it gave up; else the first failure.

        That something left no motion is said only where the solver found so each time: one that
        ran out of iterations or broke a row tells nothing about the problem.

        Args:
            state: of the tick.
            failed: why the whole problem has no answer.
        """
        self._tasks.update(state)
        conflict, given_up = failed is Status.INFEASIBLE, list[Status]()
        for attempt in self._attempts:
            given_up.append(attempt.gives_up)
            status = self._try(attempt, state)
            if status.usable:
                self.drift = share = attempt.level.scale
                said = [c for c in given_up if c is not Status.DRIFT_SLOWED or share < ALL_OF_IT]
                causes = tuple(reversed(said)) if conflict and said else (Status.SOLVER_FAILED,)
                return attempt.level.v, causes
            conflict = conflict and status is Status.INFEASIBLE
        self.drift = 0.0
        return attempt.level.v, (failed,)

    def _try(self, attempt: _Attempt, state: State) -> Status:
        _, level, bounds = attempt
        bounds.update(state)
        self._way_back.tighten(bounds)
        kappa = drift_gain(self._problem, state)
        level.assemble(state, bounds, self._damping.of_drift(state, kappa))
        level.close_loops(state, kappa)
        if attempt is self._attempts[-1]:  # nothing may ask for a motion, so that v = 0 is feasible
            np.maximum(level.qp.h, 0.0, out=level.qp.h)
        return level.solve()
