"""The limits as geometry: where the joints may be, and what room there is in space.

Margins of joints that are lengths or angles bound their positions; limits in space say what room
they leave (:meth:`coopqp.limit.Limit.clearance`). What bounds speeds is not in here.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

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


class Room:
    """What the limits of a problem leave.

    Attributes:
        lower, upper: of the joints, infinite without limits, shape (n,) [rad, m].
        sides: the row of each finite joint bound, by index and side.
        rows: of the rooms in space.
        owners: the limit that each of these rows belongs to, as an index into ``limits``.
        limits: those with rooms in space.
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
        """The rooms in space at a configuration, shape (p,) [m]."""
        self._look(q)
        return np.concatenate([np.zeros(0), *(left(self._state) for left, _ in self._left)])

    def gradient(self, q: Array) -> Array:
        """How they change with the joints, shape (p, n)."""
        self._look(q)
        slopes = (slope(self._state) for _, slope in self._left)
        return np.vstack([np.zeros((0, self.chain.n)), *slopes])

    def both(self, q: Array) -> tuple[Array, Array]:
        """Both, kept until another configuration is asked for."""
        if self._kept is None or not np.array_equal(self._kept[2], q):
            self._kept = self.at(q), self.gradient(q), q.copy()
        return self._kept[:2]

    def _look(self, q: Array) -> None:
        if self.rows and not np.array_equal(self._state.q, q):
            self._state.q[:] = q
            self._state.update()

    def nearest(self, owner: str, q: Array) -> tuple[Row, float] | None:
        """The pair of bodies of a limit with least room, and its distance [m]; None without."""
        left = zip(self.rows, self.at(q).tolist(), strict=True)
        found = [(x + row.kept, row) for row, x in left if row.owner == owner and row.bodies]
        if not found:
            return None
        distance, row = min(found, key=lambda pair: pair[0] - pair[1].kept)
        return row, distance

    def overrun(self, q: Array) -> float:
        """By how much a configuration is outside [rad, m]."""
        joints = np.maximum(self.lower - q, q - self.upper).max(initial=0.0)
        return float(max(joints, -self.at(q).min(initial=0.0)))

    def at_bound(self, q: Array) -> list[tuple[Row, Array]]:
        """The limits that a configuration is at, each with the joint motion that breaks it."""
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
    """How the rooms that a limit leaves change with the joints, shape (count, n)."""
    tighten, p = limit.bind(chain, dt), len(limit.rows(chain))
    G, h, (lb, ub) = np.zeros((p, chain.n)), np.zeros(p), np.zeros((2, chain.n))

    def slope(state: State) -> Array:
        lb[:] = ub[:] = 0.0  # where nothing moves, limits look no farther than their room does
        tighten(state, LimitRows(lb, ub, G, h))
        return -G[:count]

    return slope
