"""What self_collision and obstacles have in common: rows that keep pairs of bodies apart.

With d a distance, or that of a corner from a plane (:class:`Corners`), each row is
-d_dot <= gain (d - distance). What is too close recovers, but no faster than joints at
``BACK`` can do: where d hardly changes with the joints, no speed could. What is in each other may
not go deeper and is not pushed apart.
"""

import math
from abc import abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np

from coopqp.base.errors import InvalidValueError
from coopqp.base.qp import Row
from coopqp.base.spec import UNLIMITED, Array, Name, NonNegative, Positive, overshoot, spec
from coopqp.limit import (
    SHALLOW,
    Clearance,
    DistanceBounds,
    Limit,
    LimitRows,
    Tighten,
    damp,
    movers,
    place_row,
    states_along,
)
from coopqp.limits._bodies import Body, Distances, Pair, bodies_of
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.state import State

#: Speed of the joints that suffices for the recovery of pairs [rad/s, m/s].
BACK = 0.1

#: Pairs that one limit watches at most: a tick with so many takes some milliseconds.
MAX_PAIRS = 2500
#: Bodies that start nearer than asked by less are not worth a word [m].
WORTH_SAYING = 5e-5
#: How many of those that do are named.
SHOWN = 3
#: How many rows of corners there are, and how many of them a pair can have.
ROWS, EACH = 24, 3
#: Pairs with a smaller margin have corners [m].
CLOSE = 0.005
#: Corners are this much farther away than the nearest point at most [m]; for all of that a corner
#: may come nearer by so many times the gain, so that none that appears stops the joints at once.
SLAB, LATER = 0.002, 3.0
#: Sizes of corners are the same that differ by less, or by such a share [m, -].
EVEN = 1e-9
#: Speed of a joint that nothing bounds [rad/s, m/s].
FASTEST = 1e6


def check_count(name: str, count: int) -> None:
    """InvalidValueError for more pairs than can be watched, with what to do."""
    if count > MAX_PAIRS:
        raise InvalidValueError(
            f"{name}: watches {count} pairs, at most {MAX_PAIRS} can be; name the bodies that "
            "can meet, or make several things one"
        )


@spec
class KeepApart(Limit):
    """A limit that keeps pairs of bodies at a distance, by dampers."""

    name: Name
    """Yours for it."""
    distance: NonNegative = 0.01
    """Kept free between two that are watched [m]."""
    gain: Positive = 10.0
    """Share of the distance that may be used up per second [1/s]; at most 1/dt."""
    within: Positive = 0.1
    """Bodies farther away than this are not slowed down, which spares their distances [m]."""

    def __post_init__(self) -> None:
        if self.within <= self.distance:
            raise ValueError(f"within: found {self.within:g}, needs more than distance")

    @abstractmethod
    def watched(self, chain: ClosedChain) -> list[Pair]:
        """The pairs of bodies; CoopqpError if there are none such."""

    def rows(self, chain: ClosedChain) -> tuple[Row, ...]:
        """A row a pair, then those of corners of the closest pairs."""
        label = "the distance at corner {} of the closest bodies".format
        corners = range(1, ROWS + 1)
        rows = (place_row(self.name, f".corner[{i}]", label(i)) for i in corners)
        return (*self._of_pairs(self.watched(chain)), *rows)

    def bind(self, chain: ClosedChain, dt: float) -> Tighten:
        """Fill the rows, whether pairs are near or not.

        Of what a pair is farther apart than ``within`` all may be used up in a tick. It has a row
        there if it could come closer than ``distance`` before the next, by the bounds on v and
        :func:`max_closing_speeds`. InvalidValueError: the gain overshoots in a tick dt [s].
        """
        self._check_gain(dt)
        pairs, distance, gain = self.watched(chain), self.distance, self.gain
        distances, count = Distances(pairs), len(pairs)
        corners, later = Corners(pairs, distances, distance), min(LATER * gain, 1.0 / dt - gain)
        gains, shallow = np.full(count + ROWS, gain), max(distance, SHALLOW)
        deep, ways = np.zeros(count + ROWS, bool), dt * max_closing_speeds(chain, pairs)
        first, second = _moved(chain, pairs)
        sign = first - second  # joints that move both bodies change no distance

        def tighten(state: State, rows: LimitRows) -> None:
            state.place(distances.geometry, distances.placed)
            speed = np.minimum(np.maximum(np.abs(rows.lb), np.abs(rows.ub)), FASTEST)
            far = np.maximum(ways.dot(speed) + distance, self.within)
            distances.update(far)
            corners.update()
            margin = np.concatenate([distances.d - distance, corners.margin])
            damp(margin, gains, deep, rows.h, shallow)
            rows.h[:count] += (1.0 / dt - gain) * np.maximum(distances.d - self.within, 0.0)
            rows.h[count:] += later * corners.behind
            rows.G[:] = 0.0
            near = distances.near[distances.d[distances.near] < far[distances.near]]
            W = _wrenches(distances.n[near], distances.p[near])
            rows.G[near] = W.dot(state.J_joints) * sign[near]
            if corners.count:
                rows.G[count:] = corners.W.dot(state.J_joints) * sign[corners.pair]
            for i in (rows.h < 0.0).nonzero()[0].tolist():
                rows.h[i] = max(float(rows.h[i]), -BACK * float(np.abs(rows.G[i]).sum()))

        return tighten

    def program(self, chain: ClosedChain, dt: float) -> DistanceBounds:
        """The same for the kernel; InvalidValueError as for :meth:`bind`."""
        self._check_gain(dt)
        pairs = self.watched(chain)
        bodies = list(dict.fromkeys(body for pair in pairs for body in pair))
        at = {body: i for i, body in enumerate(bodies)}
        return DistanceBounds(
            bodies=[(body.joint, body.convex) for body in bodies],
            max_point_speeds=_max_point_speeds(chain, bodies),
            pairs=np.array([[at[a], at[b]] for a, b in pairs], np.int64).reshape(-1, 2),
            distance=self.distance,
            gain=self.gain,
            within=self.within,
        )

    def _of_pairs(self, pairs: Sequence[Pair]) -> list[Row]:
        return [_row(self.name, a.name, b.name, self.distance) for a, b in pairs]

    def _check_gain(self, dt: float) -> None:
        if wrong := overshoot(self.gain, dt):
            raise InvalidValueError(f"{self.name}: {wrong}")

    def clearance(self, chain: ClosedChain) -> Clearance:
        """What is left of each pair's distance [m], at most of ``within``; corners have none."""
        distances = Distances(self.watched(chain))

        def left(state: State) -> Array:
            state.place(distances.geometry, distances.placed)
            distances.measure(self.within)
            return np.asarray(np.minimum(distances.d, self.within) - self.distance, float)

        return left

    def margins(self, chain: ClosedChain, q: Array, v: Array, dt: float) -> dict[Row, Array]:
        """Distance of each pair after each tick, less what is kept free [m], however far."""
        pairs = self.watched(chain)
        d = distances_along(chain, pairs, q[1:]) - self.distance
        return dict(zip(self._of_pairs(pairs), d.T, strict=True))

    def relaxed(self, by: float) -> Limit | None:
        """A smaller distance; None where bodies would have to sink into each other."""
        return replace(self, distance=self.distance - by) if by <= self.distance else None

    def unseen(self, chain: ClosedChain) -> tuple[str, ...]:
        return tuple(f"{self.name} does not see {fault}" for fault in bodies_of(chain)[1])

    def at_start(self, chain: ClosedChain) -> list[tuple[Body, Body, float]]:
        """Pairs with their distances where the chain starts [m], the nearest first."""
        pairs = self.watched(chain)
        d = distances_along(chain, pairs, chain.q_start[None, :])[0]
        return [(*pairs[i], float(d[i])) for i in np.argsort(d).tolist()]

    def inside(self, chain: ClosedChain) -> list[tuple[Body, Body, float]]:
        """Pairs that start in each other, and how deep [m], the deepest first."""
        return [(a, b, -d) for a, b, d in self.at_start(chain) if d < -SHALLOW]

    def nearer(self, found: Sequence[tuple[Body, Body, float]]) -> Iterator[str]:
        """A sentence on those of :meth:`at_start` that are nearer than the distance to keep."""
        kept = self.distance
        near = [
            f"{a.name} starts {-1e3 * d:.1f} mm in {b.name}" if d < 0.0 else
            f"{a.name} starts {1e3 * (kept - d):.1f} mm nearer to {b.name} than distance "
            f"({1e3 * d:.1f} of {1e3 * kept:g} mm)"
            for a, b, d in found if d < kept - WORTH_SAYING
        ]  # fmt: skip
        if near:
            more = f", and {len(near) - SHOWN} pairs more" if len(near) > SHOWN else ""
            yield f"{self.name}: {', '.join(near[:SHOWN])}{more}"


def distances_along(chain: ClosedChain, pairs: Sequence[Pair], q: Array) -> Array:
    """Distance of each pair at each row of q, shape (T, p) [m]."""
    distances = Distances(pairs)
    d = np.zeros((len(q), len(pairs)))
    for state, row in zip(states_along(chain, q), d, strict=True):
        state.place(distances.geometry, distances.placed)
        distances.measure(math.inf)
        row[:] = distances.d
    return d


class Corners:
    """More points of pairs that lie along each other, in a fixed number of rows.

    Where an edge or a face of one body lies along another body, the nearest points jump from end to
    end, so the ends of what is close get rows too. With n the pair's normal and p a corner of the
    body that reaches less far along the other, at a distance s from the plane that bounds the
    other,

        n' (J_first - J_second) v <= gain (s - distance) + LATER gain (s - d)

    at p: the plane is fixed to its body and turns with it. Bodies are never nearer than that plane.

    Attributes:
        margin: of each corner to the distance kept from the other body's plane; that of rows
            without a corner is large, shape (ROWS,) [m].
        behind: how much farther away it is than the pair's nearest point, shape (ROWS,) [m].
        pair: which pair each corner belongs to, shape (ROWS,).
        W: [n; p x n] of each, zero without a corner, shape (ROWS, 6).
        count: how many rows have a corner.
    """

    def __init__(self, pairs: Sequence[Pair], distances: Distances, distance: float) -> None:
        self._pairs, self._distances, self._distance = pairs, distances, distance
        # Which can touch in more than one point.
        self._flat = [all(len(body.convex.points) > 1 for body in pair) for pair in pairs]
        self.margin, self.behind, self.W = np.ones(ROWS), np.zeros(ROWS), np.zeros((ROWS, 6))
        self.pair, self.count = np.zeros(ROWS, np.int64), 0

    def update(self) -> None:
        distances = self._distances
        if self.count:
            self.margin[:], self.behind[:], self.W[:], self.count = 1.0, 0.0, 0.0, 0
        margin = distances.d[distances.near] - self._distance
        (close,) = (margin < CLOSE).nonzero()
        for k in close[margin[close].argsort(kind="stable")].tolist():
            pair = int(distances.near[k])
            if not self._flat[pair]:
                continue
            n = distances.n[pair]
            for corner, s in self._corners(pair, n, distances.p[pair])[: ROWS - self.count]:
                self.margin[self.count], self.pair[self.count] = s - self._distance, pair
                self.behind[self.count] = max(s - distances.d[pair], 0.0)
                self.W[self.count] = _wrenches(n, corner)
                self.count += 1

    def _corners(self, pair: int, n: Array, p: Array) -> list[tuple[Array, float]]:
        """Points, and how far each is from the plane that bounds the other body [m]."""
        first, a = self._ends(pair, 0, n)
        if len(a) == 1:
            return []  # it touches in its nearest point alone
        second, b = self._ends(pair, 1, n)
        if len(b) == 1:
            return []
        if _width(first) <= _width(second) + EVEN:
            bottom = float(b.min())
            return [(first[i], bottom - float(a[i])) for i in _spread(first, p)]
        top = float(a.max())
        return [(second[i], float(b[i]) - top) for i in _spread(second, p)]

    def _ends(self, pair: int, side: int, n: Array) -> tuple[Array, Array]:
        """A body's points next to the plane that bounds it, and their heights along n."""
        convex = self._pairs[pair][side].convex
        X = self._distances.placed.oMg[self._distances.ids[pair][side]]
        out = -1.0 if side else 1.0
        R, o = X.rotation, X.translation
        heights = convex.points.dot(n.dot(R))
        ends = heights > heights.max() - SLAB if out > 0.0 else heights < heights.min() + SLAB
        points = convex.points[ends].dot(R.T) + o
        return points, heights[ends] + (float(n.dot(o)) + out * convex.rim)


def _width(points: Array) -> float:
    return float((points.max(axis=0) - points.min(axis=0)).max())


def _spread(points: Array, p: Array) -> list[int]:
    """Up to three of the points, far from p and from each other."""
    if len(points) <= EACH:
        return list(range(len(points)))
    one = _largest(((points - p) ** 2).sum(axis=1))
    away = points - points[one]
    other = _largest((away**2).sum(axis=1))
    return [one, other, _largest((np.cross(away, away[other]) ** 2).sum(axis=1))]


def _largest(sizes: Array) -> int:
    """The first of the largest, but for rounding."""
    return int((sizes >= (1.0 - EVEN) * sizes.max()).argmax())


@lru_cache(maxsize=4096)  # of the pairs of some robots; every law of a session asks for its own
def _row(owner: str, first: str, second: str, distance: float) -> Row:
    label = f"the distance of {first} and {second}"
    row = place_row(owner, f"[{first}|{second}]", label)
    return replace(row, bodies=(first, second), kept=distance)


def _wrenches(n: Array, p: Array) -> Array:
    """The rows of points that move along n, [n; p x n], one or many."""
    return np.concatenate([n, np.cross(p, n)], axis=-1)


def max_closing_speeds(chain: ClosedChain, pairs: Sequence[Pair]) -> Array:
    """How fast each joint, at speed 1, can close each pair at most, shape (p, n) [m, 1].

    A joint that turns moves no point of a body faster than its speed times the longest way from its
    axis to the body's far end, whatever the configuration; one that slides moves all of it at its
    own speed. Of a pair only joints that move one of the two count.
    """
    first, second = _moved(chain, pairs)
    both = (_max_point_speeds(chain, [pair[side] for pair in pairs]) for side in (0, 1))
    return np.asarray(sum(both) * (first != second), float)


def _moved(chain: ClosedChain, pairs: Sequence[Pair]) -> list[Array]:
    """1 where a joint moves the first, and the second, body of a pair, shape (p, n) each."""
    return [movers(chain, [pair[side].joint for pair in pairs]) for side in (0, 1)]


def _max_point_speeds(chain: ClosedChain, bodies: Sequence[Body]) -> Array:
    """Longest way from each joint to a body's far end, 1 where the joint slides, shape (k, n)."""
    far = {b: np.linalg.norm(b.convex.placement.translation) + b.convex.radius for b in {*bodies}}
    far_ends = np.array([far[body] for body in bodies])  # from the joints' frames, at most [m]
    (ways, slides), joints = chain.once(_ways), [body.joint for body in bodies]
    reach = np.where(slides, 1.0, ways[np.array(joints, int)] + far_ends[:, None])
    return np.where(movers(chain, joints) > 0.0, reach, 0.0)


def _ways(chain: ClosedChain) -> tuple[Array, Array]:
    """Longest way from each joint to the joint ids that it moves, (joints, n), and which slide."""
    model, found = chain.model, np.zeros((chain.model.njoints, chain.n))
    slides, ends = np.array(chain.joint_units) == "m", np.abs([chain.lower, chain.upper])
    along = slides * np.where(np.isfinite(ends), ends, UNLIMITED).max(axis=0)
    for joint in range(1, model.njoints):
        parent, i = model.parents[joint], model.idx_vs[joint]
        step = float(np.linalg.norm(model.jointPlacements[joint].translation)) + along[i]
        found[joint] = found[parent] + step
        found[joint, i] = 0.0
    return found, slides
