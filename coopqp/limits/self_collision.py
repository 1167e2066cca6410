"""Arms, torso and object stay apart: d_dot >= -gain (d - distance) for pairs of bodies.

Bodies are the robot's capsules and the object's box, as carried by the first arm. With p a
nearest point, n the unit normal from the first body to the second and d their signed distance, as
coal gives them, and J_first, J_second the bodies' Jacobians of a point at p,

    n' (J_first - J_second) v <= gain (d - distance)

Both nearest points lie on one line along n, so one of them does for both bodies. A pair that is
too close by more than a millimetre may not come closer, but is not asked apart
(:func:`coopqp.limit.damp`), so that one that cannot part does not stop the robot.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, replace

import coal
import numpy as np
import pinocchio as pin

from coopqp.checked import Array, NonNegative, Positive, overshoot, spec
from coopqp.closed_chain import ClosedChain
from coopqp.errors import InvalidValueError, UnknownNameError
from coopqp.limit import Limit, LimitRows, RoomLeft, Tighten, damp, movers
from coopqp.robot import Capsule
from coopqp.row import Row
from coopqp.state import State

OBJECT = "object"

#: How far from 1 a unit normal's square, and from 0 a length [m], may be.
UNIT = 1e-6


@spec
class SelfCollision(Limit):
    """Arms, torso and object keep a distance from each other."""

    distance: NonNegative = 0.01
    """Kept free between two bodies [m]."""
    gain: Positive = 10.0
    """Share of the distance that may be used up per second [1/s]; at most 1/dt."""
    pairs: tuple[tuple[str, str], ...] | None = None
    """Names of the robot's capsules, or "object"; those that can meet if omitted."""

    def __post_init__(self) -> None:
        seen: set[frozenset[str]] = set()
        for pair in self.pairs or ():
            one = frozenset(pair)
            if len(one) < 2 or one in seen:
                raise ValueError(f"pair {list(pair)} names one body, or a pair given before")
            seen.add(one)

    def rows(self, chain: ClosedChain) -> tuple[Row, ...]:
        """One row a pair."""
        return tuple(
            Row(
                name=f"limit.self_collision[{a}|{b}]",
                kind="limit",
                owner="self_collision",
                unit="m",
                label=f"the distance of {a} and {b}",
                of_place=True,
            )
            for a, b in self._pairs(chain)
        )

    def bind(self, chain: ClosedChain, dt: float) -> Tighten:
        """One row a pair, whether near or not, so that the count never changes."""
        if wrong := overshoot(self.gain, dt):
            raise InvalidValueError(f"self_collision: {wrong}")
        bodies = _Bodies(chain, self._pairs(chain))
        gain, distance = np.full(len(bodies.d), self.gain), np.array(self.distance)
        room, deep = np.zeros_like(bodies.d), np.zeros(len(bodies.d), bool)

        def tighten(state: State, rows: LimitRows) -> None:
            bodies.update(state)
            damp(np.subtract(bodies.d, distance, room), gain, deep, rows.h)
            bodies.fill(state, rows.G)

        return tighten

    def room(self, chain: ClosedChain) -> RoomLeft:
        """Distance of each pair, less what is kept free [m]."""
        bodies = _Bodies(chain, self._pairs(chain))

        def left(state: State) -> Array:
            bodies.update(state)
            return np.asarray(bodies.d - self.distance, float)

        return left

    def eased(self, room: float) -> SelfCollision | None:
        """A smaller distance; None where bodies would have to sink into each other."""
        return replace(self, distance=self.distance - room) if room <= self.distance else None

    def _pairs(self, chain: ClosedChain) -> tuple[tuple[str, str], ...]:
        """Those given, or those that can meet.

        Raises:
            InvalidValueError: the robot has no capsules.
            UnknownNameError: no body has the name given.
        """
        if not chain.robot.capsules:
            raise InvalidValueError(
                f"self_collision: robot {chain.robot.name} has no capsules; "
                "leave this limit out or add them to RobotModel.capsules"
            )
        if self.pairs is None:
            return _pairs_that_can_meet(chain)
        known = [*(capsule.name for capsule in chain.robot.capsules), OBJECT]
        for name in itertools.chain.from_iterable(self.pairs):
            if name not in known:
                raise UnknownNameError("body", name, known, "self_collision.pairs: ")
        return self.pairs


def _pairs_that_can_meet(chain: ClosedChain) -> tuple[tuple[str, str], ...]:
    """Each arm with the others and with the base, the object with the base and the arms.

    Left out are neighbours, which touch by design: the base with the first body of an arm, and
    the object with the last two; and bodies that the grasps fix to each other.
    """
    robot = chain.robot
    owners: dict[str, list[str]] = {}
    for arm in robot.arms:
        for joint in robot.arm_joints(arm):
            owners.setdefault(joint, []).append(arm.name)
    of_arm: dict[str, list[str]] = {arm.name: [] for arm in robot.arms}
    base: list[str] = []
    for capsule in robot.capsules:
        owner = owners.get(capsule.joint or "", [])
        # What several arms share, such as a waist, counts as base.
        (of_arm[owner[0]] if len(owner) == 1 else base).append(capsule.name)
    pairs = [
        pair
        for one, other in itertools.combinations(of_arm.values(), 2)
        for pair in itertools.product(one, other)
    ]
    for bodies in of_arm.values():
        pairs += itertools.product(bodies[1:], base)
        pairs += itertools.product([OBJECT], bodies[:-2])
    pairs += itertools.product([OBJECT], base)
    fixed = _fixed_to_the_object(chain)
    return tuple(pair for pair in pairs if not fixed.issuperset(pair))


def _fixed_to_the_object(chain: ClosedChain) -> set[str]:
    """Names of the bodies that the object moves with; passive joints set hands free."""
    carriers = {chain.model.names[chain.model.frames[i].parentJoint] for i in chain.frames}
    return {OBJECT, *(c.name for c in chain.robot.capsules if c.joint in carriers)}


@dataclass(frozen=True)
class _Body:
    """A convex body fixed to a joint."""

    joint: int
    placement: pin.SE3
    geometry: coal.CollisionGeometry


class _Bodies:
    """Signed distances of pairs of bodies, and how they change.

    Attributes:
        d: shape (p,) [m].
    """

    def __init__(self, chain: ClosedChain, pairs: tuple[tuple[str, str], ...]) -> None:
        bodies = {c.name: _capsule(chain, c) for c in chain.robot.capsules}
        bodies[OBJECT] = _box(chain)
        self._geometry, ids = pin.GeometryModel(), {}
        for name, body in bodies.items():
            ids[name] = self._geometry.addGeometryObject(
                pin.GeometryObject(name, body.joint, body.placement, body.geometry)
            )
        for a, b in pairs:
            self._geometry.addCollisionPair(pin.CollisionPair(ids[a], ids[b]))
        self._placed = pin.GeometryData(self._geometry)
        self._results = list(self._placed.distanceResults)
        moved = [movers(chain, [bodies[pair[side]].joint for pair in pairs]) for side in (0, 1)]
        # Joints that move both bodies change no distance.
        self._sign = moved[0] - moved[1]
        self._ids = [(ids[first], ids[second]) for first, second in pairs]
        self.d = np.zeros(len(pairs))
        # Columns x y z x y, so that slices give the shifted columns of a cross product.
        self._n, self._p = np.zeros((len(pairs), 5)), np.zeros((len(pairs), 5))
        self._W, self._minus = np.zeros((len(pairs), 6)), np.zeros((len(pairs), 3))
        self._G = np.zeros_like(self._sign)

    def update(self, state: State) -> None:
        """Find the distances."""
        state.place(self._geometry, self._placed)
        pin.computeDistances(self._geometry, self._placed)
        self.d[:] = [result.min_distance for result in self._results]

    def fill(self, state: State, G: Array) -> None:
        """Write -d_dot per joint speed, shape (p, n)."""
        n, p, W = self._n, self._p, self._W
        n[:, :3] = [result.normal for result in self._results]
        p[:, :3] = [result.getNearestPoint1() for result in self._results]
        if self.d.min() < 0.0:
            self._mend()
        n[:, 3:], p[:, 3:] = n[:, :2], p[:, :2]
        W[:, :3] = n[:, :3]
        np.multiply(p[:, 1:4], n[:, 2:], W[:, 3:])
        np.multiply(p[:, 2:], n[:, 1:4], self._minus)
        np.subtract(W[:, 3:], self._minus, W[:, 3:])
        W.dot(state.J_joints, self._G)
        np.multiply(self._G, self._sign, G)

    def _mend(self) -> None:
        """Where axes of capsules cross there is no normal; take any way out of each other."""
        for i, (first, second) in enumerate(self._ids):
            n = self._n[i, :3]
            if not abs(n.dot(n) - 1.0) < UNIT:  # written so that a NaN is mended
                X_1, X_2 = self._placed.oMg[first], self._placed.oMg[second]
                way = X_2.translation - X_1.translation
                size = math.sqrt(way.dot(way))
                n[:] = way / size if size > UNIT else X_1.rotation[:, 0]
            if not np.isfinite(self._p[i, :3]).all():
                self._p[i, :3] = self._placed.oMg[first].translation


def _capsule(chain: ClosedChain, capsule: Capsule) -> _Body:
    """Coal's capsules lie along z about their middle."""
    joint = 0 if capsule.joint is None else chain.model.getJointId(capsule.joint)
    start, end = np.array(capsule.start), np.array(capsule.end)
    along = end - start
    length = float(np.linalg.norm(along))
    middle = pin.SE3(np.eye(3), 0.5 * (start + end))
    if length:
        turn = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), along)
        middle.rotation = turn.toRotationMatrix()
    return _Body(joint, middle, coal.Capsule(capsule.radius, length))


def _box(chain: ClosedChain) -> _Body:
    frame = chain.model.frames[chain.frames[0]]
    return _Body(frame.parentJoint, frame.placement, coal.Box(*chain.held.size))
