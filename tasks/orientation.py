"""The object turns to an orientation: three rows; its place stays free.

The reference turns about one axis, R_r = exp(s phi) R_start with phi = log(R_goal R_start'). With
R_e = R R_r' and Jl the left Jacobian of SO(3),

    e = log R_e,   J = Jl^-1(e) J_omega,   rate = Jl^-1(e) R_e s_dot phi
"""

from typing import ClassVar

from coopqp.base.spec import Pose, Positive, Vector3, one_angle, spec
from coopqp.grasp import pose_matrix
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.profile import Profile
from coopqp.model.state import object_at
from coopqp.program import Primitive, rotation
from coopqp.signal import ROTATION, Instant, MovingRotation, Trajectory, quaternion_of
from coopqp.task import Task


@spec
class Orientation(Task):
    """The object turns to an orientation (3 rows); it may be anywhere."""

    unit: ClassVar[str] = "rad"

    rpy: Vector3 | None = None
    """Roll, pitch, yaw of the object at the end, about fixed x, y, z of the world [rad]."""
    rpy_deg: Vector3 | None = None
    """Roll, pitch, yaw [degrees]; instead of rpy."""
    goal: MovingRotation = None
    """A signal, instead of rpy."""
    profile: Profile = Profile()
    """How the reference turns from the start to the goal."""
    tolerance: Positive = 5e-3
    """Angle at the end that still counts as reached [rad]."""

    def __post_init__(self) -> None:
        one_angle("rpy", self.rpy, self.rpy_deg, needed=self.goal is None)
        if self.goal is not None and (self.rpy or self.rpy_deg):
            raise ValueError("give rpy, rpy_deg or goal, not two of them")

    def rows(self, chain: ClosedChain) -> tuple[str, ...]:
        return ("rot_x", "rot_y", "rot_z")

    def geometry(self, at: Instant) -> tuple[Primitive, ...]:
        """The reference sets out from how the object is turned then."""
        if self.goal is not None:
            goal = self.goal.bind(ROTATION, at, object_at(at, ROTATION))
        else:
            R = pose_matrix(Pose(rpy=self.rpy, rpy_deg=self.rpy_deg)).rotation
            goal = Trajectory(ROTATION, quaternion_of(R))
        return (rotation(goal, self.profile),)
