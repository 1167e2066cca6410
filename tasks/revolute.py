"""The object is brought onto a hinge in space: point on point, axis on axis, five rows.

The object's point p goes to c and its axis a to the unit vector d; the hinge may move, c_dot, and
turn about an axis through c, omega. What stays free is a virtual revolute joint. With R the hinge's
axes, the third along d, h(t) the reference offset, which shrinks from the start to 0, and theta u
the angle and way of a from its reference (``geometry.inverse_alignment``):

    e = [R'(p - c) - h; theta u]

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
class Revolute(Task):
    """A point and an axis of the object go onto a hinge in space (5 rows); it may spin there."""

    direction: MovingDirection
    """Of the hinge at the start, in the world; any length."""
    through: MovingPoint
    """Where the point goes, a point of the hinge at the start, in the world [m]."""
    axis: Direction
    """The axis that goes onto the hinge, in the object frame; any length."""
    point: Vector3 = (0.0, 0.0, 0.0)
    """The point that goes there, in the object frame [m]."""
    velocity: Vector3 = (0.0, 0.0, 0.0)
    """Of the hinge itself, in the world [m/s]."""
    turn: Turn | None = None
    """Turn of the hinge during the motion."""
    profile: Profile = Profile()
    """How offset and angle go to zero."""
    tolerance_angle: Positive = 5e-3
    """Angle at the end that still counts as reached [rad]."""

    def rows(self, chain: ClosedChain) -> tuple[str, ...]:
        """The point's offset across and along the hinge and how the axis leans."""
        return ("across_1", "across_2", "along", "lean_1", "lean_2")

    def parts(self, chain: ClosedChain) -> tuple[Part, ...]:
        return pose_parts(3, 2, self.tolerance, self.tolerance_angle)

    def geometry(self, at: Instant) -> tuple[Primitive, ...]:
        place = self.through, self.direction, self.velocity, self.turn
        hinge = Reference(*place, start=at, point=self.point, axis=self.axis)
        offset = point(hinge, self.point, self.profile, (0, 1, 2))
        return offset, lean(hinge, self.axis, self.profile)
