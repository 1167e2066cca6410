"""A point of the object goes to a circle in space: its radius and its height, two rows.

The circle has center c, unit normal n and radius r; it may move, c_dot, and turn about an axis
through c, omega. With x = (x_1, x_2, x_3) the point in axes that turn with the circle, the third
along n, u = (x_1, x_2) / |(x_1, x_2)| and h(t) the reference, which shrinks from the start to 0:

    e = [|(x_1, x_2)| - r; x_3] - h,   J = [u' 0; 0 0 1] J_x

On the circle's axis, where no way out is shortest, u is the first of the circle's axes: the rows
stay finite and the point leaves the axis.
"""

from dataclasses import replace

from coopqp.base.spec import Positive, Vector3, spec
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.geometry import Reference, Turn
from coopqp.model.profile import Profile
from coopqp.program import Kind, Primitive, point
from coopqp.signal import Instant, MovingDirection, MovingPoint
from coopqp.task import Task


@spec
class PointOnCircle(Task):
    """A point of the object goes to a circle (2 rows); it may go round and turn."""

    center: MovingPoint
    """Of the circle at the start, in the world [m]."""
    normal: MovingDirection
    """Of the circle's plane at the start, in the world; any length."""
    radius: Positive
    """[m]"""
    point: Vector3 = (0.0, 0.0, 0.0)
    """The point that goes there, in the object frame [m]."""
    velocity: Vector3 = (0.0, 0.0, 0.0)
    """Of the circle itself, in the world [m/s]."""
    turn: Turn | None = None
    """Turn of the circle during the motion, about an axis through its center."""
    profile: Profile = Profile()
    """How the point's offset from the circle goes to zero."""

    def rows(self, chain: ClosedChain) -> tuple[str, ...]:
        """The distance from the circle's axis and the height above its plane."""
        return ("radius", "normal")

    @property
    def curvature(self) -> float:
        return 1.0 / self.radius

    def geometry(self, at: Instant) -> tuple[Primitive, ...]:
        circle = Reference(self.center, self.normal, self.velocity, self.turn, start=at)
        height = point(circle, self.point, self.profile, (2,))
        distance = replace(height, kind=Kind.RADIAL, rows=(0,), length=self.radius, planar=True)
        return distance, height
