"""The limits: one file each, the YAML name is the file's name."""

from coopqp.limits.following_error import FollowingError as FollowingError
from coopqp.limits.joint_acceleration import JointAcceleration as JointAcceleration
from coopqp.limits.joint_position import JointPosition as JointPosition
from coopqp.limits.joint_velocity import JointVelocity as JointVelocity
from coopqp.limits.object_speed import ObjectSpeed as ObjectSpeed
from coopqp.limits.obstacles import Obstacle as Obstacle
from coopqp.limits.obstacles import Obstacles as Obstacles
from coopqp.limits.self_collision import SelfCollision as SelfCollision
from coopqp.limits.workspace import Workspace as Workspace
