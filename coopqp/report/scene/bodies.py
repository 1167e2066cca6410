"""What a robot looks like: the triangles that each of its joints carries, and thinned surfaces.

A joint's surface is that of its links' shapes; without any, that of the robot's capsules; and
without those, capsules from the joint to the next ones, so that every robot can be drawn.

To thin a surface, all vertices within a cell of a grid become one (vertex clustering), at the point
nearest to the planes of the triangles there, so that edges and rims survive: Lindstrom, Out-of-core
simplification of large polygonal models, SIGGRAPH 2000.

Letters: v vertices, t triangles, c cells.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from coopqp.base.errors import InvalidValueError
from coopqp.base.reading import version
from coopqp.base.spec import Array
from coopqp.model.marker import SolidMarker
from coopqp.robot import Capsule, RobotModel, Shape
from coopqp.robot_files.meshes import Ints, Mesh, read_mesh
from coopqp.trace import Trace

MAX_TRIANGLES = 2000  # of each arm, and of all that belongs to none
READ = 1 / 64  # cell in which a mesh is thinned when it is read, in its sizes
FINEST, TRIALS = 1 / 500, 5  # first cell, in the largest size of the surfaces; halvings
THICKNESS = 0.04  # radius of a link's capsule, in lengths of the longest arm
SHORT = 1e-3  # links below are not drawn, in lengths of the longest arm
ROUND = 12  # corners of a circle
FLAT = 1e-2  # share of a cell's largest eigenvalue below which its planes leave the point free


@dataclass(frozen=True)
class Body:
    """What a joint carries, in its frame."""

    joint: int  # its index in the robot's model; 0 is the base
    # number of the arm that alone is moved by it; None for the base and what arms share
    arm: int | None
    surface: Mesh


def robot_bodies(robot: RobotModel) -> tuple[tuple[Body, ...], tuple[str, ...]]:
    """The bodies that can be seen, and one sentence for each mesh that cannot be read."""
    surfaces, faults = _surfaces_of_shapes(robot)
    for capsules in (robot.capsules, _links(robot)):
        bare = set(range(robot.model.njoints)) - set(surfaces)
        for capsule in capsules:
            joint = robot.model.getJointId(capsule.joint) if capsule.joint else 0
            if joint in bare:
                middle, length = capsule.placed
                surface = moved(_turned(_round_ends(capsule.radius, length)), middle)
                surfaces.setdefault(joint, []).append(surface)
    joints_of = [robot.arm_joints(arm) for arm in robot.arms]
    arm_of: dict[int, int | None] = {}
    for joint in sorted(surfaces):
        moving = [i for i, own in enumerate(joints_of) if robot.model.names[joint] in own]
        arm_of[joint] = moving[0] if len(moving) == 1 else None
    bodies = []
    for arms in ([None], range(len(robot.arms))):
        joints = [joint for joint, arm in arm_of.items() if arm in arms]
        few = _within([joined(surfaces[j]) for j in joints], len(arms) * MAX_TRIANGLES)
        bodies += [Body(j, arm_of[j], part) for j, part in zip(joints, few, strict=True)]
    return tuple(bodies), faults


def solid_body(solid: SolidMarker) -> Body:
    """What stands in the world, as a body of the base."""
    placed = moved(_surface(solid), pin.SE3(solid.rotation, solid.position))
    return Body(0, None, _within([placed], MAX_TRIANGLES)[0])


def body_places(
    robot: RobotModel, bodies: Sequence[Body], trace: Trace, rows: Ints
) -> list[list[pin.SE3]]:
    """Pose of each body's joint in the world, for each of the rows of a trace, shape (r,)."""
    model, data = robot.model, robot.model.createData()
    # The joints of grasps come after the hands and move no body of the robot.
    columns, places = [trace.joints.index(name) for name in robot.joint_names], []
    for q in trace.q[rows][:, columns]:
        pin.forwardKinematics(model, data, q)
        places.append([data.oMi[body.joint].copy() for body in bodies])
    return places


def _surfaces_of_shapes(robot: RobotModel) -> tuple[dict[int, list[Mesh]], tuple[str, ...]]:
    surfaces: dict[int, list[Mesh]] = {}
    faults = set()
    for shape in robot.shapes:
        try:
            surface = _surface(shape)
        except InvalidValueError as error:
            faults.add(f"{error}; not drawn")
            continue
        frame = robot.model.frames[robot.model.getFrameId(shape.frame)]
        placed = moved(surface, frame.placement * shape.placement)
        surfaces.setdefault(frame.parentJoint, []).append(placed)
    return surfaces, tuple(sorted(faults))


@lru_cache(maxsize=256)
def _read_mesh(path: Path, changed: int, size: int, scale: tuple[float, ...]) -> Mesh:
    """The mesh in a version of a file, thinned so as not to slow what follows."""
    surface = read_mesh(path, scale)
    return thinned(surface, READ * _size([surface]))


def _size(surfaces: Sequence[Mesh]) -> float:
    """The longest edge of the boxes round each [m]."""
    return max(float(np.ptp(surface.vertices, axis=0).max()) for surface in surfaces)


def _links(robot: RobotModel) -> list[Capsule]:
    """Capsules from every joint to the next ones and to the hand."""
    model, ends = robot.model, []
    for arm in robot.arms:
        tip = model.frames[model.getFrameId(arm.tip)]
        joints = [model.getJointId(name) for name in robot.arm_joints(arm)]
        places = [model.jointPlacements[j] for j in joints[1:]] + [tip.placement]
        ends.append([(j, X.translation.copy()) for j, X in zip(joints, places, strict=True)])
    reach = max(sum(float(np.linalg.norm(end)) for _, end in arm) for arm in ends)
    look: Any = {"name": "link", "start": (0.0, 0.0, 0.0), "radius": THICKNESS * reach}
    long = ((j, end) for arm in ends for j, end in arm if np.linalg.norm(end) > SHORT * reach)
    links = (Capsule(joint=model.names[j], end=tuple(end.tolist()), **look) for j, end in long)
    return list(dict.fromkeys(links))  # arms share those of a torso


def _within(surfaces: Sequence[Mesh], max_triangles: int) -> list[Mesh]:
    """All thinned by one grid, about as fine as the number of triangles allows."""
    if sum(len(surface.corners) for surface in surfaces) <= max_triangles:
        return list(surfaces)

    def fits(cell: float) -> bool:
        return sum(count_thinned(surface, cell) for surface in surfaces) <= max_triangles

    fine = FINEST * _size(surfaces)
    coarse = 4.0 * fine
    while not fits(coarse):
        fine, coarse = coarse, 4.0 * coarse
    for _ in range(TRIALS):
        cell = math.sqrt(fine * coarse)
        fine, coarse = (fine, cell) if fits(cell) else (cell, coarse)
    return [thinned(surface, coarse) for surface in surfaces]


def joined(parts: Sequence[Mesh]) -> Mesh:
    """Several surfaces as one."""
    first = np.cumsum([0, *(len(part.vertices) for part in parts)])
    corners = [part.corners + k for part, k in zip(parts, first[:-1], strict=True)]
    return Mesh(np.concatenate([part.vertices for part in parts]), np.concatenate(corners))


def moved(surface: Mesh, X: pin.SE3) -> Mesh:
    """The surface somewhere else."""
    return Mesh(surface.vertices @ X.rotation.T + X.translation, surface.corners)


def _surface(shape: Shape | SolidMarker) -> Mesh:
    """The surface of a shape, about its own origin; InvalidValueError: its mesh cannot be read."""
    size = shape.size
    if shape.kind == "mesh":
        assert shape.mesh is not None
        return _read_mesh(*version(shape.mesh), size)
    if shape.kind == "box":
        return _box(size)
    if shape.kind == "cylinder":
        radius, half = size[0], 0.5 * size[1]
        return _turned(np.array([[0, -half], [radius, -half], [radius, half], [0, half]]))
    if shape.kind == "capsule":
        return _turned(_round_ends(size[0], size[1]))
    ball = _turned(_round_ends(1.0, 0.0))  # an ellipsoid has three radii, a sphere one
    return Mesh(ball.vertices * np.array(size), ball.corners)


def _box(edges: Sequence[float]) -> Mesh:
    vertices = np.array(np.meshgrid([-0.5, 0.5], [-0.5, 0.5], [-0.5, 0.5], indexing="ij"))
    sides = [(0, 1, 3, 2), (4, 5, 7, 6), (0, 1, 5, 4), (2, 3, 7, 6), (0, 2, 6, 4), (1, 3, 7, 5)]
    halves = [half for a, b, c, d in sides for half in ((a, b, c), (a, c, d))]
    return Mesh(vertices.reshape(3, 8).T * np.array(edges), np.array(halves))


def _round_ends(radius: float, length: float) -> Array:
    """Half the outline of a capsule along z, shape (p, 2): distance from z, height."""
    quarter = np.linspace(0.0, 0.5 * np.pi, ROUND // 4 + 1)
    angles = np.concatenate([-quarter[::-1], quarter])
    half = np.repeat([-0.5, 0.5], len(quarter)) * length
    return np.column_stack([radius * np.cos(angles), radius * np.sin(angles) + half])


def _turned(outline: Array) -> Mesh:
    """The surface that an outline sweeps about z: distances from z and heights, (p, 2) [m]."""
    angles = np.linspace(0.0, 2.0 * np.pi, ROUND, endpoint=False)
    distance, height = outline[:, :1], np.broadcast_to(outline[:, 1:], (len(outline), ROUND))
    rings = np.stack([distance * np.cos(angles), distance * np.sin(angles), height], axis=-1)
    here = np.arange(rings[:-1, :, 0].size).reshape(-1, ROUND)
    right, up = np.roll(here, -1, axis=1), here + ROUND
    halves = [np.stack([here, right, up], -1), np.stack([right, np.roll(up, -1, axis=1), up], -1)]
    return Mesh(rings.reshape(-1, 3), np.concatenate(halves).reshape(-1, 3))


def thinned(surface: Mesh, cell: float) -> Mesh:
    """The surface with one vertex in each cell of a grid, of this edge [m].

    No vertex leaves its cell, so that the surface moves by less than a cell's diagonal.
    """
    cells, of_vertex = _cells(surface, cell)
    corners = of_vertex[surface.corners]
    points = _nearest_to_planes(surface, of_vertex, corners, len(cells))
    points = np.clip(points, cells * cell, (cells + 1) * cell)
    used, kept = np.unique(_distinct(corners), return_inverse=True)
    return Mesh(points[used], kept.reshape(-1, 3))


def count_thinned(surface: Mesh, cell: float) -> int:
    """How many triangles :func:`thinned` would leave."""
    return len(_distinct(_cells(surface, cell)[1][surface.corners]))


def _cells(surface: Mesh, cell: float) -> tuple[Ints, Ints]:
    """The cells that have vertices, shape (c, 3), and the number of each vertex's, shape (v,)."""
    cells = np.floor(surface.vertices / cell).astype(np.int64)
    numbers = _number(cells - cells.min(axis=0, initial=0))
    _, first, of_vertex = np.unique(numbers, return_index=True, return_inverse=True)
    return cells[first], of_vertex


def _distinct(corners: Ints) -> Ints:
    """Corners of the triangles with three distinct ones, each triangle once, shape (., 3)."""
    ordered = np.sort(corners, axis=1)
    ordered = ordered[np.diff(ordered, axis=1).all(axis=1)]
    _, first = np.unique(_number(ordered), return_index=True)
    return ordered[first]


def _number(rows: Ints) -> Ints:
    """One number for each row of three that are not negative, the same for the same ones."""
    base = rows.max(initial=0) + 1
    return np.asarray((rows[:, 0] * base + rows[:, 1]) * base + rows[:, 2])


def _nearest_to_planes(surface: Mesh, of_vertex: Ints, corners: Ints, count: int) -> Array:
    """Of each cell the point with the least sum of squared distances to its planes.

    A plane counts with its triangle's area. Where planes leave the point free it is as near to the
    mean of the cell's vertices as they allow. Shape (c, 3) [m]; ``corners`` are cells.
    """
    total = _sums(of_vertex, surface.vertices, count)
    mean: Array = total / np.bincount(of_vertex, minlength=count)[:, None]
    a, b, c = np.moveaxis(surface.vertices[surface.corners], 1, 0)
    normal = np.cross(b - a, c - a)  # as long as twice the area
    length = np.sqrt(np.linalg.norm(normal, axis=1, keepdims=True))
    planes = np.divide(normal, length, out=np.zeros_like(normal), where=length > 0.0)
    away = [((a - mean[cell]) * planes).sum(axis=1, keepdims=True) for cell in corners.T]
    off = _sums(corners.T.ravel(), np.concatenate([planes * d for d in away]), count)
    squares = (planes[:, :, None] * planes[:, None, :]).reshape(-1, 9)
    A = _sums(corners.T.ravel(), np.tile(squares, (3, 1)), count).reshape(-1, 3, 3)
    sizes, axes = np.linalg.eigh(A)
    firm = sizes > FLAT * np.maximum(sizes[:, -1:], np.finfo(float).tiny)
    inverse = np.divide(1.0, sizes, out=np.zeros_like(sizes), where=firm)
    return np.asarray(mean + np.einsum("cij,cj,ckj,ck->ci", axes, inverse, axes, off))


def _sums(of_row: Ints, rows: Array, count: int) -> Array:
    """Sum of the rows of each cell, shape (count, columns) (np.add.at is slow)."""
    return np.column_stack([np.bincount(of_row, column, count) for column in rows.T])
