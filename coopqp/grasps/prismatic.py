"""A grasp that lets the object slide along one axis of the hand."""

import pinocchio as pin

from coopqp.base.spec import Array, spec
from coopqp.grasp import PassiveJoint
from coopqp.grasps._families import OneAxis


@spec
class Prismatic(OneAxis):
    """Slide: the object moves freely along an axis of the hand."""

    def passive_joints(self, R_WT: Array) -> tuple[PassiveJoint, ...]:
        return (self.joint("slide", pin.JointModelPZ(), (0.0, 0.0, 0.0), R_WT),)
