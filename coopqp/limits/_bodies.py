"""Convex bodies of a robot and what it holds, their signed distances, and which of them can meet.

Bodies are primitives and the convex hulls of meshes, each about the middle of the box round it, so
that boxes and balls about its origin bound it from outside. With p a nearest point, n the unit
normal from the first body to the second and d their signed distance, as coal gives them, and
J_first, J_second the bodies' Jacobians of a point at p (both nearest points lie on one line along
n),

    -d_dot = n' (J_first - J_second) v

Most pairs are far apart, by the box round one body and the ball round the other, a few operations
on arrays for all pairs; only the others are handed to coal.

Neighbours touch by design and are no pair: bodies of one joint or of joints that follow each other,
hands that hold one object firmly, and the object with the hands and what is before them. Neither
are bodies of one robot that touch by construction: those that do so in nearly all of some random
configurations, or, one carrying the other, where all joints are at zero.
"""

import bisect
import fnmatch
import itertools
import math
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import coal
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from coopqp.base.errors import InvalidValueError, UnknownNameError
from coopqp.base.reading import version
from coopqp.base.spec import UNLIMITED, Array
from coopqp.model.closed_chain import ClosedChain
from coopqp.robot import Capsule, Convex, Form, RobotModel, Shape
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
    count = NUMBERS[shape.kind]
    if len(shape.size) != count or not np.isfinite(shape.size).all():
        words = f"found size {list(shape.size)}, needs {count} numbers"
        raise InvalidValueError(f"{shape.kind}: {words}")
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


OBJECT = "object"

#: Random configurations that are looked at, and the share of them in which bodies that touch by
#: construction do.
SAMPLES, SHARE = 100, 0.95


class _Tree:
    """Which bodies follow which."""

    def __init__(self, robot: RobotModel, model: pin.Model, bodies: Collection[Body]) -> None:
        self._model, self._occupied = model, {body.joint for body in bodies}
        ways = [robot.arm_joints(arm) for arm in robot.arms]
        # What several arms share, such as a waist, belongs to none.
        self._arm_of = {
            joint: i
            for i, way in enumerate(ways)
            for joint in way
            if sum(joint in other for other in ways) == 1
        }
        frames = list(model.frames)
        self._root_ids = [i for i, f in enumerate(frames) if i and f.parentFrame == 0]
        self._roots = [frames[i].name for i in self._root_ids]

    def neighbours(self, a: Body, b: Body) -> bool:
        if a.joint == b.joint:
            return True
        arms = {self._arm_of.get(self._model.names[body.joint]) for body in (a, b)}
        if not (a.link or b.link) and len(arms) == 1 and None not in arms:
            return True  # capsules are too coarse for an arm against itself
        one, other = (a, b) if a.joint < b.joint else (b, a)
        return self.before(other.joint) == one.joint and (
            one.joint > 0 or self.root(one) in ("", self.root(other))
        )

    def carries(self, a: Body, b: Body) -> bool:
        supports = self._model.supports
        return a.joint in list(supports[b.joint]) or b.joint in list(supports[a.joint])

    def before(self, joint: int) -> int:
        """The nearest joint before it that carries bodies; 0 if none does."""
        before = [j for j in self._model.supports[joint] if j != joint and j in self._occupied]
        return max(before, default=0)

    def root(self, body: Body) -> str:
        """Name of the first link of the robot that it belongs to; empty for capsules."""
        if not body.link:
            return ""
        # Of a robot the first frame alone follows the world's; pinocchio forgets the frame before
        # a locked joint, but keeps a robot's frames together.
        at = self._model.getFrameId(body.link)
        return str(self._roots[bisect.bisect(self._root_ids, at) - 1])

    def hands(self, chain: ClosedChain) -> set[int]:
        """Joints whose bodies may touch the object: hands, what follows and what is before them.

        Not of arms that neither hold it nor are about to.
        """
        model, found = self._model, set[int]()
        for arm in (arm for arm in chain.robot.arms if arm.name not in chain.hold.away):
            tip = model.frames[model.getFrameId(arm.tip)].parentJoint
            found |= {j for j in range(model.njoints) if tip in model.supports[j]}
            hand = tip if tip in self._occupied else self.before(tip)
            found |= {hand, self.before(hand)} - {0}
        return found


def _robot_bodies(of: RobotModel | ClosedChain) -> tuple[list[Body], list[str]]:
    """The robot's bodies, from capsules or shapes, and a sentence for each part that cannot be one.

    Meshes of one link are one body: robots drawn in CAD have one for every screw. Of a chain joints
    are those of its model.
    """
    robot, model = of.robot if isinstance(of, ClosedChain) else of, of.model
    bodies = [
        Body(c.name, model.getJointId(c.joint) if c.joint else 0, of_capsule(c))
        for c in robot.capsules
    ]
    faults = [*robot.unseen]
    for link in dict.fromkeys(shape.frame for shape in robot.collision_shapes):
        frame = model.frames[model.getFrameId(link)]
        shapes = [
            replace(shape, placement=frame.placement * shape.placement)
            for shape in robot.collision_shapes
            if shape.frame == link
        ]
        for i, part in enumerate(_parts(shapes, faults)):
            name = f"{link}[{i + 1}]" if i else link
            bodies.append(Body(name, frame.parentJoint, part, link))
    return bodies, faults


def _parts(shapes: Sequence[Shape], faults: list[str]) -> Iterator[Convex]:
    """The convex bodies of a link; its meshes are one."""
    meshes = []
    for shape in shapes:
        try:
            if shape.kind == "mesh":
                outermost(shape)
                meshes.append(shape)
            else:
                yield of_shape(shape)
        except InvalidValueError as error:
            faults.append(f"{shape.frame}: {error}")
    try:
        if meshes:
            yield of_meshes(meshes)
    except InvalidValueError as error:
        faults.append(f"{meshes[0].frame}: {error}")


def bodies_of(chain: ClosedChain) -> tuple[list[Body], list[str]]:
    """The robot's bodies, the object as the first arm carries it, and what cannot be watched.

    InvalidValueError: the robot has none.
    """
    bodies, faults = chain.once(_robot_bodies)
    if not bodies:
        why = f": {faults[0]}" if faults else ""
        raise InvalidValueError(
            f"robot {chain.robot.name} has no collision geometry{why}; leave this limit out, "
            "use a file with it, or add capsules to RobotModel.capsules"
        )
    frame = chain.model.frames[chain.frames[0]]
    size = tuple(float(edge) for edge in chain.held.size)
    box = Shape(frame=frame.name, placement=frame.placement, kind="box", size=size)
    return [*bodies, Body(OBJECT, frame.parentJoint, of_shape(box))], faults


def named_bodies(
    where: str, name: str, bodies: Sequence[Body], faults: Sequence[str]
) -> list[Body]:
    """Those of a link, or of this very name, or else that a pattern fits; errors where none is."""
    found = [body for body in bodies if name in (body.name, body.link)]
    found = found or [body for body in bodies if fnmatch.fnmatchcase(body.name, name)]
    for fault in faults if not found else ():
        if fault.startswith(f"{name}: "):
            raise InvalidValueError(f"{where}nothing of {fault}")
    if not found:
        raise UnknownNameError("body", name, [body.name for body in bodies], where)
    return found


def pairs_that_can_meet(chain: ClosedChain) -> list[Pair]:
    """All pairs of :func:`bodies_of` but neighbours and those that touch by construction."""
    (*bodies, held), _ = bodies_of(chain)
    tree, pairs = chain.once(_apart)
    firm = {chain.model.frames[i].parentJoint for i in chain.frames[: chain.holding]}
    touching = tree.hands(chain) | {held.joint}
    found = [(a, b) for a, b in pairs if not {a.joint, b.joint} <= firm]
    return found + [(held, body) for body in bodies if body.joint not in touching]


def _apart(chain: ClosedChain) -> tuple[_Tree, list[Pair]]:
    """Pairs of the robot's bodies that are no neighbours and do not touch by construction."""
    bodies, _ = chain.once(_robot_bodies)
    tree, joined = _Tree(chain.robot, chain.model, bodies), by_construction(chain.robot)
    return tree, [
        (a, b) if a.joint else (b, a)  # the base comes second
        for a, b in itertools.combinations(bodies, 2)
        if not tree.neighbours(a, b) and frozenset((a.name, b.name)) not in joined
    ]


@lru_cache(maxsize=16)
def by_construction(robot: RobotModel) -> frozenset[frozenset[str]]:
    """Names of the pairs of one robot's bodies that touch by construction."""
    model, data = robot.model, robot.model.createData()
    bodies, _ = _robot_bodies(robot)
    tree = _Tree(robot, model, bodies)
    pairs = [
        (a, b)
        for a, b in itertools.combinations(bodies, 2)
        if tree.root(a) == tree.root(b) and not tree.neighbours(a, b)
    ]
    found, touch = Distances(pairs), np.zeros((1 + SAMPLES, len(pairs)), bool)
    for q, row in zip(_configurations(model), touch, strict=True):
        pin.updateGeometryPlacements(model, data, found.geometry, found.placed, q)
        found.measure(0.0)
        row[:] = found.d < 0.0
    at_zero = touch[0] & np.array([tree.carries(*pair) for pair in pairs], bool)
    left_out = np.flatnonzero((touch[1:].sum(axis=0) >= SHARE * SAMPLES) | at_zero).tolist()
    return frozenset(frozenset(body.name for body in pairs[i]) for i in left_out)


def _configurations(model: pin.Model) -> Array:
    """All joints at zero, or at their limit nearest to it, then random ones."""
    ends = np.array([model.lowerPositionLimit, model.upperPositionLimit])
    lower, upper = np.where(np.isfinite(ends), ends, [[-UNLIMITED], [UNLIMITED]])
    samples = np.random.default_rng(0).uniform(lower, upper, (SAMPLES, len(lower)))
    return np.vstack([np.clip(0.0, *ends), samples])
