"""Joints stay within their range: (lower - q)/dt <= v <= (upper - q)/dt.

A joint outside its range is sent back at the speed that the limits before this one allow.
"""

from __future__ import annotations

import numpy as np

from coopqp.closed_chain import ClosedChain
from coopqp.limit import Limit, LimitRows, Tighten
from coopqp.spec import NonNegative, spec
from coopqp.state import State


@spec
class JointPosition(Limit):
    """Joint position limits of the robot and of the grasps' passive joints."""

    margin: NonNegative = 0.0
    """Kept free at both ends [rad or m]."""

    def bind(self, chain: ClosedChain, dt: float) -> Tighten:
        """Bounds that no step of length dt can overrun."""
        ends = np.vstack([chain.lower + self.margin, chain.upper - self.margin])
        # An array times an array is twice as fast as an array times a number.
        room, rate = np.zeros_like(ends), np.full_like(ends, 1.0 / dt)
        below, above = room

        def tighten(state: State, rows: LimitRows) -> None:
            np.subtract(ends, state.q, room)
            np.multiply(room, rate, room)
            # Clipped into what the other limits leave: outside its range a joint comes back as
            # fast as it may, and the bounds never cross.
            np.maximum(rows.lb, below, out=below)
            np.minimum(rows.ub, above, out=above)
            np.maximum(rows.lb, above, out=above)
            np.minimum(rows.ub, below, out=rows.lb)
            rows.ub[:] = above

        return tighten
