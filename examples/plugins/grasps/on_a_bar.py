"""The hand closes around a bar of the object: it slides along the bar and turns about it."""

from __future__ import annotations

from typing import Literal

import pinocchio as pin

from coopqp import Array, Grasp, PassiveJoint, spec

SLIDES = {"x": pin.JointModelPX(), "y": pin.JointModelPY(), "z": pin.JointModelPZ()}
TURNS = {"x": pin.JointModelRX(), "y": pin.JointModelRY(), "z": pin.JointModelRZ()}


@spec
class OnABar(Grasp):
    """Bar: the object slides along an axis of the hand and turns about it."""

    axis: Literal["x", "y", "z"] = "y"
    """Of the bar, through the origin of the hand's frame."""
    reach: float = 0.1
    """How far the hand slides both ways [m]."""

    def passive_joints(self, R_WT: Array) -> tuple[PassiveJoint, ...]:
        """A slide, then a hinge along the same axis."""
        here = pin.SE3.Identity()
        slide, turn = SLIDES[self.axis], TURNS[self.axis]
        return (
            PassiveJoint(
                name="slide", joint=slide, placement=here, lower=-self.reach, upper=self.reach
            ),
            PassiveJoint(name="turn", joint=turn, placement=here),
        )
