"""The limits as geometry: where the joints may be, and what room there is in space.

A limit is of place where its margins are lengths or angles; those of a joint bound its position,
the others are rooms that must not become negative. What bounds speeds is not in here.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from coopqp.checked import Array
from coopqp.closed_chain import ClosedChain
from coopqp.limit import Limit
from coopqp.qp_law.bounds import Bounds
from coopqp.row import Row
from coopqp.state import State

PLACE_UNITS = ("m", "rad")
#: This near to it a limit is at its bound [rad, m].
AT_BOUND = 1e-4


class Room:
    """What limits leave.

    Args:
        chain: what is limited.
        limits: all that count.
        dt: control period [s].

    Attributes:
        lower, upper: of the joints, infinite without limits, shape (n,) [rad, m].
        sides: the row of each finite joint bound, by index and side.
        rows: of the rooms in space.
        owners: the limit that each of these rows belongs to, as an index into ``limits``.
        limits: those with rooms in space.
    """

    def __init__(self, chain: ClosedChain, limits: Sequence[Limit], dt: float) -> None:
        self.chain, self._dt = chain, dt
        self.lower, self.upper = np.full(chain.n, -np.inf), np.full(chain.n, np.inf)
        self.sides: dict[tuple[int, str], Row] = {}
        self.rows: tuple[Row, ...] = ()
        self.owners: list[int] = []
        self.limits: list[Limit] = []
        self._gradients: list[tuple[Bounds, list[int]]] = []
        self._state = State(chain)
        for limit in limits:
            self._add(limit)

    def _add(self, limit: Limit) -> None:
        margins = _at(limit, self.chain, self.chain.q_start, self._dt)
        found = {row: m for row, m in margins.items() if row.unit in PLACE_UNITS}
        for row, margin in found.items():
            if row.joint and row.side:
                self._bound(row, margin)
        bounds = Bounds(self.chain, [limit], self._state, self._dt)
        names = [row.name for row in bounds.rows]
        rooms = [row for row in found if not row.joint and row.name in names]
        if rooms:
            self._gradients.append((bounds, [names.index(row.name) for row in rooms]))
            self.owners += [len(self.limits)] * len(rooms)
            self.rows += tuple(rooms)
            self.limits.append(limit)

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
        found: list[float] = []
        for limit in self.limits:
            margins = _at(limit, self.chain, q, self._dt)
            found += [m for row, m in margins.items() if row in self.rows]
        return np.array(found)

    def gradient(self, q: Array) -> Array:
        """How they change with the joints, shape (p, n)."""
        self._state.q[:] = q
        self._state.update()
        parts = []
        for bounds, rows in self._gradients:
            bounds.update(self._state)
            parts.append(-bounds.G[rows])
        return np.vstack(parts) if parts else np.zeros((0, self.chain.n))

    def overrun(self, q: Array) -> float:
        """By how much a configuration is outside [rad, m]."""
        joints = np.maximum(self.lower - q, q - self.upper).max(initial=0.0)
        return float(max(joints, -self.at(q).min(initial=0.0))) if self.rows else float(joints)

    def at_bound(self, q: Array, near: float = AT_BOUND) -> list[tuple[Row, Array]]:
        """The limits that a configuration is at, each with the joint motion that breaks it."""
        found = []
        for (i, side), row in self.sides.items():
            outward = np.zeros(len(q))
            outward[i] = -1.0 if side == "lower" else 1.0
            left = q[i] - self.lower[i] if side == "lower" else self.upper[i] - q[i]
            if left < near:
                found.append((row, outward))
        if self.rows:
            for row, left, way in zip(self.rows, self.at(q), self.gradient(q), strict=True):
                if left < near:
                    found.append((row, -way))
        return found


def _at(limit: Limit, chain: ClosedChain, q: Array, dt: float) -> dict[Row, float]:
    """A limit's margins where all stand still."""
    margins = limit.margins(chain, np.vstack([q, q]), np.zeros((1, chain.n)), dt)
    return {row: float(margin[0]) for row, margin in margins.items()}
