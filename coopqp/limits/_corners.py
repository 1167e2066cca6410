"""More points of pairs that lie along each other, so that none of them turns in.

Where an edge or a face of one body lies along another body, the nearest points jump from end to
end: a row at one of them lets the other turn in, and a tick later the first one. So the ends of
what is close get rows too. With n the pair's normal and p a corner of the body that reaches less
far along the other, its distance from the plane that bounds the other is s, and

    n' (J_first - J_second) v <= gain (s - distance)

at p: the plane is fixed to its body and turns with it. Bodies are never nearer than that plane.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from coopqp.base.spec import Array
from coopqp.limits._distances import Distances, Pair

#: How many rows there are, and how many of them a pair can have.
ROWS, EACH = 24, 3

#: Pairs with less room than this have corners [m].
CLOSE = 0.005

#: Corners are this much farther away than the nearest point at most [m].
SLAB = 0.002


class Corners:
    """Corners of the closest pairs, in a fixed number of rows.

    Attributes:
        room: margin of each corner to the distance kept from the other body's plane; that of rows
            without a corner is large, shape (ROWS,) [m].
        pair: which pair each corner belongs to, shape (ROWS,).
        W: [n; p x n] of each, zero without a corner, shape (ROWS, 6).
        count: how many rows have a corner.
    """

    def __init__(self, pairs: Sequence[Pair], found: Distances, distance: float) -> None:
        self._pairs, self._found, self._distance = pairs, found, distance
        self._flat = np.array([_lie_along(pair) for pair in pairs], bool)
        self.room, self.W = np.ones(ROWS), np.zeros((ROWS, 6))
        self.pair, self.count = np.zeros(ROWS, np.int64), 0

    def update(self) -> None:
        """Find the corners of the closest pairs."""
        found = self._found
        if self.count:
            self.room[:], self.W[:], self.count = 1.0, 0.0, 0
        room = found.d[found.near] - self._distance
        (close,) = (room < CLOSE).nonzero()
        for k in close[room[close].argsort(kind="stable")].tolist():
            pair = int(found.near[k])
            if not self._flat[pair]:
                continue
            n, p = found.n[k, :3], found.p[k, :3]
            for corner, s in self._corners(pair, n, p)[: ROWS - self.count]:
                self.room[self.count], self.pair[self.count] = s - self._distance, pair
                self.W[self.count] = _wrench(n, corner)
                self.count += 1

    def _corners(self, pair: int, n: Array, p: Array) -> list[tuple[Array, float]]:
        """Points, and how far each is from the plane that bounds the other body [m]."""
        first, a = self._ends(pair, 0, n)
        if len(a) == 1:
            return []  # it touches in its nearest point alone
        second, b = self._ends(pair, 1, n)
        if len(b) == 1:
            return []
        if _width(first) <= _width(second):
            bottom = float(b.min())
            return [(first[i], bottom - float(a[i])) for i in _spread(first, p)]
        top = float(a.max())
        return [(second[i], float(b[i]) - top) for i in _spread(second, p)]

    def _ends(self, pair: int, side: int, n: Array) -> tuple[Array, Array]:
        """A body's points next to the plane that bounds it, and their heights along n."""
        convex = self._pairs[pair][side].convex
        X = self._found.placed.oMg[self._found.ids[pair][side]]
        out = -1.0 if side else 1.0
        R, o = X.rotation, X.translation
        heights = convex.points.dot(n.dot(R))
        ends = heights > heights.max() - SLAB if out > 0.0 else heights < heights.min() + SLAB
        points = convex.points[ends].dot(R.T) + o
        return points, heights[ends] + (float(n.dot(o)) + out * convex.rim)


def _lie_along(pair: Pair) -> bool:
    """Whether two bodies can touch in more than one point."""
    return all(len(body.convex.points) > 1 for body in pair)


def _width(points: Array) -> float:
    return float((points.max(axis=0) - points.min(axis=0)).max())


def _spread(points: Array, p: Array) -> list[int]:
    """Up to three of the points, far from p and from each other."""
    if len(points) <= EACH:
        return list(range(len(points)))
    one = int(((points - p) ** 2).sum(axis=1).argmax())
    away = points - points[one]
    other = int((away**2).sum(axis=1).argmax())
    return [one, other, int((np.cross(away, away[other]) ** 2).sum(axis=1).argmax())]


def _wrench(n: Array, p: Array) -> tuple[float, ...]:
    """The row of a point that moves along n, [n; p x n]."""
    (x, y, z), (a, b, c) = p.tolist(), n.tolist()
    return a, b, c, y * c - z * b, z * a - x * c, x * b - y * a
