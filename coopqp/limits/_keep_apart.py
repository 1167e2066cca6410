"""What self_collision and obstacles have in common: rows that keep pairs of bodies apart.

With d a distance, or that of a corner from a plane (:mod:`coopqp.limits._corners`), each row is
-d_dot <= gain (d - distance). What is too close is asked back, but no faster than joints at
``BACK`` can do: where d hardly changes with the joints, no speed could. What is in each other may
not go deeper and is not asked apart.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from coopqp.base.errors import InvalidValueError
from coopqp.base.qp import Row
from coopqp.base.spec import Array
from coopqp.limit import SHALLOW, LimitRows, RoomLeft, Tighten, damp, movers, states_along
from coopqp.limits._corners import ROWS, Corners
from coopqp.limits._distances import Body, Distances, Pair
from coopqp.limits._step_verification import LookAhead
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.state import State

#: Speed of the joints that suffices for what is asked back [rad/s, m/s].
BACK = 0.1

#: Pairs that one limit watches at most: a tick with so many takes some milliseconds.
MOST_PAIRS = 2500
#: Bodies that start nearer than asked by less are not worth a word [m].
WORTH_SAYING = 5e-5
#: How many of those that do are named.
SHOWN = 3


def check_count(name: str, count: int) -> None:
    """InvalidValueError for more pairs than can be watched, with what to do."""
    if count > MOST_PAIRS:
        raise InvalidValueError(
            f"{name}: watches {count} pairs, at most {MOST_PAIRS} can be; name the bodies that "
            "can meet, or make several things one"
        )


def pair_rows(owner: str, pairs: Sequence[Pair], distance: float) -> tuple[Row, ...]:
    """A row a pair, then those of corners of the closest pairs; the distance [m] is kept free."""

    def row(name: str, label: str) -> Row:
        return Row(
            name=f"limit.{owner}{name}",
            kind="limit",
            owner=owner,
            unit="m",
            label=label,
            of_place=True,
        )

    of_pairs = (
        replace(
            row(f"[{a.name}|{b.name}]", f"the distance of {a.name} and {b.name}"),
            bodies=(a.name, b.name),
            kept=distance,
        )
        for a, b in pairs
    )
    of_corners = (
        row(f".corner[{i}]", f"the distance at corner {i} of the closest bodies")
        for i in range(1, ROWS + 1)
    )
    return (*of_pairs, *of_corners)


def keep_apart(
    chain: ClosedChain,
    pairs: Sequence[Pair],
    dt: float,
    *,
    distance: float,
    gain: float,
    within: float,
) -> Tighten:
    """Fill the rows of :func:`pair_rows`, whether pairs are near or not.

    Of what a pair is farther apart than ``within`` [m] all may be used up in a tick. It has a row
    there if it could come closer than ``distance`` [m] before the next one (:class:`LookAhead`).
    """
    found, count = Distances(pairs), len(pairs)
    corners = Corners(pairs, found, distance)
    rates = _Rates(chain, pairs)
    gains, free = np.full(count + ROWS, gain), np.array(distance)
    shallow = max(distance, SHALLOW)
    room, deep = np.zeros(count + ROWS), np.zeros(count + ROWS, bool)
    ahead, beyond = LookAhead(chain, pairs, distance, within, dt), np.zeros(count)

    def tighten(state: State, rows: LimitRows) -> None:
        state.place(found.geometry, found.placed)
        ahead.update(rows)
        found.update(ahead.far)
        corners.update()
        np.subtract(found.d, free, room[:count])
        room[count:] = corners.room
        damp(room, gains, deep, rows.h, shallow)
        np.subtract(found.d, within, beyond)
        np.maximum(beyond, 0.0, out=beyond)
        np.multiply(beyond, 1.0 / dt - gain, beyond)
        np.add(rows.h[:count], beyond, rows.h[:count])
        rates.fill(state, found, corners, rows.G)
        np.greater_equal(found.d, ahead.far, deep[:count])  # as far for what reads the rows
        rows.G[:count][deep[:count]] = 0.0
        for i in np.less(rows.h, 0.0, deep).nonzero()[0].tolist():
            rows.h[i] = max(float(rows.h[i]), -BACK * float(np.abs(rows.G[i]).sum()))

    return tighten


class _Rates:
    """How the distances of pairs, and of corners, change."""

    def __init__(self, chain: ClosedChain, pairs: Sequence[Pair]) -> None:
        first, second = (movers(chain, [pair[side].joint for pair in pairs]) for side in (0, 1))
        # Joints that move both bodies change no distance.
        self._sign = first - second
        self._W, self._minus = np.zeros((len(pairs), 6)), np.zeros((len(pairs), 3))
        self._G = np.zeros_like(self._sign)
        self._G_corners = np.zeros((ROWS, chain.n))

    def fill(self, state: State, found: Distances, corners: Corners, G: Array) -> None:
        """Write -d_dot per joint speed, shape (p + ROWS, n); zero where pairs are far."""
        near, count = found.near, len(found.d)
        k = len(near)
        n, p, W, minus, rows = found.n[:k], found.p[:k], self._W[:k], self._minus[:k], self._G[:k]
        n[:, 3:], p[:, 3:] = n[:, :2], p[:, :2]
        W[:, :3] = n[:, :3]
        np.multiply(p[:, 1:4], n[:, 2:], W[:, 3:])
        np.multiply(p[:, 2:], n[:, 1:4], minus)
        np.subtract(W[:, 3:], minus, W[:, 3:])
        W.dot(state.J_joints, rows)
        G[:] = 0.0
        G[near] = rows
        np.multiply(G[:count], self._sign, G[:count])
        if corners.count:
            corners.W.dot(state.J_joints, self._G_corners)
            np.multiply(self._G_corners, self._sign[corners.pair], G[count:])


def room_left(pairs: Sequence[Pair], *, distance: float, within: float) -> RoomLeft:
    """What :func:`keep_apart` leaves each pair; none farther apart than ``within`` counts [m].

    Corners have no room of their own: it is never less than that of their pair's bodies.
    """
    found = Distances(pairs)

    def left(state: State) -> Array:
        state.place(found.geometry, found.placed)
        found.update(within)
        return np.asarray(np.minimum(found.d, within) - distance, float)

    return left


def margins_along(
    owner: str, chain: ClosedChain, pairs: Sequence[Pair], q: Array, distance: float
) -> dict[Row, Array]:
    """Distance of each pair after each tick, less what is kept free [m], however far they are."""
    d = distances_along(chain, pairs, q[1:]) - distance
    return dict(zip(pair_rows(owner, pairs, distance), d.T, strict=False))  # without corners


def distances_along(chain: ClosedChain, pairs: Sequence[Pair], q: Array) -> Array:
    """Distance of each pair at each row of q, shape (T, p) [m]."""
    found = Distances(pairs)
    d = np.zeros((len(q), len(pairs)))
    for state, row in zip(states_along(chain, q), d, strict=True):
        state.place(found.geometry, found.placed)
        found.update(math.inf)
        row[:] = found.d
    return d


def inside(chain: ClosedChain, pairs: Sequence[Pair]) -> list[tuple[Body, Body, float]]:
    """Pairs that are in each other where the chain starts, and how deep [m], the deepest first."""
    d = distances_along(chain, pairs, chain.q_start[None, :])[0]
    return [(*pairs[i], -float(d[i])) for i in np.argsort(d).tolist() if d[i] < -SHALLOW]


def nearest_of_each(chain: ClosedChain, pairs: Sequence[Pair]) -> dict[str, float]:
    """Where the chain starts, how near the nearest body is to each second one [m]."""
    found: dict[str, float] = {}
    d = distances_along(chain, pairs, chain.q_start[None, :])[0].tolist()
    for (_, second), distance in zip(pairs, d, strict=True):
        found[second.name] = min(distance, found.get(second.name, math.inf))
    return found


def nearer_at_start(
    name: str, chain: ClosedChain, pairs: Sequence[Pair], distance: float
) -> Iterator[str]:
    """A sentence on pairs that are nearer than asked where the chain starts."""
    d = distances_along(chain, pairs, chain.q_start[None, :])[0]
    found = [i for i in np.argsort(d).tolist() if d[i] < distance - WORTH_SAYING]
    if not found:
        return
    nearest = (int(i) for i in found[:SHOWN])
    told = ", ".join(_nearer(pairs[i], float(d[i]), distance) for i in nearest)
    more = f", and {len(found) - SHOWN} pairs more" if len(found) > SHOWN else ""
    yield f"{name}: {told}{more}"


def _nearer(pair: Pair, d: float, distance: float) -> str:
    one, other = pair
    if d < 0.0:
        return f"{one.name} starts {-1e3 * d:.1f} mm in {other.name}"
    nearer = f"{one.name} starts {1e3 * (distance - d):.1f} mm nearer to {other.name} than distance"
    return f"{nearer} ({1e3 * d:.1f} of {1e3 * distance:g} mm)"
