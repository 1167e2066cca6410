"""How far away pairs of bodies must be watched, so that none can come too close within a tick.

A joint that turns moves no point of a body faster than its speed times the longest way from its
axis to the body's far end, whatever the configuration; one that slides moves all of it at its own
speed. Of a pair only joints that move one of the two count. Summed up with the bounds on the
velocity of the tick, that is how far a pair can close at most.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from coopqp.base.spec import Array
from coopqp.limit import LimitRows, movers
from coopqp.limits._distances import Body, Pair
from coopqp.model.closed_chain import ClosedChain

#: Reach of a sliding joint without limits [m].
UNLIMITED = math.pi
#: Speed of a joint that nothing bounds [rad/s, m/s].
FASTEST = 1e6


class LookAhead:
    """Distances up to which pairs have a row, at least up to ``within`` [m].

    ``far`` is that of each pair as of the last update, shape (p,) [m].
    """

    def __init__(
        self, chain: ClosedChain, pairs: Sequence[Pair], distance: float, within: float, dt: float
    ) -> None:
        self._ways = dt * levers(chain, pairs)
        self._distance, self._within = distance, within
        self._speed, self._other = np.zeros((2, chain.n))
        self.far = np.full(len(pairs), within)

    def update(self, bounds: LimitRows) -> None:
        """Look as far as pairs can close in a tick within these bounds on v."""
        speed = self._speed
        np.abs(bounds.lb, speed)
        np.abs(bounds.ub, self._other)
        np.maximum(speed, self._other, out=speed)
        np.minimum(speed, FASTEST, out=speed)
        self._ways.dot(speed, self.far)
        self.far += self._distance
        np.maximum(self.far, self._within, out=self.far)


def levers(chain: ClosedChain, pairs: Sequence[Pair]) -> Array:
    """How fast each joint, at speed 1, can close each pair at most, shape (p, n) [m, 1]."""
    bodies = list(dict.fromkeys(body for pair in pairs for body in pair))
    of_body = dict(zip(bodies, (_levers_of(chain, body) for body in bodies), strict=True))
    first, second = (movers(chain, [pair[side].joint for pair in pairs]) for side in (0, 1))
    found = np.array([of_body[a] + of_body[b] for a, b in pairs]).reshape(-1, chain.n)
    return np.asarray(found * (first != second), float)


def _levers_of(chain: ClosedChain, body: Body) -> Array:
    """Longest way from each joint to a body's far end, 1 where the joint slides, shape (n,)."""
    model, found = chain.model, np.zeros(chain.n)
    way = float(np.linalg.norm(body.convex.placement.translation)) + body.convex.radius
    for joint in reversed([j for j in model.supports[body.joint] if j]):
        i = model.idx_vs[joint]
        found[i] = way
        if chain.joint_units[i] == "m":
            found[i] = 1.0
            ends = np.abs([chain.lower[i], chain.upper[i]])
            way += float(np.where(np.isfinite(ends), ends, UNLIMITED).max())
        way += float(np.linalg.norm(model.jointPlacements[joint].translation))
    return found
