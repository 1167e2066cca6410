"""The three hinges that stand for a ball about a point of the hand."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from coopqp.grasp import PassiveJoint


def ball(point: tuple[float, float, float], cone: float) -> tuple[PassiveJoint, ...]:
    """Hinges about x, y and z through a point of the hand [m], each within +-cone [rad]."""
    centre = pin.SE3(np.eye(3), np.array(point))
    kinds = (pin.JointModelRX(), pin.JointModelRY(), pin.JointModelRZ())
    places = (centre, pin.SE3.Identity(), pin.SE3.Identity())
    return tuple(
        PassiveJoint(name=f"ball_{axis}", joint=joint, placement=place, lower=-cone, upper=cone)
        for axis, joint, place in zip("xyz", kinds, places, strict=True)
    )
