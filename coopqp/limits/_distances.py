"""Signed distances of pairs of convex bodies that are fixed to joints, and their nearest points.

With p a nearest point, n the unit normal from the first body to the second and d their signed
distance, as coal gives them, and J_first, J_second the bodies' Jacobians of a point at p (both
nearest points lie on one line along n),

    -d_dot = n' (J_first - J_second) v

Most pairs are far apart, by the box round one body and the ball round the other, a few operations
on arrays for all pairs; only the others are handed to coal.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import coal
import numpy as np
import pinocchio as pin

from coopqp.base.spec import Array
from coopqp.limits._convex import Convex

#: How far from 1 a unit normal's square, and from 0 a length [m], may be.
UNIT = 1e-6


@dataclass(frozen=True, eq=False)
class Body:
    """A convex body in the frame of a joint (an id; 0 is the world), named as in limits.

    ``link`` is the robot's frame that it is a part of; empty for capsules and what is no robot.
    """

    name: str
    joint: int
    convex: Convex
    link: str = ""


Pair = tuple[Body, Body]


class Distances:
    """Signed distances of pairs of bodies.

    Attributes:
        geometry, placed: the bodies, and where they are.
        d: of each pair, or a lower bound of it where the pair is far, shape (p,) [m].
        near: the pairs that may be close, k of them.
        n, p: their normals and nearest points in the first k rows.
        ids: of the bodies of each pair, in geometry.
    """

    def __init__(self, pairs: Sequence[Pair]) -> None:
        bodies = list(dict.fromkeys(body for pair in pairs for body in pair))
        at = {body: i for i, body in enumerate(bodies)}
        self.geometry = pin.GeometryModel()
        for i, body in enumerate(bodies):
            body.convex.geometry.computeLocalAABB()
            self.geometry.addGeometryObject(
                pin.GeometryObject(
                    f"{i} {body.name}", body.joint, body.convex.placement, body.convex.geometry
                )
            )
        self.ids = [(at[a], at[b]) for a, b in pairs]
        for ids in self.ids:
            self.geometry.addCollisionPair(pin.CollisionPair(*ids))
        self.placed = pin.GeometryData(self.geometry)
        # pinocchio's own requests begin where the last one ended, so that the same state could
        # give other digits when it comes again; these begin at the middles of the bodies.
        for i in range(len(pairs)):
            request = coal.DistanceRequest()
            request.gjk_initial_guess = coal.GJKInitialGuess.BoundingVolumeGuess
            self.placed.distanceRequests[i] = request
        self._results = list(self.placed.distanceResults)
        self._normals = [result.normal for result in self._results]  # views, which stay valid
        self._bounds = _Bounds(self.placed, bodies, self.ids)
        self._flat = np.zeros(3 * len(pairs))
        self._is_near, self._was_near, self._changed = np.ones((3, len(pairs)), bool)
        self.d, self.near = np.zeros(len(pairs)), np.zeros(0, np.int64)
        # Columns x y z x y, so that slices give the shifted columns of a cross product.
        self.n, self.p = np.zeros((2, len(pairs), 5))

    def update(self, within: float | Array) -> None:
        """Find the distances of pairs that may be closer than ``within`` [m], each or all."""
        n, p = self.n, self.p
        self._bounds.update(self.d)
        np.less(self.d, within, self._is_near)
        self._choose()
        (self.near,) = self._is_near.nonzero()
        near = self.near.tolist()
        if not near:
            return
        pin.computeDistances(self.geometry, self.placed)
        results = [self._results[i] for i in near]
        self.d[self.near] = [result.min_distance for result in results]
        k = len(near)
        np.concatenate([self._normals[i] for i in near], out=self._flat[: 3 * k])
        n[:k, :3] = self._flat[: 3 * k].reshape(-1, 3)
        np.concatenate([result.getNearestPoint1() for result in results], out=self._flat[: 3 * k])
        p[:k, :3] = self._flat[: 3 * k].reshape(-1, 3)
        if self.d.min() < UNIT:
            for row, i in enumerate(near):
                self._mend(row, i)

    def _choose(self) -> None:
        """Tell pinocchio which pairs are near; few come and go in a tick."""
        np.not_equal(self._is_near, self._was_near, self._changed)
        for i in self._changed.nonzero()[0].tolist():
            if self._is_near[i]:
                self.placed.activateCollisionPair(i)
            else:
                self.placed.deactivateCollisionPair(i)
        self._was_near[:] = self._is_near

    def _mend(self, k: int, i: int) -> None:
        """Where axes of capsules cross there is no normal; take any way out of each other."""
        n = self.n[k, :3]
        first, second = self.ids[i]
        if not abs(n.dot(n) - 1.0) < UNIT:  # written so that a NaN is mended
            X_1, X_2 = self.placed.oMg[first], self.placed.oMg[second]
            way = X_2.translation - X_1.translation
            size = math.sqrt(way.dot(way))
            n[:] = way / size if size > UNIT else X_1.rotation[:, 0]
        if not np.isfinite(self.p[k, :3]).all():
            self.p[k, :3] = self.placed.oMg[first].translation


class _Bounds:
    """Lower bounds of distances: from the box round one body to the ball round the other."""

    def __init__(
        self, placed: pin.GeometryData, bodies: Sequence[Body], ids: Sequence[tuple[int, int]]
    ) -> None:
        places = [placed.oMg[i] for i in range(len(bodies))]
        # Views into pinocchio's data, which stay valid.
        self._p_views = [X.translation for X in places]
        self._R_views = [X.rotation for X in places]
        radius = np.array([body.convex.radius for body in bodies])
        half = np.array([body.convex.half for body in bodies]).reshape(-1, 3)
        # The larger of two is bounded by its box.
        boxes = [a if radius[a] >= radius[b] else b for a, b in ids]
        balls = [a + b - box for (a, b), box in zip(ids, boxes, strict=True)]
        self._box, self._ball = np.array(boxes, int), np.array(balls, int)
        self._half, self._radius = half[self._box], radius[self._ball]
        count, pairs = len(bodies), len(ids)
        self._p, self._R = np.zeros(3 * count), np.zeros((3 * count, 3))
        self._way, self._ball_p = np.zeros((2, pairs, 3))
        self._turned = np.zeros((pairs, 1, 3))
        self._R_box = np.zeros((pairs, 3, 3))

    def update(self, d: Array) -> None:
        if not len(d):
            return
        np.concatenate(self._p_views, out=self._p)
        np.concatenate(self._R_views, out=self._R)
        p, way = self._p.reshape(-1, 3), self._way
        p.take(self._ball, axis=0, out=self._ball_p)
        p.take(self._box, axis=0, out=way)
        np.subtract(self._ball_p, way, way)
        self._R.reshape(-1, 3, 3).take(self._box, axis=0, out=self._R_box)
        turned = self._turned
        np.matmul(way[:, None, :], self._R_box, out=turned)  # R' way
        inside = turned[:, 0, :]
        np.abs(inside, inside)
        np.subtract(inside, self._half, inside)
        np.maximum(inside, 0.0, out=inside)
        np.multiply(inside, inside, inside)
        np.add.reduce(inside, axis=1, out=d)
        np.sqrt(d, d)
        np.subtract(d, self._radius, d)
