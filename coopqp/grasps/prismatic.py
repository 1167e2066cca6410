"""A grasp that lets the object slide along one axis of the hand."""

from __future__ import annotations

import math
from typing import Literal

import pinocchio as pin

from coopqp.base.spec import Array, Direction, spec
from coopqp.grasp import Grasp, PassiveJoint, axis_frame, range_fault


@spec
class Prismatic(Grasp):
    """Slide: the object moves freely along an axis of the hand."""

    axis: Direction = (1.0, 0.0, 0.0)
    """Of the slide; any length."""
    axis_in: Literal["hand", "world"] = "hand"
    """Frame in which the axis is given; "world" means at the start."""
    lower: float | None = None
    """Lower limit [m]; none if omitted."""
    upper: float | None = None
    """Upper limit [m]; none if omitted."""

    def __post_init__(self) -> None:
        if wrong := range_fault(self.lower, self.upper):
            raise ValueError(wrong)

    def passive_joints(self, R_WT: Array) -> tuple[PassiveJoint, ...]:
        placement = axis_frame(self.axis, self.axis_in, (0.0, 0.0, 0.0), R_WT)
        return (
            PassiveJoint(
                name="slide", joint=pin.JointModelPZ(), placement=placement,
                lower=-math.inf if self.lower is None else self.lower,
                upper=math.inf if self.upper is None else self.upper,
            ),
        )  # fmt: skip
