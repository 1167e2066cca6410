"""Joints stay within their range: (lower - q)/dt <= v <= (upper - q)/dt.

A joint outside its range must not go farther out, and comes back no faster than recovery_speed; so
standing still is always allowed. What brings it back is the controller.
"""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from coopqp.checked import Array, NonNegative, Positive, spec
from coopqp.closed_chain import ClosedChain
from coopqp.limit import (
    ROUNDING,
    Bounded,
    JointBounds,
    Limit,
    LimitRows,
    Tighten,
    joint_margins,
)
from coopqp.row import Row
from coopqp.state import State

ZERO = np.zeros(1)


@spec
class JointPosition(Limit):
    """Joint position limits of the robot and of the grasps' passive joints."""

    bounds_position: ClassVar[bool] = True

    margin: NonNegative = 0.0
    """Kept free at both ends [rad or m]."""
    recovery_speed: Positive = 0.5
    """Fastest way back for a joint that starts outside [rad/s or m/s]."""

    def bind(self, chain: ClosedChain, dt: float) -> Tighten:
        """Bounds that no step of length dt can overrun."""
        ends = self._ends(chain)
        # An array times an array is twice as fast as an array times a number.
        room, rate = np.zeros_like(ends), np.full_like(ends, 1.0 / dt)
        below, above = room
        out = low, high = np.zeros(ends.shape, bool)
        rounding = np.full(chain.n, ROUNDING / dt)

        def tighten(state: State, rows: LimitRows) -> None:
            np.subtract(ends, state.q, room)
            np.multiply(room, rate, room)
            # Outside its range a joint may stand still, but not go farther out.
            np.greater(below, rounding, out=low)
            np.less(above, -rounding, out=high)
            np.minimum(below, ZERO, out=below)
            np.maximum(above, ZERO, out=above)
            np.maximum(rows.lb, below, out=rows.lb)
            np.minimum(rows.ub, above, out=rows.ub)
            if np.count_nonzero(out):
                np.minimum(rows.ub, self.recovery_speed, out=rows.ub, where=low)
                np.maximum(rows.lb, -self.recovery_speed, out=rows.lb, where=high)

        return tighten

    def program(self, chain: ClosedChain, dt: float) -> JointBounds:
        """Of q."""
        lower, upper = self._ends(chain)
        speed = self.recovery_speed
        return JointBounds(of=Bounded.POSITION, lower=lower, upper=upper, speed=speed)

    def margins(self, chain: ClosedChain, q: Array, v: Array, dt: float) -> dict[Row, Array]:
        """Distance to both ends after each tick [rad, m]."""
        lower, upper = self._ends(chain)
        return joint_margins("position", chain, q[1:] - lower, upper - q[1:])

    def _ends(self, chain: ClosedChain) -> Array:
        return np.vstack([chain.lower + self.margin, chain.upper - self.margin])
