"""A point of the object goes to a line in space: two rows across the line.

The line goes through c along the unit vector d; it may move, c_dot, and turn about an axis through
c, omega. T = [t_1 t_2] is a basis of the plane normal to d that turns with the line. With p the
point and h(t) the reference offset, which shrinks from where the point starts to 0:

    e = T'(p - c) - h,   J = T' J_p,   rate = T'(c_dot + omega x (p - c)) + h_dot

One of Dombre's minimum task descriptions, Khalil and Dombre 2004.
"""

from coopqp.base.spec import spec
from coopqp.model.closed_chain import ClosedChain
from coopqp.program import Primitive, point
from coopqp.signal import Instant, MovingDirection
from coopqp.tasks._line_or_plane import ToLineOrPlane


@spec
class PointOnLine(ToLineOrPlane):
    """A point of the object goes to a line (2 rows); it may slide along and turn."""

    direction: MovingDirection
    """Of the line at the start, in the world; any length."""

    def rows(self, chain: ClosedChain) -> tuple[str, ...]:
        """The offset along two directions normal to the line."""
        return ("across_1", "across_2")

    def geometry(self, at: Instant) -> tuple[Primitive, ...]:
        line = self.reference(self.direction, at)
        return (point(line, self.point, self.profile, (0, 1)),)
