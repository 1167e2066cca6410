"""A point of the object goes to a point in space: three rows, paper eq. (38)-(39).

With p = p_WO + R_WO p_O and the reference r(t) = p_start + s(t) (goal - p_start):

    e = p - r,   J = J_v - [R_WO p_O]x J_omega,   rate = r_dot
"""

from __future__ import annotations

import numpy as np

from coopqp.checked import Vector3, spec
from coopqp.closed_chain import ClosedChain
from coopqp.geometry import Reference
from coopqp.mark import Mark, PointMark, TrackedMark
from coopqp.profile import Profile
from coopqp.program import Primitive, point
from coopqp.state import PointOfObject, State
from coopqp.task import Evaluate, Task, TaskRows


@spec
class PointOnPoint(Task):
    """A point of the object goes to a point in space (3 rows); its orientation stays free."""

    goal: Vector3
    """Where the point shall go, in the world [m]."""
    point: Vector3 = (0.0, 0.0, 0.0)
    """The point, in the object frame [m]."""
    profile: Profile = Profile()
    """How the reference moves from the start to the goal."""

    def rows(self, chain: ClosedChain) -> tuple[str, ...]:
        """The three world axes."""
        return ("x", "y", "z")

    @property
    def end(self) -> float:
        """When the reference arrives [s]."""
        return self.profile.end

    def bind(self, start: State) -> Evaluate:
        """The reference sets out from where the point is now."""
        tracked, profile = PointOfObject(self.point, start.chain.n), self.profile
        tracked.update(start)
        p_start = tracked.p.copy()
        way = np.array(self.goal) - p_start

        def evaluate(state: State, rows: TaskRows) -> None:
            share, speed = profile.at(state.t)
            tracked.update(state)
            np.subtract(tracked.p, p_start, rows.e)
            np.multiply(way, share, rows.rate)
            np.subtract(rows.e, rows.rate, rows.e)
            np.multiply(way, speed, rows.rate)
            rows.J[:] = tracked.J

        return evaluate

    def program(self, start: State) -> tuple[Primitive, ...]:
        """As primitives."""
        goal = Reference(self.goal)
        return (point(start, goal, self.point, self.profile, (0, 1, 2)),)

    def marks(self, t: float) -> tuple[Mark, ...]:
        """The goal, and the point that goes there."""
        return PointMark(at=np.array(self.goal)), TrackedMark(point=self.point)
