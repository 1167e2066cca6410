"""Position limits as geometry, and which of them hold the tasks back, by their multipliers.

Joint limits bound q; limits in space give a clearance (:meth:`coopqp.limit.Limit.clearance`); those
of speeds are not in here. Where e' W e is minimal subject to closed loops and limits, with n_i the
joint motion that violates limit i,

    J' W e + J_c' lambda + sum mu_i n_i = 0,   mu_i >= 0

Projected on Z = null(J_c) the mu_i are a non-negative least squares problem. The share of limit i
is mu_i |Z' n_i|.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from coopqp.assessment.limits import audit
from coopqp.base.qp import Row
from coopqp.base.spec import Array
from coopqp.controller import ControlProblem
from coopqp.limit import Clearance, Limit, LimitRows
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.state import State

PLACE_UNITS = ("m", "rad")
#: This near to it a limit is at its bound [rad, m].
AT_BOUND = 1e-4
#: A limit with a smaller share is idle, and never named.
IDLE = 0.01


class Room:
    """The position limits of a problem.

    Attributes:
        lower, upper: of the joints, infinite without limits, shape (n,) [rad, m].
        sides: the row of each finite joint bound, by index and side.
        limits, rows: limits in space, and rows of their clearances.
        owners: index into ``limits`` of each of these rows.
    """

    def __init__(self, problem: ControlProblem) -> None:
        chain = self.chain = problem.chain
        self._dt = problem.dt
        self.lower, self.upper = np.full(chain.n, -np.inf), np.full(chain.n, np.inf)
        self.sides: dict[tuple[int, str], Row] = {}
        self.rows: tuple[Row, ...] = ()
        self.owners: list[int] = []
        self.limits: list[Limit] = []
        self._left: list[tuple[Clearance, Callable[[State], Array]]] = []
        self._state = State(chain)
        self._kept: tuple[Array, Array, Array] | None = None
        for limit in problem.limits:
            self._add(limit)

    def _add(self, limit: Limit) -> None:
        left = limit.clearance(self.chain)
        if left is not None:
            rows = limit.rows(self.chain)[: len(left(self._state))]
            self.owners += [len(self.limits)] * len(rows)
            self.rows += rows
            self.limits.append(limit)
            self._left.append((left, _slope(limit, self.chain, self._dt, len(rows))))
            return
        q, v = np.vstack([self.chain.q_start] * 2), np.zeros((1, self.chain.n))
        for row, margin in audit([limit], self.chain, q, v, self._dt).margins.items():
            if row.joint and row.side and row.unit in PLACE_UNITS:
                self._bound(row, float(margin[0]))

    def _bound(self, row: Row, margin: float) -> None:
        i = self.chain.joint_names.index(row.joint)
        at = float(self.chain.q_start[i])
        end = at - margin if row.side == "lower" else at + margin
        tighter = end > self.lower[i] if row.side == "lower" else end < self.upper[i]
        if tighter:
            (self.lower if row.side == "lower" else self.upper)[i] = end
            # Two limits of one place, such as braking before a stop, are one to people.
            label = row.label.rpartition(" of ")[2]
            self.sides[i, str(row.side)] = replace(row, label=label)

    def at(self, q: Array) -> Array:
        """Clearances of the limits in space at a configuration, shape (p,) [m]."""
        self._look(q)
        return np.concatenate([np.zeros(0), *(left(self._state) for left, _ in self._left)])

    def gradient(self, q: Array) -> Array:
        """Gradient of the clearances, shape (p, n)."""
        self._look(q)
        slopes = (slope(self._state) for _, slope in self._left)
        return np.vstack([np.zeros((0, self.chain.n)), *slopes])

    def both(self, q: Array) -> tuple[Array, Array]:
        """Clearances and gradient, cached until q changes."""
        if self._kept is None or not np.array_equal(self._kept[2], q):
            self._kept = self.at(q), self.gradient(q), q.copy()
        return self._kept[:2]

    def _look(self, q: Array) -> None:
        if self.rows and not np.array_equal(self._state.q, q):
            self._state.q[:] = q
            self._state.update()

    def nearest(self, owner: str, q: Array) -> tuple[Row, float] | None:
        """The pair of bodies of a limit with the smallest clearance, and its distance [m]."""
        left = zip(self.rows, self.at(q).tolist(), strict=True)
        found = [(x + row.kept, row) for row, x in left if row.owner == owner and row.bodies]
        if not found:
            return None
        distance, row = min(found, key=lambda pair: pair[0] - pair[1].kept)
        return row, distance

    def violation(self, q: Array) -> float:
        """Largest violation at a configuration [rad, m]."""
        joints = np.maximum(self.lower - q, q - self.upper).max(initial=0.0)
        return float(max(joints, -self.at(q).min(initial=0.0)))

    def at_bound(self, q: Array) -> list[tuple[Row, Array]]:
        """Active limits, each with the joint motion that violates it."""
        found = []
        for (i, side), row in self.sides.items():
            outward = np.zeros(len(q))
            outward[i] = -1.0 if side == "lower" else 1.0
            left = q[i] - self.lower[i] if side == "lower" else self.upper[i] - q[i]
            if left < AT_BOUND:
                found.append((row, outward))
        rooms = zip(self.rows, self.at(q), self.gradient(q), strict=True)
        return found + [(row, -way) for row, left, way in rooms if left < AT_BOUND]


def _slope(limit: Limit, chain: ClosedChain, dt: float, count: int) -> Callable[[State], Array]:
    """Gradient of a limit's clearances, shape (count, n)."""
    tighten, p = limit.bind(chain, dt), len(limit.rows(chain))
    G, h, (lb, ub) = np.zeros((p, chain.n)), np.zeros(p), np.zeros((2, chain.n))

    def slope(state: State) -> Array:
        lb[:] = ub[:] = 0.0  # at rest the rows of a limit are those of its clearances
        tighten(state, LimitRows(lb, ub, G, h))
        return -G[:count]

    return slope


@dataclass(frozen=True)
class Share:
    """The row of a limit, with its share of all limits' forces, 0 to 1."""

    row: Row
    share: float


def forces(pull: Array, Z: Array, ways: Sequence[tuple[Row, Array]]) -> list[tuple[Row, float]]:
    """mu_i |Z' n_i| of limits with joint motions n_i, which balance pull = -Z' J' W e."""
    from scipy.optimize import nnls  # its import takes a sixth of a second

    within = [(row, Z.T @ way) for row, way in ways]
    within = [(row, way) for row, way in within if np.linalg.norm(way) > 1e-9]
    if not within:
        return []
    columns = np.column_stack([way for _, way in within])
    amounts = nnls(columns, pull)[0] * np.linalg.norm(columns, axis=0)
    return [(row, float(amount)) for (row, _), amount in zip(within, amounts, strict=True)]


def shares(found: Iterable[tuple[Row, float]]) -> tuple[Share, ...]:
    """The limits' shares, largest first; forces on corners or sides of one limit are summed."""
    by_thing: dict[str, float] = {}
    leader: dict[str, tuple[float, Row]] = {}
    for row, amount in found:
        thing = thing_of(row)
        by_thing[thing] = by_thing.get(thing, 0.0) + amount
        if amount > leader.get(thing, (-1.0, row))[0]:
            leader[thing] = amount, row
    total = max(sum(by_thing.values()), 1e-300)
    named = [Share(leader[thing][1], amount / total) for thing, amount in by_thing.items()]
    large = [share for share in named if share.share >= IDLE]
    return tuple(sorted(large, key=lambda share: -share.share))


def thing_of(row: Row) -> str:
    """What a row is a side or a corner of: a joint's row itself, else the limit."""
    return row.name if row.joint or row.side else row.owner
