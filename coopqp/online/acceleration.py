"""How fast commands to a real robot may change, where its scenario does not say."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from coopqp.assessment.assessment import allowed_acceleration
from coopqp.assessment.thresholds import ACCELERATION_UNLIMITED
from coopqp.checked import Array
from coopqp.closed_chain import ClosedChain
from coopqp.limit import Limit
from coopqp.limits import JointAcceleration, JointPosition

#: For joints without a motor, which bound nothing [rad/s2].
PASSIVE = 1e4


def with_acceleration(
    limits: Sequence[Limit], chain: ClosedChain, speed_up: float | None
) -> tuple[Limit, ...]:
    """The limits, with one on accelerations if there is none among them."""
    if speed_up is None or any(isinstance(limit, JointAcceleration) for limit in limits):
        return tuple(limits)
    most = allowed_acceleration(chain.velocity, speed_up)
    most[chain.passive] = PASSIVE
    by_joint = dict(zip(chain.joint_names, most.tolist(), strict=True))
    margin = max((x.margin for x in limits if isinstance(x, JointPosition)), default=0.0)
    rest = float(ACCELERATION_UNLIMITED)
    return *limits, JointAcceleration(max=rest, joints=by_joint, margin=margin)


def acceleration_of(limits: Sequence[Limit], chain: ClosedChain) -> Array:
    """Each joint's acceleration limit, shape (n,) [rad/s2, m/s2]; infinite where there is none."""
    found = np.full(chain.n, np.inf)
    for limit in limits:
        if isinstance(limit, JointAcceleration):
            own = [limit.joints.get(name, limit.max) for name in chain.joint_names]
            np.minimum(found, own, out=found)
    return found
