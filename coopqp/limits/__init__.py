"""The limits: one file each, the YAML name is the file's name."""

from coopqp.limits.following_error import FollowingError
from coopqp.limits.joint_acceleration import JointAcceleration
from coopqp.limits.joint_position import JointPosition
from coopqp.limits.joint_velocity import JointVelocity
from coopqp.limits.object_speed import ObjectSpeed
from coopqp.limits.obstacles import Obstacle, Obstacles
from coopqp.limits.self_collision import SelfCollision
from coopqp.limits.workspace import Workspace

__all__ = [
    "FollowingError",
    "JointAcceleration",
    "JointPosition",
    "JointVelocity",
    "ObjectSpeed",
    "Obstacle",
    "Obstacles",
    "SelfCollision",
    "Workspace",
]
