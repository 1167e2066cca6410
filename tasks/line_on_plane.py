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

from dataclasses import replace
from typing import ClassVar

from coopqp.base.spec import Direction, spec, unit
from coopqp.model.closed_chain import ClosedChain
from coopqp.program import Kind, Primitive, point
from coopqp.signal import Instant, MovingDirection
from coopqp.tasks._line_or_plane import OntoLineOrPlane


@spec
class LineOnPlane(OntoLineOrPlane):
    """A line of the object goes into a plane (2 rows); four motions stay free."""

    angles: ClassVar[int] = 1

    normal: MovingDirection
    """Of the plane at the start, in the world; any length."""
    axis: Direction
    """Of the object's line, in the object frame; any length."""

    def rows(self, chain: ClosedChain) -> tuple[str, ...]:
        """The point's height above the plane and the line's angle to it."""
        return ("normal", "angle")

    def geometry(self, at: Instant) -> tuple[Primitive, ...]:
        plane = self.reference(self.normal, at)
        height, a_O = point(plane, self.point, self.profile, (2,)), unit(self.axis).tolist()
        return height, replace(height, kind=Kind.TILT, rows=(0,), axis=a_O)
