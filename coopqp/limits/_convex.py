"""Convex bodies for coal: primitives, and the convex hulls of meshes.

A body lies about the middle of the box round it, so that boxes and balls about its origin bound
it from outside.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import coal
import numpy as np
import pinocchio as pin

from coopqp.base.errors import InvalidValueError
from coopqp.base.spec import Array
from coopqp.robot import Capsule, Shape
from coopqp.robot_files.meshes import read_mesh, version

#: Points of a cylinder's rim.
RIM = 12

#: How many numbers a shape's size has.
NUMBERS = {"box": 3, "cylinder": 2, "capsule": 2, "sphere": 1, "ellipsoid": 3, "mesh": 3}


@dataclass(frozen=True, eq=False)
class Convex:
    """A convex body.

    Attributes:
        placement: of the middle of the box round it, in the frame it was given in.
        half: half the edges of that box, shape (3,) [m].
        radius: of the ball round it, about the same middle [m].
        points, rim: it is the hull of the points, shape (k, 3), thickened by the rim [m]; round
            ends of a cylinder have a few of their points, what is round all over has one.
    """

    geometry: coal.CollisionGeometry
    placement: pin.SE3
    half: Array
    radius: float
    points: Array
    rim: float = 0.0


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
    geometry, middle, half, corners = hull
    radius = float(np.linalg.norm(corners, axis=1).max())
    return Convex(geometry, X * pin.SE3(np.eye(3), middle), half, radius, corners)


def outermost(shape: Shape) -> Array:
    """Vertices of a mesh's convex hull, own frame, (v, 3) [m]; InvalidValueError: unusable."""
    assert shape.mesh is not None
    return _read(*version(shape.mesh), _sizes(shape))


def of_capsule(capsule: Capsule) -> Convex:
    """A capsule, in its joint's frame; coal's lie along z about their middle."""
    start, end = np.array(capsule.start), np.array(capsule.end)
    along = end - start
    length = float(np.linalg.norm(along))
    middle = pin.SE3(np.eye(3), 0.5 * (start + end))
    if length:
        turn = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), along)
        middle.rotation = turn.toRotationMatrix()
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
        return Convex(coal.Box(*size), placement, half, float(np.linalg.norm(half)), corners)
    if kind == "ellipsoid":
        return Convex(coal.Ellipsoid(*size), placement, np.array(size), max(size), middle)
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
        return Convex(coal.Cylinder(*size), placement, half, math.hypot(radius, reach), points)
    half[2] += radius
    points = ends if reach else middle
    return Convex(coal.Capsule(*size), placement, half, half[2], points, radius)


@lru_cache(maxsize=512)
def _read(path: Path, changed: int, size: int, scale: tuple[float, ...]) -> Array:
    """The outermost vertices of a mesh; what has changed in the file is read anew."""
    from scipy.spatial import ConvexHull, QhullError  # robots without meshes do not wait for it

    vertices = read_mesh(path, scale).vertices
    try:
        return np.asarray(vertices[ConvexHull(vertices).vertices])
    except (QhullError, ValueError):
        return vertices  # flat: it may be part of a link that is not


@lru_cache(maxsize=512)
def _hull_of(points: bytes) -> tuple[coal.CollisionGeometry, Array, Array, Array] | None:
    """Convex hull of points, bytes for the cache, about the middle of its box; None if flat."""
    from scipy.spatial import ConvexHull, QhullError

    vertices = np.frombuffer(points).reshape(-1, 3)
    middle = 0.5 * (vertices.min(axis=0) + vertices.max(axis=0))
    try:
        hull = ConvexHull(vertices - middle)
    except (QhullError, ValueError):
        return None
    number = {old: new for new, old in enumerate(hull.vertices.tolist())}
    corners = hull.points[hull.vertices]
    corner_list, triangles = coal.StdVec_Vec3s(), coal.StdVec_Triangle()
    corner_list.extend(list(corners))
    triangles.extend([coal.Triangle(*(number[i] for i in t)) for t in hull.simplices.tolist()])
    return (coal.Convex(corner_list, triangles), middle, np.abs(corners).max(axis=0), corners)
