"""A second look at a path, by pinocchio and coal: nothing of the planner's kernel is used.

Between its points a path is the straight line in joint space. At equal distances along it, it is
looked at whether loops are closed, joints inside their limits and bodies as far apart as asked.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from coopqp.base.spec import Array
from coopqp.controller import ControlProblem
from coopqp.limit import DistanceBounds, Program
from coopqp.model.state import State
from coopqp.planning.closed_path import Loops, lengths, on_lines

#: What a loop may be open by between the points of a path [m, rad], and a joint beyond its limit.
OPEN, BEYOND = 1e-5, 1e-9


@dataclass(frozen=True)
class Verification:
    """What was seen along a path.

    Attributes:
        points: that were looked at.
        open: largest loop error [m, rad].
        beyond: how far a joint is outside its limits, at most [rad, m].
        hits: points at which a limit in space is not kept.
    """

    points: int
    open: float
    beyond: float
    hits: int

    @property
    def good(self) -> bool:
        return self.open <= OPEN and self.beyond <= BEYOND and not self.hits

    @property
    def words(self) -> str:
        """What is wrong; empty where nothing is."""
        wrong = [f"{self.hits} of {self.points} points break a limit in space"] * bool(self.hits)
        if self.open > OPEN:
            wrong.append(f"a loop is open by {1e3 * self.open:.3g} mm or mrad")
        if self.beyond > BEYOND:
            wrong.append(f"a joint is {self.beyond:.3g} outside its limits")
        return ", ".join(wrong)


class Verifier:
    """Looks at paths of a problem.

    Args:
        problem: whose limits count.
        lower, upper: of the joints, shape (n,) [rad, m].
        programs: of the limits; asked anew when omitted.
    """

    def __init__(
        self, problem: ControlProblem, lower: Array, upper: Array,
        programs: Sequence[Program | None] = (),
    ) -> None:  # fmt: skip
        chain = self._chain = problem.chain
        self._loops = Loops(chain)
        self._lower, self._upper = lower, upper
        self._data, margins = chain.model.createData(), list[float]()
        self._geometry = geometry = pin.GeometryModel()
        programs = programs or [limit.program(chain, problem.dt) for limit in problem.limits]
        for bounds in (one for one in programs if isinstance(one, DistanceBounds)):
            first = geometry.ngeoms
            for joint, convex in bounds.bodies:
                convex.geometry.computeLocalAABB()
                at = f"{geometry.ngeoms}", joint, convex.placement, convex.geometry
                geometry.addGeometryObject(pin.GeometryObject(*at))
            for a, b in (first + bounds.pairs).tolist():
                geometry.addCollisionPair(pin.CollisionPair(a, b))
            margins += [bounds.distance] * len(bounds.pairs)
        self._others = others(problem, programs)
        self._placed = pin.GeometryData(geometry)
        for i, margin in enumerate(margins):
            request = self._placed.collisionRequests[i]
            request.security_margin, request.num_max_contacts = margin, 1
            self._placed.collisionRequests[i] = request
        # It asks all boxes, which for a robot's few bodies is less than keeping a tree of them.
        kind = pin.BroadPhaseManager_NaiveCollisionManager
        self._manager = kind(chain.model, geometry, self._placed)

    def look(self, q: Array, every: float) -> Verification:
        """Look at a path q, shape (K, n), each so many radians or metres."""
        points = along(q, every)
        hits = sum(not self.free(row) for row in points)
        opened = self._loops.gaps(points).max(initial=0.0)
        beyond = np.maximum(points - self._upper, self._lower - points).max(initial=0.0)
        return Verification(len(points), float(opened), float(beyond), hits)

    def free(self, q: Array) -> bool:
        """Whether the limits in space are kept at q."""
        model, data = self._chain.model, self._data
        if pin.computeCollisions(model, data, self._manager, q, True):
            return False
        return self._others is None or self._others(q)


def others(
    problem: ControlProblem, programs: Sequence[Program | None]
) -> Callable[[Array], bool] | None:
    """Whether limits in space that are no distances are kept; None where there are none."""
    chain, state = problem.chain, State(problem.chain)
    left = [
        clearance
        for limit, program in zip(problem.limits, programs, strict=True)
        if not isinstance(program, DistanceBounds) and (clearance := limit.clearance(chain))
    ]

    def kept(q: Array) -> bool:
        state.q[:] = q
        state.update()
        return all(bool((clearance(state) >= 0.0).all()) for clearance in left)

    return kept if left else None


def along(q: Array, every: float) -> Array:
    """Points on the straight lines between rows of q at equal distances, both ends included."""
    s = lengths(q)
    if len(q) < 2 or s[-1] == 0.0:
        return q[:1].copy()
    at = np.linspace(0.0, s[-1], int(np.ceil(s[-1] / every)) + 1)
    return on_lines(at, s, q)
