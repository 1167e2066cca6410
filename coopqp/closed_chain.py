"""Several arms that hold one object: the loops they close and the cooperative task space.

Letters: n joints (passive ones included), N arms, L = N - 1 loops, W the world, O the object.
Arm 0 is the reference; loop i says that arm i and arm 0 carry the object in one place.

With J_i the 6 x n Jacobian of the object frame as carried by arm i, (v; omega) in world axes,

    J_tsk = sum_i alpha_i J_i,  J_rel,i = J_i - J_0,  J_ext = [J_tsk; J_rel]    eq. (28)-(31)

and J_c v = 0 with J_c = J_rel is the loop closure, eq. (9), (14). alpha_i = 1/N is the paper's
eq. (30) for two arms; alpha = (1, 0) is leader and follower: the object is where arm 0 carries it,
after the extended cooperative task space of Park and Lee 2015.

An arm that has let go is released: its loop is open, its six rows bind nothing and its weight is
zero, but it still has an object frame, where the object would be if it held it.
"""

from __future__ import annotations

import copy
import itertools
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pinocchio as pin

from coopqp.checked import Array, finite, vector
from coopqp.errors import GraspError, InvalidValueError, UnknownNameError
from coopqp.grasp import Grasp, PassiveJoint, pose_matrix
from coopqp.held_object import HeldObject
from coopqp.rank import independent_rows, matrix_rank
from coopqp.robot import Arm, RobotModel, copy_per_velocity

AXES = ("x", "y", "z", "rot_x", "rot_y", "rot_z")

#: Largest gap of given grasps at the start that still counts as closed.
CLOSED_POSITION, CLOSED_ORIENTATION = 1e-4, 1e-3  # [m], [rad]

#: The weights alpha must sum to 1 within this.
WEIGHT_SUM = 1e-6

#: Reach of a joint without limits when configurations are sampled [rad or m].
UNLIMITED_SAMPLE = 1.0


@dataclass(frozen=True)
class LoopRows:
    """Which of the 6 L loop rows are independent.

    Attributes:
        names: of all rows, such as "loop[left].rot_y"; those of open loops come last.
        closed: how many rows belong to closed loops.
        kept: indices of the rows handed to the solvers.
        rank: rank of the closed rows at generic configurations.
    """

    names: tuple[str, ...]
    closed: int
    kept: tuple[int, ...]
    rank: int

    @property
    def dropped(self) -> tuple[str, ...]:
        """Names of the rows that follow from the kept ones."""
        return tuple(self.names[i] for i in range(self.closed) if i not in self.kept)

    @property
    def kept_names(self) -> tuple[str, ...]:
        """Names of the kept rows."""
        return tuple(self.names[i] for i in self.kept)

    @property
    def solver_names(self) -> tuple[str, ...]:
        """Names of the rows that the solvers see; numbered when the choice varies."""
        if self.varying:
            return tuple(f"loop.independent[{i}]" for i in range(self.rank))
        return self.kept_names

    @property
    def varying(self) -> bool:
        """Whether the dependence between the kept rows changes with the configuration."""
        return self.rank < len(self.kept)


class ClosedChain:
    """A robot whose arms hold one object.

    Args:
        robot: the robot.
        q_start: its configuration when it takes hold, shape (robot.model.nq,) [rad, m].
        grasps: one for all arms, or one for each by the arm's name.
        held: the object.
        alpha: weights of the arms in the absolute variables, by name, at least 0 and with sum 1;
            an arm not named has 0; all the same when omitted.
        passive_start: where the grasps' passive joints start, by name such as "right.hinge"
            [rad, m]; zero when omitted.
        released: names of the arms that do not hold the object.

    Attributes:
        arms: those that hold the object, then the released ones; each in the robot's order.
        holding: how many hold the object.
        model: pinocchio model with the grasps' passive joints; massless object (its inertia
            matters to the dynamics alone, which add it).
        q_start: configuration with the passive joints in it, shape (n,).
        start_position: of the object at the start, shape (3,) [m].
        frames: the object frame as carried by each arm, ids into model.frames.
        loops: the independent loop rows.
        lower, upper: position limits, shape (n,) [rad, m]; infinite where there are none.
        velocity: velocity limits, shape (n,) [rad/s, m/s].
        passive: indices of the passive joints in q.
        alpha: weights of the arms in the absolute variables, shape (N,).
        mixing: M with [J_tsk; J_rel] = M [J_0; J_1; ...], shape (6 N, 6 N).

    Raises:
        GraspError: fewer than two arms, none that holds, or grasps that do not close at the start.
        UnknownNameError: a grasp, weight or passive joint that the robot does not have.
        InvalidValueError: q_start of a wrong shape; weights that are negative or do not sum to 1.
    """

    def __init__(
        self,
        robot: RobotModel,
        q_start: Array,
        grasps: Grasp | Mapping[str, Grasp],
        held: HeldObject,
        *,
        alpha: Mapping[str, float] | None = None,
        passive_start: Mapping[str, float] | None = None,
        released: Collection[str] = (),
    ) -> None:
        self.robot, self.held = robot, held
        self.grasps = grasp_of_each(robot, grasps)
        if len(robot.arms) < 2:
            raise GraspError(f"robot {robot.name} has {len(robot.arms)} arm; a loop needs two")
        start = finite("q_start", vector("q_start", q_start, robot.model.nq))
        self._robot_start = start
        self._without_object, self._ends = with_passive_joints(
            robot,
            {
                arm.name: self.grasps[arm.name].passive_joints(self._tip_orientation(arm))
                for arm in robot.arms
            },
        )
        self.model = self._without_object
        self.n: int = self.model.nv
        self.q_start = self._extended(start, passive_start or {})
        self._weights = arm_weights(robot, alpha)
        self._let_go(released)
        self._fix_object(self._object_at_start())
        self.passive = np.array(
            [i for i, name in enumerate(self.joint_names) if name not in robot.joint_names], int
        )
        self.lower = np.array(self.model.lowerPositionLimit)
        self.upper = np.array(self.model.upperPositionLimit)
        self.velocity = np.array(self.model.velocityLimit)
        self.loops = self._independent_rows()

    def moved(self, q: Array) -> ClosedChain:
        """The same chain with another start, the object held as it is.

        Args:
            q: configuration with the loops closed, passive joints included, shape (n,).
        """
        other = copy.copy(self)
        other.q_start = vector("q", q, self.n)
        other.start_position = self.object_pose(other.q_start).translation.copy()
        return other

    def handed_over(self, q: Array, released: Collection[str] = ()) -> ClosedChain:
        """The same robot with other arms holding the object, where everything is now.

        An arm that holds on holds it as before. One that takes hold does so where its hand is, so
        that every loop closes. One that lets go keeps its object frame, fixed to its tip.

        Args:
            q: configuration with this chain's loops closed, passive joints included, shape (n,).
            released: names of the arms that do not hold the object from now on.

        Raises:
            UnknownNameError: an arm that the robot does not have.
            GraspError: no arm is left that holds the object.
        """
        other = copy.copy(self)
        other.__dict__.pop("reach", None)  # it depends on where the hands take hold
        other.q_start = vector("q", q, self.n)
        X_WO, data = self.object_pose(q), self.model.createData()
        pin.framesForwardKinematics(self.model, data, other.q_start)
        carried = {a.name: data.oMf[f] for a, f in zip(self.arms, self.frames, strict=True)}
        held = {arm.name for arm in self.arms[: self.holding]}
        other._let_go(released)
        other._fix_object(
            {
                arm.name: carried[arm.name] if arm.name in held or open_ else X_WO
                for arm, open_ in zip(other.arms, other._is_open, strict=True)
            }
        )
        other.start_position = X_WO.translation.copy()
        other.loops = other._independent_rows()
        return other

    def object_pose(self, q: Array) -> pin.SE3:
        """Pose of the object in the world, the mean over the arms that hold it.

        Args:
            q: configuration, shape (n,).
        """
        data = self.model.createData()
        pin.framesForwardKinematics(self.model, data, vector("q", q, self.n))
        X_0, *others = (data.oMf[frame] for frame in self.frames[: self.holding])
        p, turn = X_0.translation.copy(), np.zeros(3)
        for weight, X in zip(self.alpha[1:], others, strict=False):
            p += weight * (X.translation - X_0.translation)
            turn += weight * pin.log3(X.rotation @ X_0.rotation.T)
        return pin.SE3(pin.exp3(turn) @ X_0.rotation, p)

    @cached_property
    def reach(self) -> float:
        """Bound on the distance from any joint to the object along its arm [m].

        Sliding joints count with a metre, so that their share of a second derivative is bounded
        by it too.
        """
        model, data = self.model, self.model.createData()
        pin.framesForwardKinematics(model, data, self.q_start)
        longest = 0.0
        for frame in self.frames:
            joints = [j for j in model.supports[model.frames[frame].parentJoint] if j > 0]
            places = [data.oMi[j].translation for j in joints] + [data.oMf[frame].translation]
            way = sum(float(np.linalg.norm(b - a)) for a, b in itertools.pairwise(places))
            slides = any("P" in model.joints[j].shortname()[10:] for j in joints)
            longest = max(longest, way + 1.0 if slides else way)
        return longest

    @property
    def starts_inside(self) -> bool:
        """Whether every joint starts within its position limits."""
        return bool(((self.lower <= self.q_start) & (self.q_start <= self.upper)).all())

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the n joints in the order of q."""
        return tuple(self.model.names[1:])

    @property
    def joint_units(self) -> tuple[str, ...]:
        """Unit of each joint's coordinate: "m" where it slides, else "rad"."""
        kinds = (joint.shortname() for joint in itertools.islice(self.model.joints, 1, None))
        return tuple("m" if kind.startswith("JointModelP") else "rad" for kind in kinds)

    def object_jacobians(self, q: Array) -> Array:
        """Jacobian of the object as carried by each arm, shape (N, 6, n), world axes.

        Where q does not close the loops the object counts as grasped anew, midway between where
        the arms carry it, so that all Jacobians belong to one point.
        """
        model, data = self.model, self.model.createData()
        pin.computeJointJacobians(model, data, q)
        pin.updateFramePlacements(model, data)
        places = [data.oMf[frame].translation.copy() for frame in self.frames]
        middle = np.mean(places[: self.holding], axis=0)
        jacobians = []
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

    def _tip_orientation(self, arm: Arm) -> Array:
        model = self.robot.model
        data = model.createData()
        pin.framesForwardKinematics(model, data, self._robot_start)
        R: Array = data.oMf[model.getFrameId(arm.tip)].rotation.copy()
        return R

    def _extended(self, q: Array, passive_start: Mapping[str, float]) -> Array:
        """Configuration of the model with its passive joints."""
        passive = [name for name in self.joint_names if name not in self.robot.joint_names]
        for name in passive_start:
            if name not in passive:
                raise UnknownNameError("passive joint", name, passive)
        extended = np.zeros(self.model.nq)
        values = {**dict(zip(self.robot.joint_names, q, strict=True)), **passive_start}
        for name, value in values.items():
            extended[self.model.idx_qs[self.model.getJointId(name)]] = value
        return extended

    def _let_go(self, released: Collection[str]) -> None:
        """Sort the arms, and share the weights among those that hold the object."""
        names = [arm.name for arm in self.robot.arms]
        for name in released:
            if name not in names:
                raise UnknownNameError("arm", name, names)
        self.holding = len(names) - len(set(released))
        if not self.holding:
            raise GraspError("no arm is left that holds the object; keep at least one")
        order = sorted(range(len(names)), key=lambda i: names[i] in released)
        self.arms: tuple[Arm, ...] = tuple(self.robot.arms[i] for i in order)
        self._is_open = [arm.name in released for arm in self.arms]
        self.alpha = np.where(self._is_open, 0.0, self._weights[order])
        if not self.alpha.any():  # the leader has let go
            self.alpha[: self.holding] = 1.0
        self.alpha /= self.alpha.sum()
        self.mixing = _mixing_matrix(self.alpha)

    def _object_at_start(self) -> dict[str, pin.SE3]:
        """Where each arm carries the object at the start, as the grasp or the start says, eq. (1).

        A released arm's grasp tells where the object would be in its hand.
        """
        data = self.model.createData()
        pin.framesForwardKinematics(self.model, data, self.q_start)
        given = {}
        for arm, grasp in self.grasps.items():
            if grasp.object_in_hand:
                end = self.model.getFrameId(self._ends[arm])
                given[arm] = data.oMf[end] * object_at_end(self.model, end, self._tip(arm), grasp)
        holders = [arm.name for arm in self.arms[: self.holding]]
        X_WO = self._start_pose({arm: given[arm] for arm in holders if arm in given})
        self.start_position = X_WO.translation.copy()
        return {arm: given.get(arm, X_WO) for arm in self.grasps}

    def _fix_object(self, X_WO: Mapping[str, pin.SE3]) -> None:
        """Fix the object's frame to every arm; to a released one before its passive joints.

        Args:
            X_WO: where each arm carries the object at q_start, by arm.
        """
        self.model = self._without_object.copy()
        data = self.model.createData()
        pin.framesForwardKinematics(self.model, data, self.q_start)
        frames = []
        for arm, is_open in zip(self.arms, self._is_open, strict=True):
            end = arm.tip if is_open else self._ends[arm.name]
            X_WE = data.oMf[self.model.getFrameId(end)]
            frames.append(add_object_frame(self.model, arm.name, end, X_WE.actInv(X_WO[arm.name])))
        self.frames = tuple(frames)

    def _tip(self, arm: str) -> int:
        (tip,) = (a.tip for a in self.robot.arms if a.name == arm)
        return int(self.model.getFrameId(tip))

    def _start_pose(self, by_arm: Mapping[str, pin.SE3]) -> pin.SE3:
        """Pose of the object at the start, after checking that all that is given agrees.

        Args:
            by_arm: where the holding arms whose grasp says so carry the object.

        Raises:
            GraspError: the object's pose and the grasps put it in different places.
        """
        seen = {f"the grasp of arm '{arm}'": X_WO for arm, X_WO in by_arm.items()}
        if self.held.pose:
            seen["object.pose"] = pose_matrix(self.held.pose)
        if not seen:
            data = self.model.createData()
            pin.framesForwardKinematics(self.model, data, self.q_start)
            holders = self.arms[: self.holding]
            tips = [data.oMf[self._tip(arm.name)].translation for arm in holders]
            return pin.SE3(np.eye(3), np.mean(tips, axis=0))
        (first, X_WO), *others = seen.items()
        for name, X in others:
            gap = np.linalg.norm(X.translation - X_WO.translation)
            angle = np.linalg.norm(pin.log3(X_WO.rotation.T @ X.rotation))
            if gap > CLOSED_POSITION or angle > CLOSED_ORIENTATION:
                raise GraspError(
                    f"the grasp does not close at the start: {name} puts the object "
                    f"{1e3 * gap:.1f} mm and {np.degrees(angle):.1f} degrees from where {first} "
                    "puts it; change the start or leave object_in_hand out"
                )
        return X_WO

    def _independent_rows(self) -> LoopRows:
        """Find loop rows that follow from others, at seeded random configurations."""
        names = tuple(f"loop[{arm.name}].{axis}" for arm in self.arms[1:] for axis in AXES)
        closed = 6 * (self.holding - 1)
        if not closed:
            return LoopRows(names=names, closed=0, kept=(), rank=0)
        configurations = self.sample(np.random.default_rng(0), 8)
        jacobians = [self.loop_jacobian(q) for q in configurations]
        # A row that is a fixed combination of others is so in all configurations side by side.
        kept = independent_rows(np.hstack(jacobians))
        rank = max(matrix_rank(J) for J in jacobians)
        return LoopRows(names=names, closed=closed, kept=tuple(kept), rank=rank)


def with_passive_joints(
    robot: RobotModel, joints: Mapping[str, Sequence[PassiveJoint]]
) -> tuple[pin.Model, dict[str, str]]:
    """The robot's model with its grasps' joints after the tips.

    Args:
        robot: the robot.
        joints: by arm, hand first.

    Returns:
        The model, and by arm the frame that carries the object: "ARM.grasp", or the tip.
    """
    model, ends, one = robot.model.copy(), {}, np.ones(1)
    for arm in robot.arms:
        ends[arm.name] = arm.tip
        if not joints[arm.name]:
            continue
        tail, parent = pin.Model(), 0
        for passive in joints[arm.name]:
            parent = tail.addJoint(
                parent, passive.joint, passive.placement, f"{arm.name}.{passive.name}",
                0.0 * one, np.inf * one, passive.lower * one, passive.upper * one,
            )  # fmt: skip
        ends[arm.name] = f"{arm.name}.grasp"
        tail.addFrame(pin.Frame(ends[arm.name], parent, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
        # appendModel keeps the joints depth first, as pinocchio's algorithms need.
        model = pin.appendModel(model, tail, model.getFrameId(arm.tip), pin.SE3.Identity())
    copy_per_velocity(robot.model, model)  # appendModel forgets the armatures
    return model, ends


def object_at_end(model: pin.Model, end: int, tip: int, grasp: Grasp) -> pin.SE3:
    """Pose of the object in the frame after the passive joints, from object_in_hand.

    What object_in_hand says holds where the passive joints are at zero.

    Args:
        model: with the passive joints.
        end: frame after them.
        tip: frame before them.
        grasp: one with object_in_hand.
    """
    assert grasp.object_in_hand is not None
    data = model.createData()
    pin.framesForwardKinematics(model, data, np.array(pin.neutral(model)))
    return data.oMf[end].actInv(data.oMf[tip]) * pose_matrix(grasp.object_in_hand)


def add_object_frame(model: pin.Model, arm: str, end: str, X_EO: pin.SE3) -> int:
    """Fix the frame of the object as carried by an arm; returns its id."""
    frame = model.frames[model.getFrameId(end)]
    return int(
        model.addFrame(
            pin.Frame(
                f"object[{arm}]", frame.parentJoint, frame.placement * X_EO, pin.FrameType.OP_FRAME
            )
        )
    )


def arm_weights(robot: RobotModel, alpha: Mapping[str, float] | None) -> Array:
    """Weights of the arms in the absolute variables, in the order of the arms, shape (N,).

    Args:
        robot: the robot.
        alpha: by arm; an arm not named has 0; all the same when omitted.

    Raises:
        UnknownNameError: no such arm.
        InvalidValueError: a weight is negative or not finite, or they do not sum to 1.
    """
    names = [arm.name for arm in robot.arms]
    if alpha is None:
        return np.full(len(names), 1.0 / len(names))
    for name, weight in alpha.items():
        if name not in names:
            raise UnknownNameError("arm", name, names)
        if not 0.0 <= weight < np.inf:
            raise InvalidValueError(f"weight of arm {name}: found {weight:g}, needs at least 0")
    total = sum(alpha.values())
    if abs(total - 1.0) > WEIGHT_SUM:
        raise InvalidValueError(f"the weights of the arms sum to {total:g}, need 1")
    return np.array([alpha.get(name, 0.0) / total for name in names])


def grasp_of_each(robot: RobotModel, grasps: Grasp | Mapping[str, Grasp]) -> dict[str, Grasp]:
    """The grasp of each arm, in the order of the arms.

    Args:
        robot: the robot.
        grasps: one for all arms, or one for each by the arm's name.

    Raises:
        UnknownNameError: a grasp for an arm that the robot does not have.
        GraspError: an arm without a grasp.
    """
    names = [arm.name for arm in robot.arms]
    if isinstance(grasps, Grasp):
        return dict.fromkeys(names, grasps)
    for name in grasps:
        if name not in names:
            raise UnknownNameError("arm", name, names, "grasp: ")
    missing = [name for name in names if name not in grasps]
    if missing:
        raise GraspError(f"grasp: no grasp for arm {', '.join(missing)}")
    return {name: grasps[name] for name in names}


def _mixing_matrix(alpha: Array) -> Array:
    """M with [J_tsk; J_rel] = M [J_0; J_1; ...], eq. (30)-(31), shape (6 N, 6 N)."""
    arms = len(alpha)
    blocks = np.zeros((arms, arms))
    blocks[0] = alpha
    for i in range(1, arms):
        blocks[i, 0], blocks[i, i] = -1.0, 1.0
    return np.kron(blocks, np.eye(6)).astype(float)
