"""How fast commands to a real robot may change, where its scenario does not say."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from coopqp.checked import Array
from coopqp.closed_chain import ClosedChain
from coopqp.limit import Limit
from coopqp.limits import JointAcceleration, JointPosition

#: Time from rest to a joint's velocity limit [s], from which its acceleration limit is made. NAO's
#: joints get 36 to 123 rad/s2 with it, two Pandas' 11 to 13 rad/s2.
SPEED_UP = 0.2
#: For joints without a velocity limit [rad/s2, m/s2].
UNLIMITED = 10.0
#: For joints without a motor, which bound nothing [rad/s2].
PASSIVE = 1e4


def with_acceleration(
    limits: Sequence[Limit], chain: ClosedChain, speed_up: float | None
) -> tuple[Limit, ...]:
    """The limits, with one on accelerations if there is none among them.

    Args:
        limits: of the scenario.
        chain: whose joints.
        speed_up: time in which a joint may go from rest to its velocity limit [s]; None for no
            limit.
    """
    if speed_up is None or any(isinstance(limit, JointAcceleration) for limit in limits):
        return tuple(limits)
    most = np.where(np.isfinite(chain.velocity), chain.velocity / speed_up, UNLIMITED)
    most[most <= 0.0] = UNLIMITED
    most[chain.passive] = PASSIVE
    by_joint = dict(zip(chain.joint_names, most.tolist(), strict=True))
    margin = max((x.margin for x in limits if isinstance(x, JointPosition)), default=0.0)
    return *limits, JointAcceleration(max=UNLIMITED, joints=by_joint, margin=margin)


def acceleration_of(limits: Sequence[Limit], chain: ClosedChain) -> Array:
    """Each joint's acceleration limit, shape (n,) [rad/s2, m/s2]; infinite where there is none."""
    found = np.full(chain.n, np.inf)
    for limit in limits:
        if isinstance(limit, JointAcceleration):
            own = [limit.joints.get(name, limit.max) for name in chain.joint_names]
            np.minimum(found, own, out=found)
    return found
