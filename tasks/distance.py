"""A point of the object goes to a distance from a point in space: one row.

With p the point, c the other one, which may move at c_dot, r the distance, u = (p - c) / |p - c|
and h(t) the reference, which shrinks from the start to 0:

    e = |p - c| - r - h,   J = u' J_p,   rate = u' c_dot + h_dot

Where the two points coincide u is the world's x axis: the row stays finite and the point leaves.
"""

from dataclasses import replace

from coopqp.base.spec import Positive, Vector3, spec
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.geometry import Reference
from coopqp.model.profile import Profile
from coopqp.program import Kind, Primitive, point
from coopqp.signal import Instant, MovingPoint
from coopqp.task import Task


@spec
class Distance(Task):
    """A point of the object goes to a distance from a point in space (1 row), a sphere."""

    to: MovingPoint
    """The point in space at the start, in the world [m]."""
    length: Positive
    """The distance [m]."""
    point: Vector3 = (0.0, 0.0, 0.0)
    """The point of the object, in the object frame [m]."""
    velocity: Vector3 = (0.0, 0.0, 0.0)
    """Of the point in space, in the world [m/s]."""
    profile: Profile = Profile()
    """How the distance goes from what it is at the start to the length."""

    def rows(self, chain: ClosedChain) -> tuple[str, ...]:
        """The way from the point in space to the object's."""
        return ("distance",)

    @property
    def curvature(self) -> float:
        return 1.0 / self.length

    def geometry(self, at: Instant) -> tuple[Primitive, ...]:
        other = Reference(self.to, velocity=self.velocity, start=at)
        place = point(other, self.point, self.profile, (0,))
        return (replace(place, kind=Kind.RADIAL, length=self.length),)
