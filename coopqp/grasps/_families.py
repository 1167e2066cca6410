"""What grasps that press have in common, and those in which the object moves along one axis."""

import math
from typing import Any, Literal

import numpy as np
import pinocchio as pin

from coopqp.base.spec import Array, Direction, NonNegative, Positive, Vector3, spec, unit
from coopqp.grasp import Grasp, PassiveJoint, range_fault

#: A direction that is nearer to the normal gives no axis along the pad.
PARALLEL = 1e-3


@spec
class Pressing(Grasp):
    """Holds by pressing at a place of the hand."""

    position: Vector3 = (0.0, 0.0, 0.0)
    """Where it presses, such as the pad's middle, in the hand [m]."""
    normal: Direction = (0.0, 0.0, 1.0)
    """Which way it presses at the start, in the hand; any length."""
    along: Direction | None = None
    """Direction of a vertex of the pyramid, or of the pad's first half-length, in the hand; across
    the normal if omitted."""
    friction: Positive = 0.5
    """Coefficient between hand and object."""
    least: NonNegative = 1.0
    """Normal force with which it is to press at least; what tilts a pad counts on the rest [N]."""
    most: Positive | None = None
    """Normal force that the object, or the hand, stands [N]; any if omitted."""

    def __post_init__(self) -> None:
        if self.most is not None and not self.least < self.most:
            raise ValueError(
                f"most: found {self.most:g} N, needs more than least, {self.least:g} N"
            )
        self.pressed()

    def pressed(self) -> dict[str, Any]:
        """What a contact has of it; its frame in the hand has z along the normal.

        x goes along ``along`` less its part along the normal; the hand's own x, or y, if omitted.
        ValueError: along goes along the normal.
        """
        z, along = unit(self.normal), self.along
        if along is None:
            along = (1.0, 0.0, 0.0) if abs(z[0]) < 0.9 else (0.0, 1.0, 0.0)
        x = unit(along)
        x = x - (x @ z) * z
        length = float(np.linalg.norm(x))
        if length < PARALLEL:
            raise ValueError("along: goes along the normal; needs a direction across it")
        x /= length
        frame = pin.SE3(np.column_stack([x, np.cross(z, x), z]), np.array(self.position))
        forces = {"min_force": self.least, "max_force": self.most or math.inf}
        return {"placement": frame, "friction": self.friction, **forces}


@spec
class OneAxis(Grasp):
    """Lets the object move about or along one axis."""

    axis: Direction = (1.0, 0.0, 0.0)
    """Of the motion; any length."""
    axis_in: Literal["hand", "world"] = "hand"
    """Frame in which the axis is given; "world" means at the start."""
    lower: float | None = None
    """Lower limit [rad or m]; none if omitted."""
    upper: float | None = None
    """Upper limit [rad or m]; none if omitted."""

    def __post_init__(self) -> None:
        if wrong := range_fault(self.lower, self.upper):
            raise ValueError(wrong)

    def joint(self, name: str, joint: Any, point: Vector3, R_WT: Array) -> PassiveJoint:
        """A joint whose z is the axis, with its origin at a point of the hand [m]."""
        z = unit(self.axis) if self.axis_in == "hand" else R_WT.T @ unit(self.axis)
        turn = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), z)
        return PassiveJoint(
            name=name,
            joint=joint,
            placement=pin.SE3(turn.toRotationMatrix(), np.array(point)),
            lower=-math.inf if self.lower is None else self.lower,
            upper=math.inf if self.upper is None else self.upper,
        )
