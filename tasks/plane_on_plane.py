"""A plane of the object goes onto a plane in space: a height and two angles, three rows.

The object's plane goes through the point p with normal a, the one in space through c with unit
normal n; that may move, c_dot, and turn about an axis through c, omega. The normals point the same
way; to lay the faces against each other turn one round. With h(t) the reference height, which
shrinks from the start to 0, and theta u the angle and way of a from its reference
(``geometry.inverse_alignment``):

    e = [n'(p - c) - h; theta u]

Khalil and Dombre 2004.
"""

from typing import ClassVar

from coopqp.base.spec import Direction, spec
from coopqp.model.closed_chain import ClosedChain
from coopqp.program import Primitive, lean, point
from coopqp.signal import Instant, MovingDirection
from coopqp.tasks._line_or_plane import OntoLineOrPlane


@spec
class PlaneOnPlane(OntoLineOrPlane):
    """A plane of the object goes onto a plane (3 rows); it may slide and spin there."""

    angles: ClassVar[int] = 2

    normal: MovingDirection
    """Of the plane at the start, in the world; any length."""
    axis: Direction
    """Normal of the object's plane, in the object frame; any length."""

    def rows(self, chain: ClosedChain) -> tuple[str, ...]:
        """The point's height above the plane and how far the normal leans."""
        return ("normal", "lean_1", "lean_2")

    def geometry(self, at: Instant) -> tuple[Primitive, ...]:
        plane = self.reference(self.normal, at, self.axis)
        height = point(plane, self.point, self.profile, (2,))
        return height, lean(plane, self.axis, self.profile)
