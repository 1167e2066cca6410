"""Several arms that hold one object: the loops they close and the cooperative task space.

Letters: n joints (passive ones included), N arms, L = N - 1 loops, W the world, O the object.
Arm 0 is the reference; loop i says that arm i and arm 0 carry the object in one place.

With J_i the 6 x n Jacobian of the object frame as carried by arm i, (v; omega) in world axes,

    J_tsk = sum_i alpha_i J_i,  J_rel,i = J_i - J_0,  J_ext = [J_tsk; J_rel]    eq. (28)-(31)

and J_c v = 0 with J_c = J_rel is the loop closure, eq. (9), (14). alpha_i = 1/N is the paper's
eq. (30) for two arms; alpha = (1, 0) is leader and follower: the object is where arm 0 carries it,
after the extended cooperative task space of Park and Lee 2015.

Where no arm holds the object, the world does (``SUPPORT``): it is arm 0, no loop is closed, and the
relative rows of each arm are those of its hand to the object, which stands.

An arm that has let go is released: its loop is open, its six rows bind nothing and its weight is
zero, but it still has an object frame, where the object would be if it held it.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, TypeVar

import numpy as np
import pinocchio as pin

from coopqp.base.errors import GraspError, require_known
from coopqp.base.qp import Row, names_of
from coopqp.base.rank import independent_rows, matrix_rank
from coopqp.base.spec import Array, finite, vector
from coopqp.grasp import Grasp
from coopqp.model import grasp_configuration as grasping
from coopqp.model.grasp_configuration import SUPPORT, GraspConfiguration, HeldObject
from coopqp.robot import RobotModel, joint_units
from coopqp.signal import ENDLESS

AXES = ("x", "y", "z", "rot_x", "rot_y", "rot_z")
AXIS_UNITS = ("m", "m", "m", "rad", "rad", "rad")

Made = TypeVar("Made")

#: Most joints that a sentence names.
MOST_NAMED = 3

#: Reach of a joint without limits when configurations are sampled [rad or m].
UNLIMITED_SAMPLE = 1.0

#: A walk along the loops: steps, their size [rad or m], Newton steps back, and what is closed.
WALK, WALK_STEP, WALK_NEWTON, WALK_CLOSED = 6, 0.05, 20, 1e-10

#: Singular values below this share are noise there: the walk is closed to rounding only.
WALK_TOLERANCE = 1e-6


@dataclass(frozen=True)
class LoopRows:
    """Which of the 6 L loop rows are independent."""

    rows: tuple[Row, ...]  # all of them, such as "loop[left].rot_y"; those of open loops come last
    closed: int  # how many rows belong to closed loops
    kept: tuple[int, ...]  # indices of the rows handed to the solvers
    rank: int  # of the closed rows at generic configurations

    @property
    def names(self) -> tuple[str, ...]:
        return names_of(self.rows)

    @property
    def dropped(self) -> tuple[str, ...]:
        """Names of the rows that follow from the kept ones."""
        return tuple(self.names[i] for i in range(self.closed) if i not in self.kept)

    @property
    def kept_rows(self) -> tuple[Row, ...]:
        return tuple(self.rows[i] for i in self.kept)

    @property
    def solver_rows(self) -> tuple[Row, ...]:
        """The rows that the solvers see; numbered when the choice varies."""
        if self.varying:
            names = (f"loop.independent[{i}]" for i in range(self.rank))
            return tuple(Row(name=name, kind="loop", unit="m/s") for name in names)
        return self.kept_rows

    @property
    def varying(self) -> bool:
        """Whether the dependence between the kept rows changes with the configuration."""
        return self.rank < len(self.kept)


class ClosedChain:
    """A robot whose arms hold one object; :meth:`attach` makes the first one.

    Attributes:
        arms: those that hold the object, then the released ones; each in the robot's order.
        holding: how many hold the object; one where it stands, which is ``SUPPORT``.
        standing: whether no arm of the robot holds it.
        model: pinocchio model with the grasps' passive joints; massless object (its inertia matters
            to the dynamics alone, which add it).
        q_start: configuration with the passive joints in it, shape (n,).
        start_position: of the object at the start, shape (3,) [m].
        joint_units: of each joint's coordinate: "m" where it slides, else "rad".
        frames: the object frame as carried by each arm, ids into model.frames.
        loops: the independent loop rows.
        lower, upper: position limits, shape (n,) [rad, m]; infinite where there are none.
        velocity: velocity limits, shape (n,) [rad/s, m/s].
        passive: indices of the passive joints in q.
        alpha: weights of the arms in the absolute variables, shape (N,).
        mixing: M with [J_tsk; J_rel] = M [J_0; J_1; ...], eq. (30)-(31), shape (6 N, 6 N).
    """

    def __init__(self, hold: GraspConfiguration) -> None:
        self.hold = hold
        self.robot, self.grasps, self.held = hold.robot, hold.grasps, hold.held
        self.arms, self.alpha = hold.arms, hold.alpha
        self.holding, self.standing = max(1, len(hold.holders)), not hold.holders
        blocks = np.eye(len(self.alpha))
        blocks[0], blocks[1:, 0] = self.alpha, -1.0
        self.mixing = np.asarray(np.kron(blocks, np.eye(6)))
        self.model, self.frames = hold.model()
        self.n: int = self.model.nv
        self.joint_units = joint_units(self.model)
        robots_own = self.robot.joint_names
        self.passive = np.array(
            [i for i, name in enumerate(self.joint_names) if name not in robots_own], int
        )
        self.lower = np.array(self.model.lowerPositionLimit)
        self.upper = np.array(self.model.upperPositionLimit)
        self.velocity = np.array(self.model.velocityLimit)
        self._made: dict[Callable[[ClosedChain], Any], Any] = {}
        self._spare: list[pin.Data] = []  # memory that nobody uses now
        for kept in (
            self.alpha, self.mixing, self.lower, self.upper, self.velocity, self.passive
        ):  # fmt: skip
            kept.flags.writeable = False  # a chain never changes, whatever a plug-in writes to
        self._start()

    def _start(self) -> None:
        self.q_start, self.start_position = self.hold.q, self.hold.p_WO
        self.q_start.flags.writeable = self.start_position.flags.writeable = False
        self.loops = self._independent_rows()

    @classmethod
    def attach(
        cls,
        robot: RobotModel,
        q_start: Array,
        grasps: Grasp | Mapping[str, Grasp],
        held: HeldObject,
        *,
        alpha: Mapping[str, float] | None = None,
        passive_start: Mapping[str, float] | None = None,
        released: Collection[str] = (),
    ) -> ClosedChain:
        """Close the loops where the arms are.

        Args:
            robot: with at least two arms.
            q_start: its configuration when it takes hold, shape (robot.model.nq,) [rad, m].
            grasps: one for all arms, or one for each by the arm's name.
            held: the object.
            alpha: weights of the arms in the absolute variables, by name, at least 0 and with sum
                1; an arm not named has 0; all the same when omitted.
            passive_start: where the grasps' passive joints start, by name such as "right.hinge"
                [rad, m]; zero when omitted.
            released: names of the arms that do not hold the object.

        GraspError: fewer than two arms, grasps that do not close at the start, or no arm that holds
        and no pose of the object. UnknownNameError: a grasp, weight or passive joint that the robot
        does not have. InvalidValueError: q_start of a wrong shape; weights that are negative or do
        not sum to 1.
        """
        by_arm, arms = grasping.grasp_of_each(robot, grasps), robot.arms
        if len(arms) < 2:
            words = f"robot {robot.name} has {len(arms)} arm; a loop needs two"
            raise GraspError(words).at("robot")
        start = finite("q_start", vector("q_start", q_start, robot.model.nq))
        require_known("arm", released, [arm.name for arm in arms])
        data = robot.model.createData()
        pin.framesForwardKinematics(robot.model, data, start)
        turned = {a.name: data.oMf[robot.model.getFrameId(a.tip)].rotation.copy() for a in arms}
        passive = {name: by_arm[name].passive_joints(R_WT) for name, R_WT in turned.items()}
        hold = GraspConfiguration(
            robot=robot, grasps=by_arm, passive=passive, released=tuple(released), held=held,
            weights=grasping.arm_weights(robot, alpha),
            q=grasping.with_passive_start(robot, passive, start, passive_start or {}),
            p_WO=np.zeros(3), X_EO={},
        )  # fmt: skip
        return cls(grasping.at_start(hold))

    def moved(self, q: Array) -> ClosedChain:
        """The same chain, object and grasps, starting at q with the loops closed, shape (n,)."""
        start = vector("q", q, self.n)
        moved = self._with(q=start, p_WO=self.object_pose(start).translation.copy())
        vars(moved).pop("reach", None)  # which is measured at the start
        moved._start()
        return moved

    def carrying(self, held: HeldObject) -> ClosedChain:
        """The same chain with another object, held where that one is."""
        other = self._with(held=held)
        other.held = held
        return other

    def keeping_away(self, arms: tuple[str, ...]) -> ClosedChain:
        """The same chain with other arms ``GraspConfiguration.away`` from the object."""
        return self if arms == self.hold.away else self._with(away=arms)

    def _with(self, **changes: Any) -> ClosedChain:
        other = copy.copy(self)
        other._made, other._spare = self._made, self._spare
        other.hold = replace(self.hold, **changes)
        return other

    def __getstate__(self) -> dict[str, Any]:
        return {**vars(self), "_made": {}, "_spare": []}  # made again where it is asked for

    def once(self, make: Callable[[ClosedChain], Made]) -> Made:
        """What ``make`` makes, once for all chains that differ in start and object alone."""
        if make not in self._made:
            self._made[make] = make(self)
        made: Made = self._made[make]
        return made

    def handed_over(
        self, q: Array, released: Collection[str] = (), measured: pin.SE3 | None = None
    ) -> ClosedChain:
        """The same robot at q, shape (n,), with all arms but the released holding the object.

        An arm that holds on holds it as before. One that takes hold does so where its hand is, so
        that every loop closes. One that lets go keeps its object frame, fixed to its tip. Where the
        object stood it may have been ``measured`` elsewhere; where all let go it stays.
        UnknownNameError: no such arm.
        """
        q, keep = vector("q", q, self.n), (*self.hold.holders, *released)
        X_WO = measured if measured and not self.hold.holders else self.object_pose(q)
        with self._data() as data:
            carried = [
                (a.name, X.copy()) for a, X in zip(self.arms, self._carried(q, data), strict=True)
            ]
        X_by_arm = {arm: X if arm in keep else X_WO for arm, X in carried}
        return ClosedChain(self.hold.handed_over(q, released, X_by_arm | {SUPPORT.name: X_WO}))

    def object_pose(self, q: Array) -> pin.SE3:
        """Pose of the object in the world at q, the mean over the arms that hold it."""
        with self._data() as data:
            X_0, *others = self._carried(vector("q", q, self.n), data)[: self.holding]
            p, turn = X_0.translation.copy(), np.zeros(3)
            for weight, X in zip(self.alpha[1:], others, strict=False):
                p += weight * (X.translation - X_0.translation)
                turn += weight * pin.log3(X.rotation @ X_0.rotation.T)
            return pin.SE3(pin.exp3(turn) @ X_0.rotation, p)

    def hand_poses(self) -> list[pin.SE3]:
        """X_OC, the contact frame in the object, of each hand that holds it."""
        found = []
        with self._data() as data:
            pin.framesForwardKinematics(self.model, data, self.q_start)
            for arm, frame in zip(self.arms[: len(self.hold.holders)], self.frames, strict=False):
                X_OC = data.oMf[frame].actInv(data.oMf[self.model.getFrameId(arm.tip)])
                contact = self.grasps[arm.name].contact
                found.append(X_OC * contact.placement if contact else X_OC)
        return found

    def _carried(self, q: Array, data: pin.Data) -> list[pin.SE3]:
        """Where each arm carries the object; no other of a robot's hundreds of frames is placed."""
        pin.forwardKinematics(self.model, data, q)
        return [pin.updateFramePlacement(self.model, data, frame) for frame in self.frames]

    @contextmanager
    def _data(self) -> Iterator[pin.Data]:
        """Pinocchio's memory for one computation; used again, for its pages cost more than that."""
        try:
            data = self._spare.pop()
        except IndexError:  # asked for, not looked for: another thread may take it in between
            data = self.model.createData()
        try:
            yield data
        finally:
            self._spare.append(data)

    @cached_property
    def reach(self) -> float:
        """Bound on the distance from any joint to the object [m]; a sliding joint adds a metre."""
        longest = 0.0
        with self._data() as data:
            carried = self._carried(self.q_start, data)
            for X, (joints, slides) in zip(carried, self.once(_ways), strict=True):
                places = [*(data.oMi[j].translation for j in joints), X.translation]
                way = float(np.linalg.norm(np.diff(np.array(places), axis=0), axis=1).sum())
                longest = max(longest, way + 1.0 if slides else way)
        return longest

    @property
    def starts_inside(self) -> bool:
        """Whether every joint starts within its position limits."""
        return bool(((self.lower <= self.q_start) & (self.q_start <= self.upper)).all())

    @cached_property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the n joints in the order of q."""
        return tuple(self.model.names[1:])

    def unusable(self, q: Array) -> str:
        """Which of the n numbers are not finite, or as good as infinite; empty if all are fine."""
        if math.hypot(*q.tolist()) < ENDLESS:  # NaN is not
            return ""
        good = np.abs(q) < ENDLESS / len(q)
        bad = np.array(self.joint_names)[~good]
        more = f" and {len(bad) - MOST_NAMED} more joints" if len(bad) > MOST_NAMED else ""
        return f"no finite number for {', '.join(bad[:MOST_NAMED].tolist())}{more}"

    def object_jacobians(self, q: Array) -> Array:
        """Jacobian of the object as carried by each arm, shape (N, 6, n), world axes.

        Where q does not close the loops the object counts as grasped anew, midway between where
        the arms carry it, so that all Jacobians belong to one point.
        """
        model, jacobians = self.model, []
        with self._data() as data:
            pin.computeJointJacobians(model, data, q)
            placed = (pin.updateFramePlacement(model, data, frame) for frame in self.frames)
            places = [X.translation.copy() for X in placed]
            middle = np.mean(places[: self.holding], axis=0)
            for frame, place in zip(self.frames, places, strict=True):
                J = pin.getFrameJacobian(model, data, frame, pin.LOCAL_WORLD_ALIGNED).copy()
                J[:3] -= pin.skew(middle - place) @ J[3:]
                jacobians.append(J)
        return np.array(jacobians)

    def loop_jacobian(self, q: Array) -> Array:
        """J_c of eq. (14) with all rows of the closed loops, shape (6 L, n), world axes."""
        J = self.object_jacobians(q)[: self.holding]
        rows: Array = (J[1:] - J[0]).reshape(-1, self.n)
        return rows

    def sample(self, rng: np.random.Generator, count: int) -> Array:
        """Random configurations inside the limits, loops not closed, shape (count, n)."""
        lower = np.where(np.isfinite(self.lower), self.lower, self.q_start - UNLIMITED_SAMPLE)
        upper = np.where(np.isfinite(self.upper), self.upper, self.q_start + UNLIMITED_SAMPLE)
        return rng.uniform(lower, upper, (count, self.n))

    def _independent_rows(self) -> LoopRows:
        found = self.once(_generic_rows)
        if not found.closed or matrix_rank(self.loop_jacobian(self.q_start)) >= found.rank:
            return found
        # On a walk with closed loops the rank is lower in paradoxical linkages (Bennett's).
        walked = map(self.loop_jacobian, self.closed_walk(WALK))
        ranks = (matrix_rank(J, WALK_TOLERANCE) for J in walked)
        return replace(found, rank=max(ranks, default=found.rank))

    def closed_walk(self, steps: int) -> Iterator[Array]:
        """At most so many closed configurations, on a random walk from the start."""
        rng, q = np.random.default_rng(0), self.q_start
        for _ in range(steps):
            rows = np.linalg.svd(self.loop_jacobian(q))
            free = rows[2][np.sum(rows[1] > WALK_TOLERANCE * rows[1][0]) :]
            near = self._closed_near(q + WALK_STEP * free.T @ rng.normal(size=len(free)))
            if near is None:
                return
            q = near
            yield q

    def _closed_near(self, q: Array) -> Array | None:
        """The configuration with the loops closed that Newton's method finds; None if none."""
        for _ in range(WALK_NEWTON):
            error = self.loop_error(q)
            if np.linalg.norm(error) < WALK_CLOSED:
                return q
            q = q - np.linalg.lstsq(self.loop_jacobian(q), error, rcond=WALK_TOLERANCE)[0]
        return None

    def loop_error(self, q: Array) -> Array:
        """What ``State.loop_error`` is at q, of the closed loops alone, shape (6 L,)."""
        with self._data() as data:
            X_0, *others = self._carried(q, data)[: self.holding]
            return np.concatenate(
                [[*(X.translation - X_0.translation), *pin.log3(X.rotation @ X_0.rotation.T)]
                 for X in others]
            )  # fmt: skip

    def loop_error_sizes(self, q: Array) -> tuple[float, float]:
        """Largest position and rotation by which closed loops are open at q [m], [rad]."""
        if self.holding < 2:
            return 0.0, 0.0
        sizes = np.linalg.norm(self.loop_error(q).reshape(-1, 2, 3), axis=2)
        position, orientation = sizes.max(axis=0).tolist()
        return position, orientation


def _ways(chain: ClosedChain) -> list[tuple[list[int], bool]]:
    """The joints on the way to each arm's frame, and whether one of them slides."""
    model, found = chain.model, []
    for frame in chain.frames:
        joints = [j for j in model.supports[model.frames[frame].parentJoint] if j > 0]
        found.append((joints, any("P" in model.joints[j].shortname()[10:] for j in joints)))
    return found


def _generic_rows(chain: ClosedChain) -> LoopRows:
    """Find loop rows that follow from others, at seeded random configurations."""
    rows = tuple(
        Row(name=f"loop[{arm.name}].{axis}", kind="loop", owner=arm.name, unit=f"{unit}/s")
        for arm in chain.arms[1:]
        for axis, unit in zip(AXES, AXIS_UNITS, strict=True)
    )
    closed = 6 * (chain.holding - 1)
    if not closed:
        return LoopRows(rows=rows, closed=0, kept=(), rank=0)
    configurations = chain.sample(np.random.default_rng(0), 8)
    jacobians = [chain.loop_jacobian(q) for q in configurations]
    # A row that is a fixed combination of others is so in all configurations side by side.
    kept = independent_rows(np.hstack(jacobians))
    rank = max(matrix_rank(J) for J in jacobians)
    return LoopRows(rows=rows, closed=closed, kept=tuple(kept), rank=rank)
