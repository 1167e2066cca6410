"""The object is brought onto a slide in space: turned as it shall be, a point on a line, five rows.

The line goes through c along the unit vector d; it may move, c_dot, and turn about an axis through
c, omega, and then the object turns with it. What stays free is a virtual prismatic joint. With
R the line's axes, the third along d, T the first two, Q = R' R_WO how the object is turned to
them, Q_r = exp(s phi) Q_start, Q_e = Q Q_r' and h(t) the reference offset, which shrinks from the
start to 0:

    e = [T'(p - c) - h; log Q_e],   J = [T' J_p; Jl^-1 R' J_omega]

    rate = [T'(c_dot + omega x (p - c)) + h_dot; Jl^-1 (R' omega + Q_e s_dot phi)]

Jl is the left Jacobian of SO(3) at log Q_e. Khalil and Dombre 2004.
"""

from typing import ClassVar

from coopqp.base.spec import Pose, Vector3, one_angle, spec
from coopqp.grasp import pose_matrix
from coopqp.model.closed_chain import ClosedChain
from coopqp.program import Primitive, point, rotation
from coopqp.signal import ROTATION, Instant, MovingDirection, Trajectory, quaternion_of
from coopqp.tasks._line_or_plane import OntoLineOrPlane


@spec
class Prismatic(OntoLineOrPlane):
    """A point of the object goes to a line and it keeps its orientation (5 rows); it may slide."""

    angles: ClassVar[int] = 3

    direction: MovingDirection
    """Of the line at the start, in the world; any length."""
    rpy: Vector3 | None = None
    """Roll, pitch, yaw of the object, before the line turns [rad]; as at the start if omitted."""
    rpy_deg: Vector3 | None = None
    """Roll, pitch, yaw [degrees]; instead of rpy."""

    def __post_init__(self) -> None:
        one_angle("rpy", self.rpy, self.rpy_deg)

    def rows(self, chain: ClosedChain) -> tuple[str, ...]:
        """The offset normal to the line and rotation about the same directions and the line."""
        return ("across_1", "across_2", "rot_1", "rot_2", "rot_along")

    def geometry(self, at: Instant) -> tuple[Primitive, ...]:
        line = self.reference(self.direction, at)
        goal = None
        if self.rpy is not None or self.rpy_deg is not None:
            R = pose_matrix(Pose(rpy=self.rpy, rpy_deg=self.rpy_deg)).rotation
            goal = Trajectory(ROTATION, quaternion_of(line.RT @ R))
        offset = point(line, self.point, self.profile, (0, 1))
        return offset, rotation(goal, self.profile, line)
