"""The joints' end stops as stiff, damped springs that only push back.

    tau = -k (q - upper) - d v,   k = effort / STOP_ANGLE,   d = 2 sqrt(k W_jj)

with 1/W_jj the inertia that the joint sees, the loops closed, so that a joint comes to rest there
without a bounce. A light joint's spring is softer where the integration step asks for it.
"""

from __future__ import annotations

import numpy as np

from coopqp.base.spec import Array
from coopqp.closed_loop.dynamics import ClosedLoopDynamics
from coopqp.model.closed_chain import ClosedChain
from coopqp.plants._servo import UNLIMITED_EFFORT, full_effort, inertia_seen

#: How far a motor's full torque presses a joint into its stop [rad].
STOP_ANGLE = 0.005
#: Largest natural frequency of a stop times the integration step; Runge-Kutta diverges above 1.4.
STABLE = 0.5


class EndStops:
    """The stops of one chain.

    Args:
        chain: with the limits; a joint that starts beyond one has its stop there.
        h: integration step [s].
    """

    def __init__(self, chain: ClosedChain, h: float) -> None:
        self._lower = np.minimum(chain.lower, chain.q_start)
        self._upper = np.maximum(chain.upper, chain.q_start)
        effort = full_effort(chain)
        # A passive joint's stop is a part of the hand: as firm as the weakest motor's.
        least = effort[effort > 0.0].min(initial=UNLIMITED_EFFORT)
        self._firm = np.where(effort > 0.0, effort, least) / STOP_ANGLE
        self._k, self._d = self._firm, np.zeros(chain.n)
        self._most = (STABLE / h) ** 2
        self._A, self._J = np.zeros((0, 0)), np.zeros((0, 0))
        self._follows, self._nothing = True, np.zeros(chain.n)

    def update(self, dynamics: ClosedLoopDynamics) -> None:
        """Follow the inertia that the joints see, after ``dynamics.update``."""
        # Kept until a joint is at its stop, which few are: the inertia takes a decomposition.
        self._A, self._J, self._follows = dynamics.A.copy(), dynamics.J.copy(), False

    def _follow(self) -> None:
        W = inertia_seen(self._A, self._J)
        self._k = np.minimum(self._firm, W * self._most)
        self._d = 2.0 * np.sqrt(self._k * W)
        self._follows = True

    def torque(self, q: Array, v: Array) -> Array:
        """What the stops do to the joints, shape (n,) [N m]; not to be written to."""
        if not (np.count_nonzero(q > self._upper) or np.count_nonzero(q < self._lower)):
            return self._nothing
        if not self._follows:
            self._follow()
        above, below = q - self._upper, self._lower - q
        push = np.where(below > 0.0, np.maximum(self._k * below - self._d * v, 0.0), 0.0)
        push -= np.where(above > 0.0, np.maximum(self._k * above + self._d * v, 0.0), 0.0)
        return push
