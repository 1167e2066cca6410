"""The limits: one file each, the YAML name is the file's name."""

from coopqp.limits.joint_position import JointPosition
from coopqp.limits.joint_velocity import JointVelocity

__all__ = ["JointPosition", "JointVelocity"]
