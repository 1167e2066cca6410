"""A line of the object goes into a plane in space: a height and an angle, two rows.

The line goes through the point p along the axis a of the object. The plane goes through c with
unit normal n; it may move, c_dot, and turn about an axis through c, omega. With beta the angle
between line and plane, w the unit vector along n x a and h(t) the reference, which shrinks from
the start to 0:

    e = [n'(p - c); beta] - h,   sin beta = n'a,   J = [n' J_p; -w' J_omega]

    rate = [n'(c_dot + omega x (p - c)); -w' omega] + h_dot

Where the line is normal to the plane it may fall any way; there w is normal to the first of the
plane's axes. The row of beta has length one everywhere. Khalil and Dombre 2004.
"""

from __future__ import annotations

from dataclasses import replace

from coopqp.base.spec import Direction, Positive, Vector3, spec, unit
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.geometry import Reference, Turn
from coopqp.model.profile import Profile
from coopqp.program import Kind, Primitive, point
from coopqp.signal import Instant, MovingDirection, MovingPoint
from coopqp.task import Part, Task, pose_parts


@spec
class LineOnPlane(Task):
    """A line of the object goes into a plane (2 rows); four motions stay free."""

    normal: MovingDirection
    """Of the plane at the start, in the world; any length."""
    through: MovingPoint
    """A point of the plane at the start, in the world [m]."""
    axis: Direction
    """Of the object's line, in the object frame; any length."""
    point: Vector3 = (0.0, 0.0, 0.0)
    """A point of the object's line, in the object frame [m]."""
    velocity: Vector3 = (0.0, 0.0, 0.0)
    """Of the plane itself, in the world [m/s]."""
    turn: Turn | None = None
    """Turn of the plane during the motion."""
    profile: Profile = Profile()
    """How height and angle go to zero."""
    tolerance_angle: Positive = 5e-3
    """Angle at the end that still counts as reached [rad]."""

    def rows(self, chain: ClosedChain) -> tuple[str, ...]:
        """The point's height above the plane and the line's angle to it."""
        return ("normal", "angle")

    def parts(self, chain: ClosedChain) -> tuple[Part, ...]:
        return pose_parts(1, 1, self.tolerance, self.tolerance_angle)

    def geometry(self, at: Instant) -> tuple[Primitive, ...]:
        place = self.through, self.normal, self.velocity, self.turn
        plane = Reference(*place, start=at, point=self.point)
        height, a_O = point(plane, self.point, self.profile, (2,)), unit(self.axis).tolist()
        return height, replace(height, kind=Kind.TILT, rows=(0,), axis=a_O)
