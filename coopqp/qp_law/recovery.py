"""The way back for joints that start outside their limits."""

from __future__ import annotations

import numpy as np

from coopqp.controller import ControlProblem
from coopqp.qp import QP
from coopqp.qp_law.equations import add_damping
from coopqp.state import State

#: Cost of not coming back, far above any task [s2/rad2].
RECOVERY_WEIGHT = 1e3
#: Slowest wish to come back [rad/s].
LEAST_RECOVERY = 0.02


class Recovery:
    """Pulls joints that are outside their limits back, more than any task pulls.

    Args:
        problem: dt and limits.

    Attributes:
        active: whether a joint was outside in the last tick.
    """

    def __init__(self, problem: ControlProblem) -> None:
        chain = problem.chain
        self._lower, self._upper, self._rate = chain.lower, chain.upper, 1.0 / problem.dt
        self.active = False

    def pull(self, state: State, qp: QP) -> None:
        """Add the wish to be back at the limit with the next step; the bounds slow it down."""
        n = len(state.q)
        back = np.maximum(self._lower - state.q, 0.0) - np.maximum(state.q - self._upper, 0.0)
        outside = back != 0.0
        self.active = bool(outside.any())
        if not self.active:
            return
        # A speed that goes to zero at the limit would lose against the tasks just outside it.
        wish = np.sign(back) * np.maximum(np.abs(back) * self._rate, LEAST_RECOVERY)
        wish = np.minimum(np.maximum(wish, qp.lb[:n]), qp.ub[:n])
        weight = RECOVERY_WEIGHT * outside
        add_damping(qp.P[:n, :n], weight)
        qp.q[:n] -= weight * wish
