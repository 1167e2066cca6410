"""A grasp that lets the object turn about one axis of the hand: section 5.3 and Table 2.

Table 2 puts the passive axis parallel to the wrist axis (alpha = 0), d and r away from it; NAO's
wrist axis is the x axis of its hand. With both axes on one line through both hands the object
still gains two degrees of freedom, but it turns freely about that line, which no motor decides.
"""

from __future__ import annotations

import math
from typing import Literal

import pinocchio as pin

from coopqp.base.spec import Array, Direction, Vector3, spec
from coopqp.grasp import Grasp, PassiveJoint, axis_frame, range_fault


@spec
class Revolute(Grasp):
    """Hinge: the object turns freely about an axis of the hand (Table 2)."""

    axis: Direction = (1.0, 0.0, 0.0)
    """Of the hinge; any length."""
    axis_in: Literal["hand", "world"] = "hand"
    """Frame in which the axis is given; "world" means at the start."""
    point: Vector3 = (0.0, 0.0, 0.0)
    """A point of the axis, in the hand [m]."""
    lower: float | None = None
    """Lower limit [rad]; none if omitted."""
    upper: float | None = None
    """Upper limit [rad]; none if omitted."""

    def __post_init__(self) -> None:
        if wrong := range_fault(self.lower, self.upper):
            raise ValueError(wrong)

    def passive_joints(self, R_WT: Array) -> tuple[PassiveJoint, ...]:
        placement = axis_frame(self.axis, self.axis_in, self.point, R_WT)
        return (
            PassiveJoint(
                name="hinge", joint=pin.JointModelRZ(), placement=placement,
                lower=-math.inf if self.lower is None else self.lower,
                upper=math.inf if self.upper is None else self.upper,
            ),
        )  # fmt: skip
