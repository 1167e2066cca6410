"""A point of the object goes to a plane: one row along the plane's normal, paper eq. (35)-(37).

The plane goes through c with unit normal n; it may move, c_dot, and turn about an axis through c,
n_dot = omega x n. With p the point and h(t) the reference height above the plane, which shrinks
from where the point starts to 0:

    e = n'(p - c) - h,   J = n' J_p,   rate = n' c_dot - n_dot' (p - c) + h_dot
"""

from coopqp.base.spec import spec
from coopqp.model.closed_chain import ClosedChain
from coopqp.program import Primitive, point
from coopqp.signal import Instant, MovingDirection
from coopqp.tasks._line_or_plane import ToLineOrPlane


@spec
class PointOnPlane(ToLineOrPlane):
    """A point of the object goes to a plane (1 row); five directions stay free."""

    normal: MovingDirection
    """Of the plane at the start, in the world; any length."""

    def rows(self, chain: ClosedChain) -> tuple[str, ...]:
        return ("normal",)

    def geometry(self, at: Instant) -> tuple[Primitive, ...]:
        plane = self.reference(self.normal, at)
        return (point(plane, self.point, self.profile, (2,)),)
