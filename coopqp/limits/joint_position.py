"""Joints stay within their range: (lower - q)/dt <= v <= (upper - q)/dt.

A joint outside its range must not go farther out, and recovers no faster than recovery_speed; so
standing still is always allowed. What brings it back is the controller.
"""

from typing import ClassVar

import numpy as np

from coopqp.base.qp import Row
from coopqp.base.spec import Array, NonNegative, Positive, spec
from coopqp.limit import ROUNDING, Bounded, JointBounds, Limit, LimitRows, Tighten, joint_margins
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.state import State


@spec
class JointPosition(Limit):
    """Joint position limits of the robot and of the grasps' passive joints."""

    bounds_position: ClassVar[bool] = True

    margin: NonNegative = 0.0
    """Kept free at both ends [rad or m]."""
    recovery_speed: Positive = 0.5
    """Fastest recovery of a joint that starts outside [rad/s or m/s]."""

    def bind(self, chain: ClosedChain, dt: float) -> Tighten:
        """Bounds with which no step of length dt leaves the range."""
        ends = self._ends(chain)
        rate, rounding = 1.0 / dt, ROUNDING / dt

        def tighten(state: State, rows: LimitRows) -> None:
            below, above = (ends - state.q) * rate
            # Outside its range a joint may stand still, but not go farther out.
            np.maximum(rows.lb, np.minimum(below, 0.0), out=rows.lb)
            np.minimum(rows.ub, np.maximum(above, 0.0), out=rows.ub)
            low, high = below > rounding, above < -rounding
            np.minimum(rows.ub, self.recovery_speed, out=rows.ub, where=low)
            np.maximum(rows.lb, -self.recovery_speed, out=rows.lb, where=high)

        return tighten

    def program(self, chain: ClosedChain, dt: float) -> JointBounds:
        lower, upper = self._ends(chain)
        speed = self.recovery_speed
        return JointBounds(of=Bounded.POSITION, lower=lower, upper=upper, speed=speed)

    def margins(self, chain: ClosedChain, q: Array, v: Array, dt: float) -> dict[Row, Array]:
        lower, upper = self._ends(chain)
        return joint_margins("position", chain, q[1:] - lower, upper - q[1:])

    def _ends(self, chain: ClosedChain) -> Array:
        return np.vstack([chain.lower + self.margin, chain.upper - self.margin])
