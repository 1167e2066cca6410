"""From a description of a whole robot and the keys that choose its arms to a robot model.

A description has all joints of a robot; controlled are the joints that move a tip:

1. free are the joints on the arms' ways to their tips, or those that an arm names;
2. all others are locked;
3. joints that turn without end get one coordinate, an angle without limits;
4. a velocity or effort limit that is 0 or missing counts as no limit, and so does any limit of
   1e9 or more.
"""

import fnmatch
import math
from abc import abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Annotated, Any

import numpy as np
import pinocchio as pin
from pydantic import BeforeValidator, Field

from coopqp.base.errors import InvalidValueError, UnknownNameError, require_known, under
from coopqp.base.spec import Array, NonNegative, Positive, spec
from coopqp.grasp import range_fault
from coopqp.robot import Arm, Robot, RobotModel, Shape, copy_per_velocity


@dataclass(frozen=True, kw_only=True)
class Follower:
    """A joint with the value ratio * leader + offset; constant without a leader (empty name)."""

    leader: str
    ratio: float = 1.0
    offset: float = 0.0


@dataclass(frozen=True, kw_only=True)
class Description:
    """A whole robot as a file describes it."""

    name: str
    model: pin.Model  # of all joints
    # joints that follow others (mimic), by name
    followers: Mapping[str, Follower] = field(default_factory=dict)
    # joints that are free in space, which the model leaves out, each with the frames that they
    # would move
    floating: Mapping[str, frozenset[str]] = field(default_factory=dict)
    shapes: tuple[Shape, ...] = ()  # this and the next three as RobotModel has them
    collision_shapes: tuple[Shape, ...] = ()
    unseen: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    places: Mapping[str, str] = field(default_factory=dict)  # file and line of joints, by name

    @property
    def joint_names(self) -> list[str]:
        return [*list(self.model.names)[1:], *self.floating]

    def joint(self, name: str) -> str:
        """``FILE:LINE: joint r1``, without a place where it has none."""
        place = self.places.get(name)
        return f"{place}: joint {name}" if place else f"joint {name}"


@spec
class ArmJoints:
    """Tip and joints of an arm."""

    tip: str
    """Frame of the hand: a link, joint or site of the robot."""
    joints: tuple[str, ...] | None = None
    """Those that this arm moves by; all between base and tip when omitted."""


def _arm_or_tip(value: Any) -> Any:
    if isinstance(value, dict | ArmJoints):
        return value
    if type(value) not in (str, int):  # a number may be a row of an MDH table
        raise ValueError("needs the tip's frame, or {tip: frame, joints: [...]}")
    return {"tip": str(value)}


def _values_or_names(value: Any) -> Any:
    if isinstance(value, list | tuple) and all(isinstance(name, str) for name in value):
        return dict.fromkeys(value)
    if not isinstance(value, dict):
        raise ValueError("needs a list of joints, or joints with values")
    return value


def _some_arms(value: Any) -> Any:
    if not isinstance(value, dict) or not value:
        raise ValueError("needs arms by name, such as {right: TIP, left: TIP}")
    return value


_Arm = Annotated[ArmJoints, BeforeValidator(_arm_or_tip, json_schema_input_type=str | ArmJoints)]
Arms = Annotated[dict[str, _Arm], BeforeValidator(_some_arms)]
"""Arms by name, each its tip's frame or {tip: frame, joints: [...]}; the first is the reference."""

Locked = Annotated[
    dict[str, float | None],
    BeforeValidator(_values_or_names, json_schema_input_type=list[str] | dict[str, float | None]),
]
"""Joints that stay where they are: names, or names with values [rad or m]."""


@spec
class JointLimits:
    """Limits of a joint that replace those of the file."""

    lower: float | None = None
    """[rad or m]"""
    upper: float | None = None
    """[rad or m]"""
    velocity: Positive | None = None
    """[rad/s or m/s]"""
    effort: NonNegative | None = None
    """[N m or N]"""

    def __post_init__(self) -> None:
        if wrong := range_fault(self.lower, self.upper):
            raise ValueError(wrong)


BEYOND = 1e9  # a limit of this size is none; files write 1e10, 1e16 or 3.4e38 for it


@spec
class DescribedRobot(Robot):
    """A robot whose joints and arms are chosen from a description of the whole."""

    arms: Arms
    """Arms by name, each its tip's frame or {tip: frame, joints: [...]}; of MJCF a body, site or
    joint, of a table a row or one of tips."""
    free: tuple[str, ...] = ()
    """Joints that join in besides those of the arms."""
    locked: Locked = Field(default_factory=dict)
    """Joints kept still: names, or names with values [rad or m]; others that move no tip too."""
    joint_limits: dict[str, JointLimits] = Field(default_factory=dict)
    """Limits instead of those described, by joint or pattern such as left_*."""

    @abstractmethod
    def description(self) -> Description:
        """The whole robot."""

    def build(self) -> RobotModel:
        """Choose arms and joints.

        UnknownNameError: no such frame or joint. InvalidValueError: an arm without joints of its
        own, a free joint that cannot be one coordinate, a value outside the limits, a joint both
        free and locked.
        """
        description = self.description()
        selection = _Selection(description, self)
        model = _with_one_coordinate(selection.model())
        _tell_frames_apart(model)
        _set_limits(description, model, self.joint_limits)
        robot = RobotModel(
            name=description.name,
            model=model,
            arms=tuple(Arm(name=name, tip=arm.tip) for name, arm in self.arms.items()),
            shapes=description.shapes,
            collision_shapes=description.collision_shapes,
            unseen=description.unseen,
            warnings=(*description.warnings, *selection.still_followers()),
        )
        _check_arms(robot)
        return robot


def _with_one_coordinate(model: pin.Model) -> pin.Model:
    """With one unlimited angle, 2 pi more after a turn, in place of pinocchio's (cos, sin)."""
    if model.nq == model.nv:
        return model
    data = model.createData()
    pin.computeJointJacobians(model, data, pin.neutral(model))
    single = pin.Model()
    single.name, single.gravity = model.name, model.gravity
    lower, upper = np.full(model.nv, -np.inf), np.full(model.nv, np.inf)
    for j in range(1, model.njoints):
        kind = model.joints[j]
        if kind.nq == kind.nv:
            lower[kind.idx_v] = model.lowerPositionLimit[kind.idx_q]
            upper[kind.idx_v] = model.upperPositionLimit[kind.idx_q]
            new: Any = kind.extract()
        else:
            axis = pin.getJointJacobian(model, data, j, pin.LOCAL)[3:, kind.idx_v]
            new = pin.JointModelRevoluteUnaligned(np.array(axis))
        single.addJoint(model.parents[j], new, model.jointPlacements[j], model.names[j])
        single.inertias[j] = model.inertias[j]
    single.inertias[0] = model.inertias[0]
    single.lowerPositionLimit, single.upperPositionLimit = lower, upper
    copy_per_velocity(model, single)
    for frame in list(model.frames)[1:]:
        single.addFrame(frame, False)
    return single


def _tell_frames_apart(model: pin.Model) -> None:
    """Rename joints' and other frames that share a link's name: pinocchio finds them by name."""
    links = {f.name for f in model.frames if f.type == pin.FrameType.BODY}
    for frame in model.frames:
        if frame.type != pin.FrameType.BODY and frame.name in links:
            frame.name += " (frame)" if frame.type == pin.FrameType.OP_FRAME else " (joint)"


def _set_limits(
    description: Description, model: pin.Model, joint_limits: Mapping[str, JointLimits]
) -> None:
    names = list(model.names)[1:]
    lower, upper = np.array(model.lowerPositionLimit), np.array(model.upperPositionLimit)
    lower[lower <= -BEYOND], upper[upper >= BEYOND] = -np.inf, np.inf
    velocity, effort = _or_infinite(model.velocityLimit), _or_infinite(model.effortLimit)
    arrays = {"lower": lower, "upper": upper, "velocity": velocity, "effort": effort}
    for pattern, limits in joint_limits.items():
        if not fnmatch.filter(description.joint_names, pattern):
            unknown = UnknownNameError("joint", pattern, names, "joint_limits: ")
            raise unknown.at("joint_limits", pattern)
        at = [i for i, name in enumerate(names) if fnmatch.fnmatchcase(name, pattern)]
        for key, values in arrays.items():
            if (given := getattr(limits, key)) is not None:
                values[at] = given
    for name, low, high in zip(names, lower, upper, strict=True):
        if not low < high:
            raise InvalidValueError(
                f"{description.joint(name)}: limits {low:g} to {high:g} leave it no room; list it "
                "under locked or give it joint_limits"
            )
    model.lowerPositionLimit, model.upperPositionLimit = lower, upper
    model.velocityLimit, model.effortLimit = velocity, effort


def _or_infinite(limits: Array) -> Array:
    """Infinite where a file has 0, nothing or BEYOND."""
    values = np.array(limits)
    return np.where((values > 0.0) & (values < BEYOND), values, np.inf)


def _check_arms(robot: RobotModel) -> None:
    """Every arm needs a joint that the other arms do not all have."""
    ways = {arm.name: robot.arm_joints(arm) for arm in robot.arms}
    for arm in robot.arms:
        name, joints = arm.name, ways[arm.name]
        if not joints:
            words = f"arm {name}: no free joint between the base and its tip {arm.tip}"
            raise InvalidValueError(words).at("arms", name)
        for other, others in ways.items():
            if other != name and set(joints) <= set(others):
                words = f"all its joints ({', '.join(joints)}) also move arm {other}"
                words = f"arm {name}: {words}; an arm needs joints of its own"
                raise InvalidValueError(words).at("arms", name)


#: Names and kinds of pinocchio's joints with more than one coordinate of motion.
KINDS = {
    "JointModelFreeFlyer": "floating",
    "JointModelPlanar": "planar",
    "JointModelTranslation": "translation",
    "JointModelUniversal": "universal",
    "JointModelComposite": "composite",
}

#: Name of a floating base's joint in pinocchio and elsewhere; locking it is allowed where a file
#: has none.
FIXED_BASE = "root_joint"

NAMESAKE = "\0namesake"  # suffix of frames' names for a moment; no name in a file ends so


class _Selection:
    """Which joints of a description move, by name, and where the others are kept."""

    def __init__(self, description: Description, robot: DescribedRobot) -> None:
        self._description, self._locked = description, robot.locked
        known = description.joint_names
        own = {name: None for name in robot.locked if name != FIXED_BASE}
        require_known("joint", own, known, "locked: ", ("locked",))
        require_known("joint", robot.free, known, "free: ", ("free",))
        wanted, moving = dict.fromkeys(robot.free, "free"), set(robot.free)
        for name, arm in robot.arms.items():
            with under("arms", name):
                moving.update(self._joints_of(name, arm))
            wanted.update(dict.fromkeys(arm.joints or (), f"arm {name}"))
        for joint in robot.locked:
            if joint in wanted:
                raise InvalidValueError(
                    f"joint {joint}: is listed under {wanted[joint]} and under locked; choose one"
                ).at("locked", joint)
        self._moving = moving - set(robot.locked)
        for joint in sorted(self._moving):
            self._check_free(joint)

    def _joints_of(self, name: str, arm: ArmJoints) -> Sequence[str]:
        """Those between base and tip, base first, or what an arm names of them."""
        model = self._description.model
        found = [frame for frame in model.frames if frame.name == arm.tip]
        if not found:
            frames = [frame.name for frame in model.frames]
            raise UnknownNameError("frame", arm.tip, frames, f"arm {name}: ")
        for joint, moved in self._description.floating.items():
            if arm.tip in moved and joint not in self._locked:
                raise self._cannot_move(joint, "is floating")
        # Of namesakes the link counts.
        tip = min(found, key=lambda frame: frame.type != pin.FrameType.BODY)
        way = [model.names[j] for j in model.supports[tip.parentJoint] if j > 0]
        require_known("joint", arm.joints or (), self._description.joint_names, f"arm {name}: ")
        for joint in arm.joints or ():
            if joint not in way:
                words = f"tip {arm.tip}; those that do: {', '.join(way) or 'none'}"
                raise InvalidValueError(f"arm {name}: joint {joint} does not move the {words}")
        return way if arm.joints is None else arm.joints

    def _check_free(self, joint: str) -> None:
        """Refuse a free joint that one coordinate cannot describe."""
        if follower := self._description.followers.get(joint):
            leader = follower.leader or "a fixed value"
            raise self._cannot_move(joint, f"follows {leader} (mimic)")
        if joint in self._description.floating:
            raise self._cannot_move(joint, "is floating")
        model = self._description.model
        kind = model.joints[model.getJointId(joint)]
        if kind.nv != 1:
            word = KINDS.get(kind.shortname(), "spherical")
            raise self._cannot_move(joint, f"is {word}, with {kind.nv} coordinates,")

    def _cannot_move(self, joint: str, why: str) -> InvalidValueError:
        words = f"{why} and cannot be a joint of an arm; list it under locked"
        return InvalidValueError(f"{self._description.joint(joint)}: {words}")

    def still_followers(self) -> list[str]:
        return [
            f"{self._description.name}: joint {name} follows {follower.leader}, but is kept still"
            for name, follower in self._description.followers.items()
            if follower.leader in self._moving and name not in self._locked
        ]

    def model(self) -> pin.Model:
        """That of the joints that move, a copy; others are at their locked value."""
        model = self._description.model.copy()
        q, still = np.array(pin.neutral(model)), list[int]()
        for joint in range(1, model.njoints):
            name, kind = model.names[joint], model.joints[joint]
            if name in self._moving:
                continue
            still.append(joint)
            if kind.nv == 1:
                value = self._value(name, self._description.followers)
                at = [math.cos(value), math.sin(value)] if kind.nq == 2 else [value]
                q[kind.idx_q : kind.idx_q + kind.nq] = at
            elif self._locked.get(name) is not None:
                raise InvalidValueError(
                    f"locked: joint {name} has {kind.nv} coordinates; give its name without a value"
                ).at("locked", name)
        if not still:
            return model
        for frame in list(model.frames)[1:]:  # without the world's, which has the name of joint 0
            if frame.name in model.names and frame.type != pin.FrameType.JOINT:
                frame.name += NAMESAKE  # pinocchio finds joints' frames by name
        reduced = pin.buildReducedModel(model, still, q)
        for frame in reduced.frames:
            frame.name = frame.name.removesuffix(NAMESAKE)
        return reduced

    def _value(self, name: str, followers: Mapping[str, Follower]) -> float:
        """Of a locked joint with one coordinate: given, its leader's, or nearest to zero."""
        model, given = self._description.model, self._locked.get(name)
        if given is None and (follower := followers.get(name)):
            known = follower.leader in model.names
            # Without the followers: a chain of them would be a circle.
            leader = self._value(follower.leader, {}) if known else 0.0
            return follower.ratio * leader + follower.offset
        kind = model.joints[model.getJointId(name)]
        lower, upper = -math.inf, math.inf
        if kind.nq == 1:
            lower = float(model.lowerPositionLimit[kind.idx_q])
            upper = float(model.upperPositionLimit[kind.idx_q])
        if given is None:
            return min(max(0.0, lower), upper)
        if not lower <= given <= upper:
            raise InvalidValueError(
                f"locked: joint {name} at {given:g} is outside its limits {lower:g} to {upper:g}"
            ).at("locked", name)
        return given
