"""Several arms that hold one object: the loops they close and the cooperative task space.

Letters: n joints (passive ones included), N arms, L = N - 1 loops, W the world, O the object.
Arm 0 is the reference; loop i says that arm i and arm 0 carry the object in one place.

With J_i the 6 x n Jacobian of the object frame as carried by arm i, (v; omega) in world axes,

    J_tsk = sum_i alpha_i J_i,  J_rel,i = J_i - J_0,  J_ext = [J_tsk; J_rel]    eq. (28)-(31)

and J_c v = 0 with J_c = J_rel is the loop closure, eq. (9), (14). alpha_i = 1/N is the paper's
eq. (30) for two arms; alpha = (1, 0) is leader and follower: the object is where arm 0 carries it,
after the extended cooperative task space of Park and Lee 2015.
"""

from __future__ import annotations

import copy
import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pinocchio as pin
import scipy.linalg
from numpy.typing import NDArray

from coopqp.errors import GraspError, InvalidValueError, UnknownNameError
from coopqp.grasp import Grasp, PassiveJoint, pose_matrix
from coopqp.held_object import HeldObject
from coopqp.robot import Arm, RobotModel
from coopqp.robot_file import copy_per_velocity

AXES = ("x", "y", "z", "rot_x", "rot_y", "rot_z")

#: Largest gap of given grasps at the start that still counts as closed.
CLOSED_POSITION, CLOSED_ORIENTATION = 1e-4, 1e-3  # [m], [rad]

#: Singular values below this share of the largest count as zero when ranks are taken.
RANK_TOLERANCE = 1e-8

#: The weights alpha must sum to 1 within this.
WEIGHT_SUM = 1e-6

#: Reach of a joint without limits when configurations are sampled [rad or m].
UNLIMITED_SAMPLE = 1.0


@dataclass(frozen=True)
class LoopRows:
    """Which of the 6 L loop rows are independent.

    Attributes:
        names: of all rows, such as "loop[left].rot_y".
        kept: indices of the rows handed to the solvers.
        rank: rank of J_c at generic configurations.
    """

    names: tuple[str, ...]
    kept: tuple[int, ...]
    rank: int

    @property
    def dropped(self) -> tuple[str, ...]:
        """Names of the rows that follow from the kept ones."""
        return tuple(name for i, name in enumerate(self.names) if i not in self.kept)

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

    Attributes:
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
        GraspError: fewer than two arms, or grasps that do not close at the start.
        UnknownNameError: a grasp, weight or passive joint that the robot does not have.
        InvalidValueError: q_start of a wrong shape; weights that are negative or do not sum to 1.
    """

    def __init__(
        self,
        robot: RobotModel,
        q_start: NDArray[np.float64],
        grasps: Grasp | Mapping[str, Grasp],
        held: HeldObject,
        *,
        alpha: Mapping[str, float] | None = None,
        passive_start: Mapping[str, float] | None = None,
    ) -> None:
        self.robot, self.held = robot, held
        self.arms: tuple[Arm, ...] = robot.arms
        self.grasps = grasp_of_each(robot, grasps)
        if len(self.arms) < 2:
            raise GraspError(f"robot {robot.name} has {len(self.arms)} arm; a loop needs two")
        start = np.asarray(q_start, float)
        if start.shape != (robot.model.nq,):
            raise InvalidValueError(
                f"q_start: found shape {start.shape}, needs ({robot.model.nq},)"
            )
        self._robot_start = start
        self.model, ends = with_passive_joints(
            robot,
            {
                arm.name: self.grasps[arm.name].passive_joints(self._tip_orientation(arm))
                for arm in self.arms
            },
        )
        self.n: int = self.model.nv
        self.q_start = self._extended(start, passive_start or {})
        self.frames = self._add_object_frames(ends)
        self.passive = np.array(
            [i for i, name in enumerate(self.joint_names) if name not in robot.joint_names], int
        )
        self.lower = np.array(self.model.lowerPositionLimit)
        self.upper = np.array(self.model.upperPositionLimit)
        self.velocity = np.array(self.model.velocityLimit)
        self.alpha = arm_weights(robot, alpha)
        self.mixing = _mixing_matrix(self.alpha)
        self.loops = self._independent_rows()

    def moved(self, q: NDArray[np.float64]) -> ClosedChain:
        """The same chain with another start, the object held as it is.

        Args:
            q: configuration with the loops closed, passive joints included, shape (n,).
        """
        other = copy.copy(self)
        other.q_start = np.array(q, float)
        data = self.model.createData()
        pin.framesForwardKinematics(self.model, data, other.q_start)
        other.start_position = data.oMf[self.frames[0]].translation.copy()
        return other

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

    def object_jacobians(self, q: NDArray[np.float64]) -> NDArray[np.float64]:
        """Jacobian of the object as carried by each arm, shape (N, 6, n), world axes.

        Where q does not close the loops the object counts as grasped anew, midway between where
        the arms carry it, so that all Jacobians belong to one point.
        """
        model, data = self.model, self.model.createData()
        pin.computeJointJacobians(model, data, q)
        pin.updateFramePlacements(model, data)
        places = [data.oMf[frame].translation.copy() for frame in self.frames]
        middle = np.mean(places, axis=0)
        jacobians = []
        for frame, place in zip(self.frames, places, strict=True):
            J = pin.getFrameJacobian(model, data, frame, pin.LOCAL_WORLD_ALIGNED).copy()
            J[:3] -= pin.skew(middle - place) @ J[3:]
            jacobians.append(J)
        return np.array(jacobians)

    def loop_jacobian(self, q: NDArray[np.float64]) -> NDArray[np.float64]:
        """J_c of eq. (14) with all its rows, shape (6 L, n), world axes."""
        J = self.object_jacobians(q)
        return np.vstack([J_i - J[0] for J_i in J[1:]])

    def sample(self, rng: np.random.Generator, count: int) -> NDArray[np.float64]:
        """Random configurations inside the limits, loops not closed, shape (count, n)."""
        lower = np.where(np.isfinite(self.lower), self.lower, self.q_start - UNLIMITED_SAMPLE)
        upper = np.where(np.isfinite(self.upper), self.upper, self.q_start + UNLIMITED_SAMPLE)
        return rng.uniform(lower, upper, (count, self.n))

    def _tip_orientation(self, arm: Arm) -> NDArray[np.float64]:
        model = self.robot.model
        data = model.createData()
        pin.framesForwardKinematics(model, data, self._robot_start)
        R: NDArray[np.float64] = data.oMf[model.getFrameId(arm.tip)].rotation.copy()
        return R

    def _extended(
        self, q: NDArray[np.float64], passive_start: Mapping[str, float]
    ) -> NDArray[np.float64]:
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

    def _add_object_frames(self, ends: Mapping[str, str]) -> tuple[int, ...]:
        """Fix the object frame to every arm, where the grasp or the start says, eq. (1)."""
        given = {
            arm: object_at_end(self.model, self.model.getFrameId(end), self._tip(arm), grasp)
            for (arm, grasp), end in zip(self.grasps.items(), ends.values(), strict=True)
            if grasp.object_in_hand
        }
        data = self.model.createData()
        pin.framesForwardKinematics(self.model, data, self.q_start)
        X_WE = {arm: data.oMf[self.model.getFrameId(end)].copy() for arm, end in ends.items()}
        X_WO = self._start_pose({arm: X_WE[arm] * X_EO for arm, X_EO in given.items()})
        self.start_position = X_WO.translation.copy()
        return tuple(
            add_object_frame(self.model, arm, end, given.get(arm, X_WE[arm].actInv(X_WO)))
            for arm, end in ends.items()
        )

    def _tip(self, arm: str) -> int:
        (tip,) = (a.tip for a in self.arms if a.name == arm)
        return int(self.model.getFrameId(tip))

    def _start_pose(self, by_arm: Mapping[str, pin.SE3]) -> pin.SE3:
        """Pose of the object at the start, after checking that all that is given agrees.

        Args:
            by_arm: where the arms whose grasp says so carry the object.

        Raises:
            GraspError: the object's pose and the grasps put it in different places.
        """
        seen = {f"the grasp of arm '{arm}'": X_WO for arm, X_WO in by_arm.items()}
        if self.held.pose:
            seen["object.pose"] = pose_matrix(self.held.pose)
        if not seen:
            data = self.model.createData()
            pin.framesForwardKinematics(self.model, data, self.q_start)
            tips = [data.oMf[self._tip(arm.name)].translation for arm in self.arms]
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
        configurations = self.sample(np.random.default_rng(0), 8)
        jacobians = [self.loop_jacobian(q) for q in configurations]
        # A row that is a fixed combination of others is so in all configurations side by side.
        kept = independent_rows(np.hstack(jacobians))
        rank = max(matrix_rank(J) for J in jacobians)
        return LoopRows(names=names, kept=tuple(kept), rank=rank)


def independent_rows(matrix: NDArray[np.float64], most: int | None = None) -> list[int]:
    """Indices of a largest set of independent rows, in their own order, by pivoted QR.

    Args:
        matrix: shape (m, n).
        most: not more rows than this; the best pivots are kept.
    """
    if not matrix.size:
        return []
    _, R, order = scipy.linalg.qr(matrix.T, mode="economic", pivoting=True)
    diagonal = np.abs(np.diag(R))
    rank = int(np.sum(diagonal > RANK_TOLERANCE * max(diagonal[0], 1e-300)))
    return sorted(int(i) for i in order[: rank if most is None else min(rank, most)])


def matrix_rank(matrix: NDArray[np.float64]) -> int:
    """Rank with the tolerance used everywhere in coopqp."""
    return int(np.linalg.matrix_rank(matrix, rtol=RANK_TOLERANCE))


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


def arm_weights(robot: RobotModel, alpha: Mapping[str, float] | None) -> NDArray[np.float64]:
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


def _mixing_matrix(alpha: NDArray[np.float64]) -> NDArray[np.float64]:
    """M with [J_tsk; J_rel] = M [J_0; J_1; ...], eq. (30)-(31), shape (6 N, 6 N)."""
    arms = len(alpha)
    blocks = np.zeros((arms, arms))
    blocks[0] = alpha
    for i in range(1, arms):
        blocks[i, 0], blocks[i, i] = -1.0, 1.0
    return np.kron(blocks, np.eye(6)).astype(float)
