"""Commanded joints stay near the measured ones: no command runs away from arms that are held up.

With the following error f = q - q_measured of each driven joint, as drives define it,

    (-max - f)/dt <= v <= (max - f)/dt,   both cut so that v = 0 is allowed

Without it the command of an arm that is stopped by a wall, a hand or a saturated motor goes on to
its goal, and the arm jumps there when released. Unmeasured joints have no such limit.
"""

from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from coopqp.base.spec import Positive, spec
from coopqp.limit import Bounded, JointBounds, Limit, LimitRows, Tighten
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.state import State


@spec
class FollowingError(Limit):
    """A leash between commanded and measured joints."""

    uses_measurements: ClassVar[bool] = True
    bounds_position: ClassVar[bool] = True

    max: Positive = 0.025
    """How far a commanded joint may lead its measured one, or lag behind it [rad, m].

    With a servo of stiffness K, max K is the largest torque that an error of position asks for; the
    default is half a motor's torque with the servos of ``rigid_body`` and ``mujoco``. It has to be
    more than the way of a joint during the delay of commands."""

    def bind(self, chain: ClosedChain, dt: float) -> Tighten:
        """Bounds on the driven joints; what is not measured, or no number, bounds nothing."""
        driven = _driven(chain)

        def tighten(state: State, rows: LimitRows) -> None:
            measured = state.reading
            if measured is None:
                return
            lead = state.q - measured
            known = driven & np.isfinite(lead)
            # Cut so that standing still is allowed.
            below = np.minimum((-self.max - lead) / dt, 0.0)
            above = np.maximum((self.max - lead) / dt, 0.0)
            np.maximum(rows.lb, below, out=rows.lb, where=known)
            np.minimum(rows.ub, above, out=rows.ub, where=known)

        return tighten

    def program(self, chain: ClosedChain, dt: float) -> JointBounds:
        lead = np.where(_driven(chain), self.max, np.inf)
        return JointBounds(of=Bounded.LEAD, lower=-lead, upper=lead)


def _driven(chain: ClosedChain) -> NDArray[np.bool_]:
    return ~np.isin(np.arange(chain.n), chain.passive)
