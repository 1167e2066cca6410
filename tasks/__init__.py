"""The tasks: one file each, the YAML name is the file's name."""

from coopqp.tasks.distance import Distance
from coopqp.tasks.impedance import Impedance
from coopqp.tasks.internal_wrench import InternalWrench
from coopqp.tasks.joint_centering import JointCentering
from coopqp.tasks.joint_limit_barrier import JointLimitBarrier
from coopqp.tasks.line_on_line import LineOnLine
from coopqp.tasks.line_on_plane import LineOnPlane
from coopqp.tasks.manipulability import Manipulability
from coopqp.tasks.minimum_kinetic_energy import MinimumKineticEnergy
from coopqp.tasks.minimum_velocity import MinimumVelocity
from coopqp.tasks.orientation import Orientation
from coopqp.tasks.plane_on_plane import PlaneOnPlane
from coopqp.tasks.point_on_circle import PointOnCircle
from coopqp.tasks.point_on_line import PointOnLine
from coopqp.tasks.point_on_plane import PointOnPlane
from coopqp.tasks.point_on_point import PointOnPoint
from coopqp.tasks.pointing import Pointing
from coopqp.tasks.pose import Pose
from coopqp.tasks.posture import Posture
from coopqp.tasks.prismatic import Prismatic
from coopqp.tasks.relative_motion import RelativeMotion
from coopqp.tasks.revolute import Revolute
from coopqp.tasks.twist import Twist

__all__ = [
    "Distance",
    "Impedance",
    "InternalWrench",
    "JointCentering",
    "JointLimitBarrier",
    "LineOnLine",
    "LineOnPlane",
    "Manipulability",
    "MinimumKineticEnergy",
    "MinimumVelocity",
    "Orientation",
    "PlaneOnPlane",
    "PointOnCircle",
    "PointOnLine",
    "PointOnPlane",
    "PointOnPoint",
    "Pointing",
    "Pose",
    "Posture",
    "Prismatic",
    "RelativeMotion",
    "Revolute",
    "Twist",
]
