"""Where a contact or a ball joint is in the hand, and how hard a contact may press."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from coopqp.base.spec import unit
from coopqp.grasp import PassiveJoint

Three = tuple[float, float, float]

#: A direction that is nearer to the normal gives no axis along the pad.
PARALLEL = 1e-3


def placed(position: Three, normal: Three, along: Three | None = None) -> pin.SE3:
    """The contact frame in the hand at a position [m]: z along the normal, x along the pad.

    x goes along ``along`` less its part along the normal; the hand's own x, or y, if omitted.
    ValueError: along goes along the normal.
    """
    z = unit(normal)
    if along is None:
        along = (1.0, 0.0, 0.0) if abs(z[0]) < 0.9 else (0.0, 1.0, 0.0)
    x = unit(along)
    x = x - (x @ z) * z
    length = float(np.linalg.norm(x))
    if length < PARALLEL:
        raise ValueError("along: goes along the normal; needs a direction across it")
    x /= length
    return pin.SE3(np.column_stack([x, np.cross(z, x), z]), np.array(position))


def check_range(least: float, most: float | None) -> None:
    """ValueError: normal forces [N] leave nothing between them."""
    if most is not None and not least < most:
        raise ValueError(f"most: found {most:g} N, needs more than least, {least:g} N")


def ball(point: Three, cone: float) -> tuple[PassiveJoint, ...]:
    """Hinges about x, y and z through a point of the hand [m], each within +-cone [rad]."""
    centre = pin.SE3(np.eye(3), np.array(point))
    kinds = (pin.JointModelRX(), pin.JointModelRY(), pin.JointModelRZ())
    places = (centre, pin.SE3.Identity(), pin.SE3.Identity())
    return tuple(
        PassiveJoint(name=f"ball_{axis}", joint=joint, placement=place, lower=-cone, upper=cone)
        for axis, joint, place in zip("xyz", kinds, places, strict=True)
    )
