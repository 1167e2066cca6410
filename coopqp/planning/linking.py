r"""How often two arms and what they hold are wound round themselves, which no free motion changes.

From the world through one arm, what both hold and the other arm back to the world leads a closed
line. The twist of the arms about it and its writhe, in turns, add up to the linking number of line
and arms (Calugareanu 1959), a whole number and a constant:

.. math:: \frac{1}{2\pi}\sum_i \pm q_i + Wr(q)

It changes only where the line passes through itself. Here the line lies inside of watched bodies,
so that pieces of it that cross are a collision. Of two pieces that move to each other

* two with a bend between them meet only where it is folded back;
* else the bodies round one are watched against those round the other.

Where the line leaves bodies, as between the hands, it goes straight over a gap from one body to
another. Each point there is within half the gap's length of one of these, so all others have to
lie in bodies, watched against both, that hold a ball of this radius about each of their points:
what were in the gap would be in one of them. Of a part of an arm up to a bend only what is as far
from the bend as the other piece counts, where that is fixed to it.

Known are arms that are straight where all joints are at zero, of hinges along and across them. All
is told at joints zero: a joint along its part of an arm only turns bodies about the line.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import lru_cache

import coal
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from scipy.sparse.csgraph import shortest_path

from coopqp.base.spec import Array
from coopqp.limit import DistanceBounds, Program
from coopqp.model.closed_chain import ClosedChain
from coopqp.robot import Convex, axis_of

#: What is no length, lean or turn [m, 1].
NOTHING = 1e-6
#: Least radius of the bodies about the line, beyond what it has to be, and its accuracy [m].
MIN_RADIUS, FINE = 1e-3, 1e-4
#: What a body more on the way costs against a longer gap [m].
HOP = 1e-4
#: No body is thicker [m].
THICK = 1.0
#: How far a difference of linking numbers may be from a whole number.
WHOLE = 1e-3


@dataclass(frozen=True)
class Held:
    """Why two pieces of the line never cross; nothing is proven where no margin is left."""

    pieces: tuple[str, str]  # their names
    why: str  # "fixed" to each other, "bend", "bodies" or "gap"
    # How near pieces come that are fixed to each other [m]; what is left of a bend to the folded
    # one [rad]; the least radius of bodies about a piece, less half the gap [m].
    margin: float


@dataclass(frozen=True, eq=False)
class _Solid:
    """A watched body, which is not flat."""

    joint: int
    convex: Convex

    def at(self, X: pin.SE3) -> _Placed:
        faces, placed = _faces(self.convex.points.tobytes()), X * self.convex.placement
        assert faces is not None
        normals = faces[:, :3] @ placed.rotation.T
        return _Placed(self, X, normals, faces[:, 3] - normals @ placed.translation)


@dataclass(frozen=True, eq=False)
class _Placed:
    """A body with its joint at X, and its faces there, n'p + d <= 0."""

    solid: _Solid
    X: pin.SE3
    normals: Array
    offsets: Array

    def depth(self, p: Array, side: Array | None = None) -> float:
        """Radius of the largest ball about a point that is inside [m]; negative outside.

        With a unit vector ``side`` of the half of the ball on that side.
        """
        left = -(self.normals @ p + self.offsets)
        if side is not None and left.min() > 0.0:
            lean = np.maximum(-self.normals @ side, 0.0)
            left = left / np.sqrt(np.maximum(1.0 - lean**2, NOTHING**2))
        return float(left.min())

    def span(self, start: Array, along: Array, r: float) -> tuple[float, float]:
        """From where to where on a line a disc of radius r across it is inside; empty as (0, 0)."""
        lean = self.normals @ along
        left = -(self.normals @ start + self.offsets) - r * np.sqrt(np.maximum(1.0 - lean**2, 0.0))
        up, down = lean > NOTHING, lean < -NOTHING
        if (left[~(up | down)] < 0.0).any():
            return (0.0, 0.0)
        low = float((left[down] / lean[down]).max(initial=-np.inf))
        high = float((left[up] / lean[up]).min(initial=np.inf))
        return (low, high) if low < high else (0.0, 0.0)


_Solids = frozenset[_Solid]

_Span = tuple[_Solids, float, float]
"""Bodies, and from where to where on a line one of them is."""

_Ball = tuple[_Solids, float, float]
"""Bodies, where on a line the middle of a ball is that they hold, and its radius [m]."""


@dataclass(frozen=True, eq=False)
class _Gap:
    """Between points of two bodies, ends (2, 3), that are fixed to each other."""

    solids: _Solids
    ends: Array


@dataclass(frozen=True, eq=False)
class _Piece:
    """A part of the line between points of bodies that are fixed to each other."""

    name: str  # where it begins and ends
    fixed: str  # what it is fixed to, the same for pieces that never move to each other
    solids: _Solids  # bodies that it lies in, but for its gaps
    gaps: tuple[_Gap, ...] = ()  # in the frame of what it is fixed to
    ball: float = 0.0  # radius of balls about its points in these bodies, but for the gaps [m]
    # in the same frame; none of a part of an arm
    corners: Array = field(default_factory=lambda: np.zeros((0, 3)))
    bends: tuple[int, int] = (0, 0)  # joints at its start and its end, 0 where there is no bend

    def radius(self, kept: _Solids, needed: float, fine: bool, beyond: dict[int, float]) -> float:
        """Of balls about its points that lie in the kept bodies [m]; 0 if below ``needed``.

        Just ``needed`` unless ``fine``. Points nearer to a bend than ``beyond`` do not count.
        """
        return self.ball if self.solids <= kept and self.ball >= needed and not self.gaps else 0.0


@dataclass(frozen=True, eq=False, kw_only=True)
class _Stretch(_Piece):
    """A straight part of an arm, told at joints zero."""

    line: tuple[Array, Array]  # start (3,) and direction (3,)
    length: float  # [m]
    own: tuple[_Placed, ...]  # bodies that only turn about it
    # Balls about its ends in bodies beyond the bends there, or on both sides of these: half of a
    # ball about a bend in one, the other half, on the other side along the bend's axis, in the
    # other, however it is bent.
    near: tuple[_Ball, ...]

    def radius(self, kept: _Solids, needed: float, fine: bool, beyond: dict[int, float]) -> float:
        low = beyond.get(self.bends[0], 0.0)
        high = self.length - beyond.get(self.bends[1], 0.0)
        if low > high:
            return np.inf
        if not self._holds(kept, needed, low, high):
            return 0.0
        known, wrong = needed, THICK if fine else needed
        while wrong - known > FINE:
            r = 0.5 * (known + wrong)
            known, wrong = (r, wrong) if self._holds(kept, r, low, high) else (known, r)
        return known

    def _holds(self, kept: _Solids, r: float, low: float, high: float) -> bool:
        """Whether balls of radius r lie in discs of that radius, or in one body at an end."""
        balls = {at: r * (not self._rounded(kept, r, at)) for at in (low, high)}
        spans = [x for x in _spans(self.line, self.own, self.near, r) if x[0] <= kept]
        chosen = _chosen(spans, low - balls[low], high + balls[high])
        return bool(chosen) and not _between(chosen)

    def _rounded(self, kept: _Solids, r: float, at: float) -> bool:
        p = self.line[0] + at * self.line[1]
        return any(x.solid in kept and x.depth(p) >= r for x in self.own) or any(
            some <= kept and where == at and radius >= r for some, where, radius in self.near
        )


class _Arm:
    """Of an arm that is straight at joints zero, the joints that twist and that bend it.

    Attributes:
        joints: from the base on; ``places`` of them, (j, 3) [m], and ``up`` from one to the next.
        leans: of their ``axes`` (3,) each +-1 where it lies along the arm, 0 across it.
        bends: joints across it.
        frame: of the object, with its place X_WO by this arm, at joints zero.
    """

    def __init__(self, model: pin.Model, data: pin.Data, frame: int) -> None:
        self.frame, self.X_WO = frame, data.oMf[frame].copy()
        self.joints = [j for j in model.supports[model.frames[frame].parentJoint] if j]
        self.places = np.array([data.oMi[j].translation for j in self.joints])
        along = self.places[-1] - self.places[0]
        self.up = along / max(float(np.linalg.norm(along)), NOTHING)
        axes = [axis_of(model.joints[j]) for j in self.joints]
        hinges = all(axis is not None and not axis[:3].any() for axis in axes)
        turned = [np.zeros(3) if axis is None else axis[3:] for axis in axes]
        self.axes = [data.oMi[j].rotation @ x for j, x in zip(self.joints, turned, strict=True)]
        leans = np.array([axis @ self.up for axis in self.axes])
        off = np.abs(np.cross(self.places - self.places[0], self.up)).max()
        off = max(off, np.abs(leans * (1.0 - leans**2)).max())
        self.leans = leans.round()
        self.bends = [j for j, lean in zip(self.joints, self.leans, strict=True) if not lean]
        self.straight = hinges and off < NOTHING and len(self.bends) > 1

    @property
    def corners(self) -> Array:
        return np.asarray(self.places[self.leans == 0.0])

    @property
    def parts(self) -> list[list[int]]:
        """Joints before the first bend and the world's 0, then from each bend to the next."""
        parts = [[0]]
        for j in self.joints:
            if j in self.bends:
                parts.append([])
            parts[-1].append(j)
        return parts


class _Bodies:
    """Those of all limits that are flat on their sides, and which pairs are watched."""

    def __init__(self, programs: Sequence[Program | None]) -> None:
        found: dict[tuple[int, bytes, bytes], _Solid] = {}
        self._against: dict[_Solid, set[_Solid]] = {}
        for program in programs:
            if not isinstance(program, DistanceBounds) or program.distance <= 0.0:
                continue
            solids = list[_Solid | None]()
            for joint, convex in program.bodies:
                points, placement = convex.points.tobytes(), convex.placement.homogeneous.tobytes()
                one = found.setdefault((joint, points, placement), _Solid(joint, convex))
                solids.append(None if _faces(points) is None else one)
            for a, b in program.pairs.tolist():
                one, other = solids[a], solids[b]
                if one is not None and other is not None:
                    self._against.setdefault(one, set()).add(other)
                    self._against.setdefault(other, set()).add(one)
        self.all = tuple(self._against)

    def against(self, others: Iterable[_Solid]) -> _Solids:
        return frozenset(self.all).intersection(*(self._against[other] for other in others))


class _NoLineError(Exception):
    """Bodies hold no line."""


class ClosedLine:
    """The closed line of two arms; ``proven``: whether no two of its pieces ever cross."""

    def __init__(self, chain: ClosedChain, arms: Sequence[_Arm], bodies: _Bodies) -> None:
        model = chain.model
        self._chain, self._data, self._arms, self._bodies = chain, model.createData(), arms, bodies
        zero = model.createData()
        pin.forwardKinematics(model, zero, np.zeros(chain.n))
        self._placed = {solid: solid.at(zero.oMi[solid.joint]) for solid in bodies.all}
        self._axes = {j: axis for arm in arms for j, axis in zip(arm.joints, arm.axes, strict=True)}
        self._twist = np.zeros(chain.n)
        for arm in arms:
            self._twist[[model.idx_qs[j] for j in arm.joints]] = arm.leans
        farthest = np.maximum(-chain.lower, chain.upper)
        bends = [j for arm in arms for j in arm.bends]
        self._unfolded = {j: float(np.pi - farthest[model.idx_vs[j]]) for j in bends}
        self._pieces: list[_Piece] = [piece for arm in arms for piece in self._between(arm)]
        self._fixed = dict[tuple[str, int], Array]()
        self._below, below = self._across("world", 0, [pin.SE3.Identity()] * 2)
        self._above, above = self._across("object", -1, [arm.X_WO.inverse() for arm in arms])
        ends = (("world", below), ("object", above))
        self._apart = [Held((name, name), "fixed", margin) for name, margin in ends]
        self.proven = all(one.margin > 0.0 for one in self.held(fine=False))

    def held(self, fine: bool = True) -> list[Held]:
        """Why each two pieces never cross; margins of radii are just enough unless ``fine``."""
        pairs = itertools.combinations(self._pieces, 2)
        moving = ((one, other) for one, other in pairs if one.fixed != other.fixed)
        return [*self._apart, *(held for pair in moving for held in self._crossing(*pair, fine))]

    def number(self, q: Array) -> float:
        """The linking number and a constant."""
        pin.framesForwardKinematics(self._chain.model, self._data, q)
        first, other = ([self._data.oMi[j].translation for j in arm.bends] for arm in self._arms)
        X_WO = self._data.oMf[self._arms[0].frame]
        above = self._above @ X_WO.rotation.T + X_WO.translation
        corners = np.array([*first, *above, *other[::-1], *self._below[::-1]])
        return float(self._twist @ q) / (2.0 * np.pi) + writhe(corners)

    def differs(self, q: Array) -> NDArray[np.int_]:
        """By how much the numbers at closed configurations (N, n) are proven to differ.

        Shape (N,), from the first one's; 0 where nothing is proven.
        """
        turns = np.array([self.number(row) for row in q])
        turns -= turns[:1]
        whole = np.abs(turns - turns.round()) < WHOLE
        return np.where(whole & self.proven, turns.round(), 0.0).astype(int)

    def _between(self, arm: _Arm) -> Iterator[_Piece]:
        for k in range(1, len(arm.bends)):
            start, end = arm.corners[k - 1 : k + 1]
            bends = (arm.bends[k - 1], arm.bends[k])
            length = float(np.linalg.norm(end - start))
            near = [*self._balls(arm, k - 1, k, 0.0), *self._balls(arm, k + 1, k, length)]
            yield self._stretch((start, arm.up), length, bends, arm.parts[k], near)

    def _balls(self, arm: _Arm, part: int, own: int, at: float) -> Iterator[_Ball]:
        """Balls about the bend between two neighbouring parts, in other bodies than own ones."""
        bend = max(part, own) - 1
        p, axis = arm.corners[bend], self._axes[arm.bends[bend]]
        mine = [x for x in self._placed.values() if x.solid.joint in arm.parts[own]]
        for x in self._placed.values():
            if x.solid.joint not in arm.parts[part] or x.depth(p) <= 0.0:
                continue
            yield frozenset((x.solid,)), at, x.depth(p)
            for y, side in itertools.product(mine, (axis, -axis)):
                yield frozenset((x.solid, y.solid)), at, min(x.depth(p, side), y.depth(p, -side))

    def _stretch(
        self, line: tuple[Array, Array], length: float, bends: tuple[int, int],
        joints: Sequence[int], near: Sequence[_Ball], fixed: str = "", X: pin.SE3 | None = None,
    ) -> _Stretch:  # fmt: skip
        """A part of an arm, whose own bodies are those of some joints.

        ``X``: from the world to what it is fixed to, if that is of both arms.
        """
        names = self._chain.model.names
        own = tuple(x for x in self._placed.values() if x.solid.joint in joints)
        spans = _spans(line, own, near, MIN_RADIUS)
        ways = [_chosen(some, 0.0, length) for some in (spans[: len(own)], spans)]
        whole = [way for way in ways if way and not _between(way)]
        chosen = next((way for way in (*whole, *ways) if way), None)
        if chosen is None:
            raise _NoLineError
        gaps = []
        for both, low, high in _between(chosen):
            ends = np.array([line[0] + at * line[1] for at in (low, high)])
            ends = np.array([X.act(end) for end in ends]) if X else ends
            gaps.append(_Gap(both, ends))
        name = " to ".join(names[bend] if bend else fixed for bend in bends)
        return _Stretch(
            name, fixed or names[bends[0]], frozenset().union(*(x[0] for x in chosen)), tuple(gaps),
            bends=bends, line=line, length=length, own=own, near=tuple(near),
        )  # fmt: skip

    def _across(self, fixed: str, part: int, frames: Sequence[pin.SE3]) -> tuple[Array, float]:
        """The line between the arms' first (0) or last (-1) bends, and how near it is to itself.

        Over the shortest gaps between bodies that are fixed to each other, from one in which the
        straight line beyond an arm's bend is. ``frames``: from the world to these, of each arm.
        """
        clear = self._bodies.against(x for piece in self._pieces for x in piece.solids)
        placed, sides = dict[_Solid, _Placed](), list[list[tuple[int, Array, _Stretch]]]()
        for arm, X in zip(self._arms, frames, strict=True):
            joint = arm.joints[-1] if part else 0
            here = [solid for solid in self._bodies.all if solid.joint == joint and solid in clear]
            placed |= {solid: solid.at(X * self._placed[solid].X) for solid in here}
            self._fixed[fixed, arm.bends[part]] = X.act(arm.corners[part])
            order, side = list(placed), []
            for solid in here:
                if begun := self._side(fixed, part, arm, solid, X):
                    side.append((order.index(solid), *begun))
            sides.append(side)
        bodies = list(placed.values())
        gaps = np.zeros((len(bodies), len(bodies)))
        for (i, one), (k, other) in itertools.combinations(enumerate(bodies), 2):
            gaps[i, k] = gaps[k, i] = _nearest(one, other)[0]
        costs, before = shortest_path(np.maximum(gaps, 0.0) + HOP, return_predecessors=True)
        ends = list(itertools.product(*sides))
        if not ends:
            raise _NoLineError
        first, last = min(ends, key=lambda two: float(costs[two[0][0], two[1][0]]))
        at, path = last[0], [bodies[last[0]]]
        while at != first[0]:
            at = int(before[first[0], at])
            path.insert(0, bodies[at])
        corners, between, ball = _through(path, first[1], last[1])
        solids = frozenset(x.solid for x in path)
        self._pieces += [first[2], last[2], _Piece(fixed, fixed, solids, between, ball, corners)]
        whole = [self._fixed[fixed, arm.bends[part]] for arm in self._arms]
        return corners, _simple(np.array([whole[0], *corners, whole[1]]))

    def _side(
        self, fixed: str, part: int, arm: _Arm, solid: _Solid, X: pin.SE3
    ) -> tuple[Array, _Stretch] | None:
        """Where the straight line beyond an arm's bend is within a body, and its piece up to it."""
        line = arm.corners[part], arm.up if part else -arm.up
        low, high = self._placed[solid].span(*line, MIN_RADIUS)
        if high <= MIN_RADIUS:
            return None
        length = 0.5 * (max(low, 0.0) + high)
        own = len(arm.parts) - 1 if part else 0
        near = self._balls(arm, own - 1 if part else 1, own, 0.0)
        try:
            piece = self._stretch(
                line, length, (arm.bends[part], 0), arm.parts[part], list(near), fixed, X
            )
        except _NoLineError:
            return None
        return X.act(line[0] + length * line[1]), piece

    def _crossing(self, one: _Piece, other: _Piece, fine: bool) -> Iterator[Held]:
        names = (one.name, other.name)
        if bends := {*one.bends} & {*other.bends} - {0}:
            yield Held(names, "bend", min(self._unfolded[j] for j in bends))
            return
        if other.gaps or (len(other.corners) and not one.gaps):
            one, other = other, one
        kept = self._bodies.against(one.solids)
        beyond = self._beyond(one, other, one.corners)
        yield Held(names, "bodies", other.radius(kept, MIN_RADIUS, fine, beyond))
        for gap in one.gaps:
            half = 0.5 * float(np.linalg.norm(gap.ends[1] - gap.ends[0]))
            kept = self._bodies.against(gap.solids)
            beyond = self._beyond(one, other, gap.ends)
            yield Held(names, "gap", other.radius(kept, half + MIN_RADIUS, fine, beyond) - half)

    def _beyond(self, one: _Piece, other: _Piece, corners: Array) -> dict[int, float]:
        """How far a line in the frame of one is from the other's bends that are fixed there."""
        if not len(corners):
            return {}
        ends = {bend: self._fixed.get((one.fixed, bend)) for bend in other.bends}
        return {
            bend: float(_apart(corners[:-1], corners[1:], p[None], p[None]).min())
            for bend, p in ends.items()
            if p is not None
        }


def closed_line(chain: ClosedChain, programs: Sequence[Program | None]) -> ClosedLine | None:
    """The line of two arms inside bodies that the programs watch; None where there is none."""
    if len(chain.frames) != 2 or chain.holding != 2 or chain.loops.closed != 6:
        return None
    data = chain.model.createData()
    pin.framesForwardKinematics(chain.model, data, np.zeros(chain.n))
    arms = [_Arm(chain.model, data, frame) for frame in chain.frames]
    if not all(arm.straight for arm in arms) or sum(len(arm.joints) for arm in arms) != chain.n:
        return None
    try:
        return ClosedLine(chain, arms, _Bodies(programs))
    except _NoLineError:
        return None


def writhe(corners: Array) -> float:
    """Of a closed line of straight sides, shape (N, 3), in turns.

    Over all pairs of sides the solid angle of the directions from a point of one to a point of the
    other, each of two triangles (van Oosterom and Strackee 1983); its sign is the crossing's.
    """
    a, b, c, d = _pairs(corners)
    sides = [c - a, d - a, d - b, c - b]
    e = [x / np.maximum(np.linalg.norm(x, axis=1), NOTHING**2)[:, None] for x in sides]
    return -(_solid_angle(e[0], e[1], e[2]) + _solid_angle(e[0], e[2], e[3])) / (2.0 * np.pi)


def _solid_angle(a: Array, b: Array, c: Array) -> float:
    volume = _dot(a, np.cross(b, c))
    return float(2.0 * np.arctan2(volume, 1.0 + _dot(a, b) + _dot(b, c) + _dot(c, a)).sum())


def _spans(
    line: tuple[Array, Array], own: Sequence[_Placed], near: Sequence[_Ball], r: float
) -> list[_Span]:
    """Of each body where discs of radius r across a line are in it."""
    found: list[_Span] = [(frozenset((x.solid,)), *x.span(*line, r)) for x in own]
    for some, at, radius in near:
        half = math.sqrt(max(radius, r) ** 2 - r**2)
        found.append((some, at - half, at + half))
    return found


def _chosen(spans: Sequence[_Span], low: float, high: float) -> list[_Span]:
    """Few that span from low to high one after the other, but for gaps; empty: there are none."""
    found, at = list[_Span](), low
    while at < high or not found:
        on = max((x for x in spans if x[1] <= at), key=lambda x: x[2], default=None)
        if on is None or on[2] <= at:
            on = min((x for x in spans if x[2] > x[1] > at), key=lambda x: x[1], default=None)
            if on is None or not found:
                return []
        found.append(on)
        at = on[2]
    return found


def _between(chosen: Sequence[_Span]) -> list[tuple[_Solids, float, float]]:
    pairs = itertools.pairwise(chosen)
    return [(one[0] | other[0], one[2], other[1]) for one, other in pairs if one[2] < other[1]]


def _through(
    path: Sequence[_Placed], start: Array, end: Array
) -> tuple[Array, tuple[_Gap, ...], float]:
    """Corners of a line from start to end through bodies, its gaps, and the least ball about it."""
    corners, gaps = [start], []
    ball = min(path[0].depth(start), path[-1].depth(end))
    for one, other in itertools.pairwise(path):
        d, a, b = _nearest(one, other)
        middle = 0.5 * (a + b)
        inside = min(one.depth(middle), other.depth(middle))
        if d < 0.0 < inside:
            corners.append(middle)
            ball = min(ball, inside)
        else:
            corners += [a, b]
            gaps.append(_Gap(frozenset((one.solid, other.solid)), np.array([a, b])))
    return np.array([*corners, end]), tuple(gaps), ball


def _nearest(one: _Placed, other: _Placed) -> tuple[float, Array, Array]:
    """Distance of two bodies, and where each is nearest to the other, or deepest in it."""
    result = coal.DistanceResult()
    placed = []
    for x in (one, other):
        X = x.X * x.solid.convex.placement
        placed += [x.solid.convex.geometry, coal.Transform3s(X.rotation, X.translation)]
    d = coal.distance(*placed, coal.DistanceRequest(), result)
    return d, np.array(result.getNearestPoint1()), np.array(result.getNearestPoint2())


@lru_cache(maxsize=512)
def _faces(points: bytes) -> Array | None:
    """Unit normals and offsets, n'p + d <= 0, of the convex hull of points; None: it is flat."""
    from scipy.spatial import ConvexHull, QhullError  # robots without bodies do not wait for it

    try:
        return np.asarray(ConvexHull(np.frombuffer(points).reshape(-1, 3)).equations, float)
    except (QhullError, ValueError):
        return None


def _simple(corners: Array) -> float:
    """How near to each other sides of an open line come that have no corner in common [m].

    0 where one is folded back on the one before.
    """
    along = np.diff(corners, axis=0)
    along /= np.maximum(np.linalg.norm(along, axis=1), NOTHING)[:, None]
    if (_dot(along[:-1], along[1:]) < NOTHING - 1.0).any():
        return 0.0
    return float(_apart(*_pairs(corners, closed=False)).min(initial=np.inf))


def _apart(a: Array, b: Array, c: Array, d: Array) -> Array:
    """How near straight lines from a to b and from c to d come, shape (P, 3) each; (P,) [m]."""
    u, v, w = b - a, d - c, a - c
    uu, uv, vv, uw, vw = (_dot(*x) for x in ((u, u), (u, v), (v, v), (u, w), (v, w)))
    uu, vv = (np.maximum(x, NOTHING**2) for x in (uu, vv))
    rest = np.maximum(uu * vv - uv * uv, NOTHING**4)
    t = np.clip((uv * np.clip((uv * vw - vv * uw) / rest, 0.0, 1.0) + vw) / vv, 0.0, 1.0)
    s = np.clip((uv * t - uw) / uu, 0.0, 1.0)
    return np.asarray(np.linalg.norm(w + s[:, None] * u - t[:, None] * v, axis=1))


def _pairs(corners: Array, closed: bool = True) -> list[Array]:
    """Ends of each two sides of a line that have no corner in common, shape (P, 3) each."""
    n, ends = len(corners), np.roll(corners, -1, axis=0)
    sides = itertools.combinations(range(n if closed else n - 1), 2)
    found = [(i, k) for i, k in sides if k > i + 1 and (not closed or k - i < n - 1)]
    i, k = np.array(found, int).reshape(-1, 2).T
    return [corners[i], ends[i], corners[k], ends[k]]


def _dot(a: Array, b: Array) -> Array:
    return np.asarray((a * b).sum(axis=1), float)
