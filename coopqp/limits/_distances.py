"""Convex bodies that are fixed to joints, signed distances of pairs, and their nearest points.

Bodies are primitives and the convex hulls of meshes, each about the middle of the box round it, so
that boxes and balls about its origin bound it from outside. With p a nearest point, n the unit
normal from the first body to the second and d their signed distance, as coal gives them, and
J_first, J_second the bodies' Jacobians of a point at p (both nearest points lie on one line along
n),

    -d_dot = n' (J_first - J_second) v

Most pairs are far apart, by the box round one body and the ball round the other, a few operations
on arrays for all pairs; only the others are handed to coal.
"""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import coal
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from coopqp.base.errors import InvalidValueError
from coopqp.base.reading import version
from coopqp.base.spec import Array
from coopqp.robot import Capsule, Convex, Form, Shape
from coopqp.robot_files.meshes import read_mesh

#: How far from 1 a unit normal's square, and from 0 a length [m], may be.
UNIT = 1e-6

MAX_CORNERS, MAX_EDGES = 20_000, 255  # of a convex hull; coal counts a corner's edges in a byte
SIMPLER = "simplify the mesh, or give a box, sphere, cylinder or capsule round it"
#: Points of a cylinder's rim.
RIM = 12

#: How many numbers a shape's size has.
NUMBERS = {"box": 3, "cylinder": 2, "capsule": 2, "sphere": 1, "ellipsoid": 3, "mesh": 3}


def of_shape(shape: Shape) -> Convex:
    """A part of a link, in its frame; InvalidValueError: no size, or a mesh that cannot be used."""
    if shape.kind == "mesh":
        return of_meshes([shape])
    size = _sizes(shape)
    if min(size) <= 0.0:
        raise InvalidValueError(f"{shape.kind}: found size {list(size)}, needs more than 0")
    return _primitive(shape.kind, size, shape.placement)


def of_meshes(shapes: Sequence[Shape]) -> Convex:
    """The convex hull round a link's meshes, in its frame; InvalidValueError: unusable, or flat."""
    X = shapes[0].placement
    points = []
    for shape in shapes:
        vertices = outermost(shape)
        X_shape = X.actInv(shape.placement)
        points.append(vertices @ X_shape.rotation.T + X_shape.translation)
    hull = _hull_of(np.concatenate(points).tobytes())
    if hull is None:
        raise InvalidValueError(f"mesh {shapes[0].mesh}: is flat; needs a volume")
    return replace(hull, placement=X * hull.placement)


def outermost(shape: Shape) -> Array:
    """Vertices of a mesh's convex hull, own frame, (v, 3) [m]; InvalidValueError: unusable."""
    assert shape.mesh is not None
    return _read(*version(shape.mesh), _sizes(shape))


def of_capsule(capsule: Capsule) -> Convex:
    """A capsule, in its joint's frame; coal's lie along z about their middle."""
    middle, length = capsule.placed
    return _primitive("capsule", (capsule.radius, length), middle)


def _sizes(shape: Shape) -> tuple[float, ...]:
    if len(shape.size) != NUMBERS[shape.kind] or not np.isfinite(shape.size).all():
        raise InvalidValueError(
            f"{shape.kind}: found size {list(shape.size)}, needs {NUMBERS[shape.kind]} numbers"
        )
    return shape.size


def _primitive(kind: str, size: tuple[float, ...], placement: pin.SE3) -> Convex:
    middle = np.zeros((1, 3))
    if kind == "box":
        half = 0.5 * np.array(size)
        corners = half * np.array(list(itertools.product((-1.0, 1.0), repeat=3)))
        radius = float(np.linalg.norm(half))
        return Convex(coal.Box(*size), placement, half, radius, corners, form=Form.BOX)
    if kind == "ellipsoid":
        round_all_over, half = coal.Ellipsoid(*size), np.array(size)
        return Convex(round_all_over, placement, half, max(size), middle, form=Form.ELLIPSOID)
    if kind == "sphere":
        (radius,) = size
        return Convex(coal.Sphere(radius), placement, np.full(3, radius), radius, middle, radius)
    radius, reach = size[0], 0.5 * size[1]
    ends = np.array([[0.0, 0.0, -reach], [0.0, 0.0, reach]])
    half = np.array([radius, radius, reach])
    if kind == "cylinder":
        angles = np.linspace(0.0, 2.0 * np.pi, RIM, endpoint=False)
        rim = radius * np.column_stack([np.cos(angles), np.sin(angles), np.zeros(RIM)])
        points = np.concatenate([rim + end for end in ends])
        ball, cylinder = math.hypot(radius, reach), coal.Cylinder(*size)
        return Convex(cylinder, placement, half, ball, points, form=Form.CYLINDER)
    half[2] += radius
    points = ends if reach else middle
    return Convex(coal.Capsule(*size), placement, half, half[2], points, radius)


@lru_cache(maxsize=512)
def _read(path: Path, changed: int, size: int, scale: tuple[float, ...]) -> Array:
    """The outermost vertices of a mesh; what has changed in the file is read anew."""
    from scipy.spatial import ConvexHull, QhullError  # robots without meshes do not wait for it

    vertices = read_mesh(path, scale).vertices
    try:
        outer = np.asarray(vertices[ConvexHull(vertices).vertices])
    except (QhullError, ValueError):
        return vertices  # flat: it may be part of a link that is not
    if len(outer) > MAX_CORNERS:
        found = f"its convex hull has {len(outer):,} corners, at most {MAX_CORNERS:,} are allowed"
        raise InvalidValueError(f"{path}: {found}; {SIMPLER}")
    return outer


@lru_cache(maxsize=512)
def _hull_of(points: bytes) -> Convex | None:
    """Convex hull of points, bytes for the cache; None if flat."""
    from scipy.spatial import ConvexHull, QhullError

    vertices = np.frombuffer(points).reshape(-1, 3)
    middle = 0.5 * (vertices.min(axis=0) + vertices.max(axis=0))
    try:
        hull = ConvexHull(vertices - middle)
    except (QhullError, ValueError):
        return None
    if np.bincount(hull.simplices.ravel()).max() > MAX_EDGES:
        raise InvalidValueError(f"mesh: over {MAX_EDGES} edges meet in a corner; {SIMPLER}")
    number = np.zeros(len(vertices), np.int64)
    number[hull.vertices] = np.arange(len(hull.vertices))
    faces, corners = number[hull.simplices], hull.points[hull.vertices]
    corner_list, triangles = coal.StdVec_Vec3s(), coal.StdVec_Triangle()
    corner_list.extend(list(corners))
    triangles.extend([coal.Triangle(*face) for face in faces.tolist()])
    sides = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    return Convex(
        geometry=coal.Convex(corner_list, triangles),
        placement=pin.SE3(np.eye(3), middle),
        half=np.abs(corners).max(axis=0),
        radius=float(np.linalg.norm(corners, axis=1).max()),
        points=corners,
        edges=np.unique(sides, axis=0),
    )


@dataclass(frozen=True, eq=False)
class Body:
    """A convex body in the frame of a joint, named as in limits."""

    name: str
    joint: int  # its id; 0 is the world
    convex: Convex
    link: str = ""  # the robot's frame that it is a part of; none of capsules and what is no robot


Pair = tuple[Body, Body]


class Distances:
    """Signed distances of pairs of bodies.

    Attributes:
        geometry, placed: the bodies, and where they are.
        d: of each pair, or a lower bound of it where the pair is far, shape (p,) [m].
        near: the pairs that may be close.
        n, p: normals and nearest points of these, shape (p, 3).
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
        self._places = [self.placed.oMg[i] for i in range(len(bodies))]
        first, second = np.array(self.ids, int).reshape(-1, 2).T
        radius = np.array([body.convex.radius for body in bodies])
        half = np.array([body.convex.half for body in bodies]).reshape(-1, 3)
        turned = radius[first] < radius[second]  # the larger of two is bounded by its box
        self._box, self._ball = np.where(turned, (second, first), (first, second))
        self._half, self._radius = half[self._box], radius[self._ball]
        self._was_near = np.ones(len(pairs), bool)
        self.d, self.near = np.zeros(len(pairs)), np.zeros(0, np.int64)
        self.n, self.p = np.zeros((2, len(pairs), 3))

    def update(self, within: float | Array) -> None:
        """Distances, normals and nearest points of pairs that may be closer than ``within`` [m]."""
        results = self.measure(within)
        if not results:
            return
        self.n[self.near] = [result.normal for result in results]
        self.p[self.near] = [result.getNearestPoint1() for result in results]
        for i in self.near[self.d[self.near] < UNIT].tolist():
            self._mend(i)

    def measure(self, within: float | Array) -> list[coal.DistanceResult]:
        """The same without normals and points; what coal found of the pairs that are near."""
        self.d[:] = self._bounds()
        is_near = self.d < within
        self._choose(is_near)
        (self.near,) = is_near.nonzero()
        if not len(self.near):
            return []
        pin.computeDistances(self.geometry, self.placed)
        results = [self._results[i] for i in self.near.tolist()]
        self.d[self.near] = [result.min_distance for result in results]
        return results

    def _bounds(self) -> Array:
        """From the box round one body to the ball round the other."""
        p = np.array([X.translation for X in self._places]).reshape(-1, 3)
        R = np.array([X.rotation for X in self._places]).reshape(-1, 3, 3)
        way = np.einsum("ij,ijk->ik", p[self._ball] - p[self._box], R[self._box])
        out = np.maximum(np.abs(way) - self._half, 0.0)
        return np.asarray(np.sqrt((out * out).sum(axis=1)) - self._radius)

    def _choose(self, is_near: NDArray[np.bool_]) -> None:
        """Tell pinocchio which pairs are near; few come and go in a tick."""
        for i in (is_near != self._was_near).nonzero()[0].tolist():
            if is_near[i]:
                self.placed.activateCollisionPair(i)
            else:
                self.placed.deactivateCollisionPair(i)
        self._was_near = is_near

    def _mend(self, i: int) -> None:
        """Where axes of capsules cross there is no normal; take any way out of each other."""
        n = self.n[i]
        first, second = self.ids[i]
        if not abs(n.dot(n) - 1.0) < UNIT:  # written so that a NaN is mended
            X_1, X_2 = self.placed.oMg[first], self.placed.oMg[second]
            way = X_2.translation - X_1.translation
            size = math.sqrt(way.dot(way))
            n[:] = way / size if size > UNIT else X_1.rotation[:, 0]
        if not np.isfinite(self.p[i]).all():
            self.p[i] = self.placed.oMg[first].translation
