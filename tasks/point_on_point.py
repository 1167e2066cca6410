"""A point of the object goes to a point in space: three rows, paper eq. (38)-(39).

With p = p_WO + R_WO p_O and the reference r(t) = g(t) + (1 - s(t)) (p_start - g_start), which
goes from where the point is at the start to the goal g, be it at rest or a signal:

    e = p - r,   J = J_v - [R_WO p_O]x J_omega,   rate = r_dot
"""

from coopqp.base.spec import Vector3, spec
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.geometry import Reference
from coopqp.model.profile import Profile
from coopqp.program import Primitive, point
from coopqp.signal import Instant, MovingPoint
from coopqp.task import Task


@spec
class PointOnPoint(Task):
    """A point of the object goes to a point in space (3 rows); its orientation stays free."""

    goal: MovingPoint
    """Where the point shall go, in the world [m]."""
    point: Vector3 = (0.0, 0.0, 0.0)
    """The point, in the object frame [m]."""
    profile: Profile = Profile()
    """How the reference moves from the start to the goal."""

    def rows(self, chain: ClosedChain) -> tuple[str, ...]:
        return ("x", "y", "z")

    def geometry(self, at: Instant) -> tuple[Primitive, ...]:
        goal = Reference(self.goal, start=at, point=self.point)
        return (point(goal, self.point, self.profile, (0, 1, 2)),)
