"""A plane of the object goes onto a plane in space: a height and two angles, three rows.

The object's plane goes through the point p with normal a, the one in space through c with unit
normal n; that may move, c_dot, and turn about an axis through c, omega. The normals point the same
way; to lay the faces against each other turn one round. With h(t) the reference height, which
shrinks from the start to 0, and theta u the angle and way of a from its reference
(``geometry.inverse_alignment``):

    e = [n'(p - c) - h; theta u]

Khalil and Dombre 2004.
"""

from __future__ import annotations

from coopqp.base.spec import Direction, Positive, Vector3, spec
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.geometry import Reference, Turn
from coopqp.model.profile import Profile
from coopqp.program import Primitive, lean, point
from coopqp.signal import Instant, MovingDirection, MovingPoint
from coopqp.task import Part, Task, pose_parts


@spec
class PlaneOnPlane(Task):
    """A plane of the object goes onto a plane (3 rows); it may slide and spin there."""

    normal: MovingDirection
    """Of the plane at the start, in the world; any length."""
    through: MovingPoint
    """A point of the plane at the start, in the world [m]."""
    axis: Direction
    """Normal of the object's plane, in the object frame; any length."""
    point: Vector3 = (0.0, 0.0, 0.0)
    """A point of the object's plane, in the object frame [m]."""
    velocity: Vector3 = (0.0, 0.0, 0.0)
    """Of the plane itself, in the world [m/s]."""
    turn: Turn | None = None
    """Turn of the plane during the motion."""
    profile: Profile = Profile()
    """How offset and angle go to zero."""
    tolerance_angle: Positive = 5e-3
    """Angle at the end that still counts as reached [rad]."""

    def rows(self, chain: ClosedChain) -> tuple[str, ...]:
        """The point's height above the plane and how far the normal leans."""
        return ("normal", "lean_1", "lean_2")

    def parts(self, chain: ClosedChain) -> tuple[Part, ...]:
        return pose_parts(1, 2, self.tolerance, self.tolerance_angle)

    def geometry(self, at: Instant) -> tuple[Primitive, ...]:
        place = self.through, self.normal, self.velocity, self.turn
        plane = Reference(*place, start=at, point=self.point, axis=self.axis)
        height = point(plane, self.point, self.profile, (2,))
        return height, lean(plane, self.axis, self.profile)
