"""The object is brought onto a hinge in space: point on point, axis on axis, five rows.

The object's point p goes to c and its axis a to the unit vector d; the hinge may move, c_dot, and
turn about an axis through c, omega. What stays free is a virtual revolute joint. With R the hinge's
axes, the third along d, h(t) the reference offset, which shrinks from the start to 0, and theta u
the angle and way of a from its reference (``geometry.inverse_alignment``):

    e = [R'(p - c) - h; theta u]

Khalil and Dombre 2004.
"""

from typing import ClassVar

from coopqp.base.spec import Direction, spec
from coopqp.model.closed_chain import ClosedChain
from coopqp.program import Primitive, lean, point
from coopqp.signal import Instant, MovingDirection
from coopqp.tasks._line_or_plane import OntoLineOrPlane


@spec
class Revolute(OntoLineOrPlane):
    """A point and an axis of the object go onto a hinge in space (5 rows); it may spin there."""

    angles: ClassVar[int] = 2

    direction: MovingDirection
    """Of the hinge at the start, in the world; any length."""
    axis: Direction
    """The axis that goes onto the hinge, in the object frame; any length."""

    def rows(self, chain: ClosedChain) -> tuple[str, ...]:
        """The point's offset across and along the hinge and how the axis leans."""
        return ("across_1", "across_2", "along", "lean_1", "lean_2")

    def geometry(self, at: Instant) -> tuple[Primitive, ...]:
        hinge = self.reference(self.direction, at, self.axis)
        offset = point(hinge, self.point, self.profile, (0, 1, 2))
        return offset, lean(hinge, self.axis, self.profile)
