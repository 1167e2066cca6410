"""Who holds what: the object, the arms, their grasps, and where the object is in each hand.

Letters: n joints (passive ones included), W the world, O the object, E the frame of an arm that
carries the object: its tip, or what comes after its grasp's passive joints.

Where no arm holds the object, the world does, as a table that it stands on: an arm without joints,
``SUPPORT``, comes first and is the one that holds, so that no loop is closed and each hand has a
pose relative to the object.

A grasp configuration never changes. When arms let go or take hold there is another one, and another
:class:`coopqp.model.closed_chain.ClosedChain` built from it.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin

from coopqp.base.errors import GraspError, InvalidValueError, require_known
from coopqp.base.spec import FARTHEST, Array, Lengths3, NonNegative, Pose, Vector3, Vector6, spec
from coopqp.grasp import Grasp, PassiveJoint, pose_matrix
from coopqp.robot import Arm, RobotModel, copy_per_velocity

#: What holds the object where no arm does, fixed to the world.
SUPPORT = Arm(name="the world", tip="universe")

#: Largest gap of given grasps at the start that still counts as closed.
CLOSED_POSITION, CLOSED_ORIENTATION = 1e-4, 1e-3  # [m], [rad]

#: The weights alpha must sum to 1 within this.
WEIGHT_SUM = 1e-6


def inertia_matrix(six: Sequence[float]) -> Array:
    """Symmetric matrix from ixx ixy ixz iyy iyz izz, shape (3, 3) [kg m2]."""
    xx, xy, xz, yy, yz, zz = six
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def check_inertia(matrix: Array, what: str) -> None:
    """InvalidValueError: a principal moment is negative or exceeds the sum of the other two."""
    moments = np.linalg.eigvalsh(matrix)
    slack = 1e-9 * max(float(moments[-1]), 1e-12)
    if moments[0] < -slack or moments[2] > moments[0] + moments[1] + slack:
        raise InvalidValueError(
            f"{what}: principal moments {moments} kg m2 are impossible; each must be positive "
            "and at most the sum of the other two"
        )


@spec
class HeldObject:
    """The object that all arms hold: its size, mass and pose at the start."""

    size: Lengths3 = (0.08, 0.16, 0.08)
    """Edges of the box drawn for it, along its axes [m]."""
    mass: NonNegative = 0.2
    """[kg]"""
    com: Vector3 = (0.0, 0.0, 0.0)
    """Centre of mass in the object frame [m]."""
    inertia: Vector6 | None = None
    """ixx ixy ixz iyy iyz izz about the centre of mass [kg m2]; that of a solid box if omitted."""
    pose: Pose | None = None
    """Pose in the world at the start; midway between the hands, unturned, if omitted."""

    def __post_init__(self) -> None:
        if self.inertia is not None:
            check_inertia(inertia_matrix(self.inertia), "inertia")

    def body(self) -> pin.Inertia:
        """Mass properties in the object frame."""
        com = np.array(self.com)
        if self.inertia is None:
            return pin.Inertia(self.mass, com, pin.Inertia.FromBox(self.mass, *self.size).inertia)
        return pin.Inertia(self.mass, com, inertia_matrix(self.inertia))


@dataclass(frozen=True, kw_only=True)
class GraspConfiguration:
    """Which arms hold the object, how, and since when."""

    robot: RobotModel
    grasps: Mapping[str, Grasp]
    # the joints that each grasp adds, by arm, hand first
    passive: Mapping[str, tuple[PassiveJoint, ...]]
    weights: Array  # of the arms in the absolute variables, in the robot's order
    released: tuple[str, ...]  # names of the arms that do not hold the object
    held: HeldObject
    q: Array  # configuration when this began, passive joints included, shape (n,) [rad, m]
    p_WO: Array  # where the object was then, shape (3,) [m]
    # pose of the object in the frame that carries it, by arm; fixed to the tip of an arm that has
    # let go
    X_EO: Mapping[str, pin.SE3]
    # names of released arms that do not hold it just before or after either; their hands keep away
    # from the object where a limit has bodies keep apart
    away: tuple[str, ...] = ()

    @property
    def arms(self) -> tuple[Arm, ...]:
        """Those that hold the object, or ``SUPPORT``, then the released; in the robot's order."""
        arms = tuple(sorted(self.robot.arms, key=lambda arm: arm.name in self.released))
        return arms if self.holders else (SUPPORT, *arms)

    @property
    def holders(self) -> tuple[str, ...]:
        """Names of the robot's arms that hold the object; none where it stands."""
        return tuple(arm.name for arm in self.robot.arms if arm.name not in self.released)

    @property
    def alpha(self) -> Array:
        """Weights of :attr:`arms`: zero for those that have let go, with sum 1, shape (N,)."""
        names = [arm.name for arm in self.robot.arms]
        weight = dict(zip(names, self.weights, strict=True))
        holders = self.holders
        alpha = np.array([weight[a.name] if a.name in holders else 0.0 for a in self.arms])
        if not alpha.any():  # the leader has let go
            alpha[: max(1, len(self.holders))] = 1.0
        return np.asarray(alpha / alpha.sum(), float)

    def model(self) -> tuple[pin.Model, tuple[int, ...]]:
        """The robot with the grasps' joints, and the ids of the object's frames; it is massless."""
        model, ends = with_passive_joints(self.robot, self.passive)
        return model, tuple(
            add_object_frame(model, arm.name, self._end(arm, ends), self.X_EO[arm.name])
            for arm in self.arms
        )

    def _end(self, arm: Arm, ends: Mapping[str, str]) -> str:
        """The frame that carries the object; of a released arm the one before its joints."""
        return arm.tip if arm.name in (SUPPORT.name, *self.released) else ends[arm.name]

    def handed_over(
        self, q: Array, released: Collection[str], X_WO: Mapping[str, pin.SE3]
    ) -> GraspConfiguration:
        """With other arms holding the object, X_WO by arm; UnknownNameError: no such arm."""
        require_known("arm", released, [arm.name for arm in self.robot.arms])
        p_WO = X_WO[SUPPORT.name].translation.copy()
        other = replace(self, q=q, p_WO=p_WO, released=tuple(released))
        return replace(other, X_EO=other.in_hands(X_WO))

    def in_hands(self, X_WO: Mapping[str, pin.SE3]) -> dict[str, pin.SE3]:
        """X_EO of each arm from where each carries the object at q."""
        model, ends = with_passive_joints(self.robot, self.passive)
        data = model.createData()
        pin.framesForwardKinematics(model, data, self.q)
        X_WE = {a.name: data.oMf[model.getFrameId(self._end(a, ends))] for a in self.arms}
        return {arm: X.actInv(X_WO[arm]) for arm, X in X_WE.items()}


def with_passive_start(
    robot: RobotModel,
    passive: Mapping[str, Sequence[PassiveJoint]],
    q: Array,
    passive_start: Mapping[str, float],
) -> Array:
    """Configuration of the robot's model with its passive joints, from the robot's own q."""
    model, _ = with_passive_joints(robot, passive)
    strangers = [name for name in model.names[1:] if name not in robot.joint_names]
    require_known("passive joint", passive_start, strangers, at=("passive_start",))
    extended = np.zeros(model.nq)
    values = {**dict(zip(robot.joint_names, q, strict=True)), **passive_start}
    for name, value in values.items():
        extended[model.idx_qs[model.getJointId(name)]] = value
    return extended


def at_start(hold: GraspConfiguration) -> GraspConfiguration:
    """The same with the object where each arm (a released one too) carries it, eq. (1)."""
    model, ends = with_passive_joints(hold.robot, hold.passive)
    data = model.createData()
    pin.framesForwardKinematics(model, data, hold.q)
    tips = {arm.name: model.getFrameId(arm.tip) for arm in hold.robot.arms}
    given = {}
    for arm, grasp in hold.grasps.items():
        if grasp.object_in_hand:
            end = model.getFrameId(ends[arm])
            given[arm] = data.oMf[end] * object_at_end(model, end, tips[arm], grasp)
    _check_reach(hold, model, data)
    held_at = _agreed_pose(hold, {arm: X for arm, X in given.items() if arm in hold.holders})
    if held_at is None and not hold.holders:
        words = "no arm holds the object at the start; say where it is"
        raise GraspError(f"{words}, such as pose: {{position: [0.5, 0, 0.2]}}").at("object")
    if held_at is None:
        middle = np.mean([data.oMf[tips[arm]].translation for arm in hold.holders], axis=0)
        held_at = pin.SE3(np.eye(3), middle)
    X_WO = {arm: given.get(arm, held_at) for arm in hold.grasps} | {SUPPORT.name: held_at}
    return replace(hold, p_WO=held_at.translation.copy(), X_EO=hold.in_hands(X_WO))


def _check_reach(hold: GraspConfiguration, model: pin.Model, data: pin.Data) -> None:
    """Refuse joints that are where no robot is; rounding would be all that is left of a motion."""
    for name, X_WJ in list(zip(model.names, data.oMi, strict=True))[1:]:
        away = float(np.linalg.norm(X_WJ.translation))
        if not away <= FARTHEST:
            words = f"joint {name} is {away:g} m from the origin; needs at most {FARTHEST:g} m"
            own = name in hold.robot.joint_names
            raise GraspError(words).at(*(["robot"] if own else ["grasps", name.rpartition(".")[0]]))


def _agreed_pose(hold: GraspConfiguration, by_arm: Mapping[str, pin.SE3]) -> pin.SE3 | None:
    """The object's start pose; GraspError where given poses do not agree."""
    given = [(f"the grasp of arm '{arm}'", ["grasps", arm], X_WO) for arm, X_WO in by_arm.items()]
    if hold.held.pose:
        given.append(("object.pose", [], pose_matrix(hold.held.pose)))
    if not given:
        return None
    (first, _, X_WO), *others = given
    for name, place, X in others:
        apart = np.linalg.norm(X.translation - X_WO.translation)
        angle = np.linalg.norm(pin.log3(X_WO.rotation.T @ X.rotation))
        if apart > CLOSED_POSITION or angle > CLOSED_ORIENTATION:
            raise GraspError(
                f"the grasp does not close at the start: {name} puts the object "
                f"{1e3 * apart:.1f} mm and {np.degrees(angle):.1f} degrees from where {first} "
                "puts it; change the start or leave object_in_hand out"
            ).at(*place)
    return X_WO


def with_passive_joints(
    robot: RobotModel, joints: Mapping[str, Sequence[PassiveJoint]]
) -> tuple[pin.Model, dict[str, str]]:
    """The robot's model with its grasps' joints, hand first, and each arm's last frame by name."""
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
    """Pose of the object in the frame after the passive joints, from object_in_hand at zero."""
    assert grasp.object_in_hand is not None
    data = model.createData()
    pin.framesForwardKinematics(model, data, np.array(pin.neutral(model)))
    return data.oMf[end].actInv(data.oMf[tip]) * pose_matrix(grasp.object_in_hand)


def add_object_frame(model: pin.Model, arm: str, end: str, X_EO: pin.SE3) -> int:
    """Fix the frame of the object as carried by an arm; returns its id."""
    frame = model.frames[model.getFrameId(end)]
    placement, kind = frame.placement * X_EO, pin.FrameType.OP_FRAME
    return int(model.addFrame(pin.Frame(f"object[{arm}]", frame.parentJoint, placement, kind)))


def arm_weights(robot: RobotModel, alpha: Mapping[str, float] | None) -> Array:
    """Weights of the arms in the absolute variables, in their order; alike when alpha is omitted.

    UnknownNameError: no such arm. InvalidValueError: negative, not finite, or a sum other than 1.
    """
    names = [arm.name for arm in robot.arms]
    if alpha is None:
        return np.full(len(names), 1.0 / len(names))
    require_known("arm", alpha, names, at=())
    for name, weight in alpha.items():
        if not 0.0 <= weight < np.inf:
            words = f"weight of arm {name}: found {weight:g}, needs at least 0"
            raise InvalidValueError(words).at(name)
    total = sum(alpha.values())
    if abs(total - 1.0) > WEIGHT_SUM:
        raise InvalidValueError(f"the weights of the arms sum to {total:g}, need 1")
    return np.array([alpha.get(name, 0.0) / total for name in names])


def grasp_of_each(robot: RobotModel, grasps: Grasp | Mapping[str, Grasp]) -> dict[str, Grasp]:
    """Each arm's grasp, in their order; UnknownNameError: no such arm, GraspError: none for one."""
    names = [arm.name for arm in robot.arms]
    if isinstance(grasps, Grasp):
        return dict.fromkeys(names, grasps)
    require_known("arm", grasps, names, "grasp: ", ())
    missing = [name for name in names if name not in grasps]
    if missing:
        raise GraspError(f"grasp: no grasp for arm {', '.join(missing)}")
    return {name: grasps[name] for name in names}
