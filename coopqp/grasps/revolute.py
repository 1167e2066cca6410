"""A grasp that lets the object turn about one axis of the hand: section 5.3 and Table 2.

Table 2 puts the passive axis parallel to the wrist axis (alpha = 0), d and r away from it; NAO's
wrist axis is the x axis of its hand. With both axes on one line through both hands the object
still gains two degrees of freedom, but it turns freely about that line, which no motor decides.
"""

import pinocchio as pin

from coopqp.base.spec import Array, Vector3, spec
from coopqp.grasp import PassiveJoint
from coopqp.grasps._families import OneAxis


@spec
class Revolute(OneAxis):
    """Hinge: the object turns freely about an axis of the hand (Table 2)."""

    point: Vector3 = (0.0, 0.0, 0.0)
    """A point of the axis, in the hand [m]."""

    def passive_joints(self, R_WT: Array) -> tuple[PassiveJoint, ...]:
        return (self.joint("hinge", pin.JointModelRZ(), self.point, R_WT),)
