"""The tasks: one file each, the YAML name is the file's name."""

from coopqp.tasks.joint_centering import JointCentering
from coopqp.tasks.point_on_plane import PointOnPlane
from coopqp.tasks.point_on_point import PointOnPoint
from coopqp.tasks.pose import Pose

__all__ = ["JointCentering", "PointOnPlane", "PointOnPoint", "Pose"]
