"""The tasks: one file each, the YAML name is the file's name."""

from coopqp.tasks.distance import Distance as Distance
from coopqp.tasks.impedance import Impedance as Impedance
from coopqp.tasks.internal_wrench import InternalWrench as InternalWrench
from coopqp.tasks.joint_centering import JointCentering as JointCentering
from coopqp.tasks.joint_limit_barrier import JointLimitBarrier as JointLimitBarrier
from coopqp.tasks.line_on_line import LineOnLine as LineOnLine
from coopqp.tasks.line_on_plane import LineOnPlane as LineOnPlane
from coopqp.tasks.manipulability import Manipulability as Manipulability
from coopqp.tasks.minimum_kinetic_energy import MinimumKineticEnergy as MinimumKineticEnergy
from coopqp.tasks.minimum_velocity import MinimumVelocity as MinimumVelocity
from coopqp.tasks.orientation import Orientation as Orientation
from coopqp.tasks.plane_on_plane import PlaneOnPlane as PlaneOnPlane
from coopqp.tasks.point_on_circle import PointOnCircle as PointOnCircle
from coopqp.tasks.point_on_line import PointOnLine as PointOnLine
from coopqp.tasks.point_on_plane import PointOnPlane as PointOnPlane
from coopqp.tasks.point_on_point import PointOnPoint as PointOnPoint
from coopqp.tasks.pointing import Pointing as Pointing
from coopqp.tasks.pose import Pose as Pose
from coopqp.tasks.posture import Posture as Posture
from coopqp.tasks.prismatic import Prismatic as Prismatic
from coopqp.tasks.relative_motion import RelativeMotion as RelativeMotion
from coopqp.tasks.revolute import Revolute as Revolute
from coopqp.tasks.twist import Twist as Twist
