"""The object goes to a pose: six rows.

The reference goes straight and turns about one axis, phi = log(R_goal R_start'):

    p_r = p_start + s (p_goal - p_start),   R_r = exp(s phi) R_start

With R_e = R R_r' and Jl the left Jacobian of SO(3),

    e = [p - p_r; log R_e],   J = [J_v; Jl^-1 J_omega],   rate = [p_r_dot; Jl^-1 R_e s_dot phi]
"""

from coopqp.base.spec import Positive, spec
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.geometry import PlaceOf, Reference
from coopqp.model.profile import Profile
from coopqp.model.state import object_at
from coopqp.program import Primitive, point, rotation
from coopqp.signal import POSE, Instant, MovingPose, trajectory_of
from coopqp.task import Part, Task, pose_parts


@spec
class Pose(Task):
    """The object goes to a pose (6 rows); needs six degrees of freedom of the object."""

    goal: MovingPose
    """Of the object, in the world."""
    profile: Profile = Profile()
    """How the reference moves from the start to the goal."""
    tolerance_angle: Positive = 5e-3
    """Orientation error at the end that still counts as reached [rad]."""

    def rows(self, chain: ClosedChain) -> tuple[str, ...]:
        return ("x", "y", "z", "rot_x", "rot_y", "rot_z")

    def parts(self, chain: ClosedChain) -> tuple[Part, ...]:
        return pose_parts(3, 3, self.tolerance, self.tolerance_angle)

    def geometry(self, at: Instant) -> tuple[Primitive, ...]:
        goal = trajectory_of(self.goal, POSE, at, object_at(at, POSE))
        goal.update(at)
        place = point(Reference(PlaceOf(goal)), (0.0, 0.0, 0.0), self.profile, (0, 1, 2))
        return place, rotation(goal, self.profile)
