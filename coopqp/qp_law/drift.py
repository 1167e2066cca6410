"""The drift correction in part, where limits leave no motion that does all of it.

    minimise    W (1 - s)^2 + d |v|^2
    subject to  J_c v = -s kappa e,   lb <= v <= ub,   G v <= h,   0 <= s <= 1

First with all limits; where that leaves nothing, without acceleration limits, and with limits in
space that ask for no motion. Standing still is feasible from any state inside the others. The share
that is found takes the place of 1 in all levels of the tick.
"""

from __future__ import annotations

from coopqp.controller import ControlProblem
from coopqp.qp_law.equations import ALL_OF_IT, Damping
from coopqp.qp_law.level import Level
from coopqp.qp_law.safety import drift_gain
from coopqp.qp_law.way_back import WayBack
from coopqp.solver import Status
from coopqp.state import State
from coopqp.task import TaskStack

#: What of the largest share is done, so that the tick's levels have an answer to the last digit.
INSIDE = 1.0 - 1e-4


class DriftShare:
    """The largest share of the drift correction, and a motion v that does it."""

    def __init__(
        self, problem: ControlProblem, start: State, way_back: WayBack, damping: Damping
    ) -> None:
        self._problem, self._way_back, self._damping = problem, way_back, damping
        rows, nothing = problem.chain.loops.solver_rows, TaskStack((), start)
        self._level = Level(problem, nothing, rows, way_back.bounds, damping, slows=True)
        self.share, self.v = 1.0, self._level.v

    def find(self, state: State) -> tuple[Status, ...]:
        """What is relaxed so that there is a share, or why there is none, which is not usable.

        The limits are then as they were when it was found.
        """
        causes = []
        status = self._solve(state)
        if not status.usable:
            if self._way_back.release(state):
                causes.append(Status.ACCELERATION_GIVEN_UP)
            status = self._solve(state)
        if not status.usable:
            return (status,)
        self.share = self._level.scale
        if self.share < ALL_OF_IT:
            self.share *= INSIDE
            causes.append(Status.DRIFT_SLOWED)
        return tuple(causes) or (Status.SOLVER_FAILED,)

    def _solve(self, state: State) -> Status:
        kappa = drift_gain(self._problem, state)
        self._level.assemble(state, kappa, self._damping.of_drift(state, kappa))
        return self._level.solve()
