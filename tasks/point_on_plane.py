"""A point of the object goes to a plane: one row along the plane's normal, paper eq. (35)-(37).

The plane goes through c with unit normal n; it may move, c_dot, and turn about an axis through c,
n_dot = omega x n. With p the point and h(t) the reference height above the plane, which shrinks
from where the point starts to 0:

    e = n'(p - c) - h,   J = n' J_p,   rate = n' c_dot - n_dot' (p - c) + h_dot
"""

from __future__ import annotations

from coopqp.base.spec import Vector3, spec
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.geometry import Reference, Turn
from coopqp.model.profile import Profile
from coopqp.program import Primitive, point
from coopqp.signal import Instant, MovingDirection, MovingPoint
from coopqp.task import Task


@spec
class PointOnPlane(Task):
    """A point of the object goes to a plane (1 row); five directions stay free."""

    normal: MovingDirection
    """Of the plane at the start, in the world; any length."""
    through: MovingPoint
    """A point of the plane at the start, in the world [m]."""
    point: Vector3 = (0.0, 0.0, 0.0)
    """The point that goes there, in the object frame [m]."""
    velocity: Vector3 = (0.0, 0.0, 0.0)
    """Of the plane itself, in the world [m/s]."""
    turn: Turn | None = None
    """Turn of the plane during the motion."""
    profile: Profile = Profile()
    """How the point's height above the plane goes to zero."""

    def rows(self, chain: ClosedChain) -> tuple[str, ...]:
        return ("normal",)

    def geometry(self, at: Instant) -> tuple[Primitive, ...]:
        place = self.through, self.normal, self.velocity, self.turn
        plane = Reference(*place, start=at, point=self.point)
        return (point(plane, self.point, self.profile, (2,)),)
