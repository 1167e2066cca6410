"""What robots read from files and tables share: arms, free and locked joints, limits, URDF.

A description has all joints of a robot; what is controlled are the joints that move a tip. Of a
description, a choice of arms makes a model in four steps:

1. free are the joints between base and tip of every arm (or those the arm names) and the joints
   asked for by name, without the locked ones;
2. all others are locked, at a given value or at zero (or at their limit nearest to zero);
3. joints that turn without end get one coordinate, an angle without limits;
4. a velocity or effort limit that is 0 or missing counts as no limit.
"""

from __future__ import annotations

import fnmatch
import math
import os
import tempfile
import xml.etree.ElementTree as ET
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from pydantic import AfterValidator, BeforeValidator, ValidationInfo

from coopqp.errors import InvalidValueError, UnknownNameError
from coopqp.robot import Arm, RobotModel, Shape
from coopqp.spec import NonNegative, Positive, spec

#: Names and kinds of pinocchio's joints with more than one coordinate of motion.
KINDS = {
    "JointModelFreeFlyer": "floating",
    "JointModelPlanar": "planar",
    "JointModelTranslation": "translation",
    "JointModelUniversal": "universal",
    "JointModelComposite": "composite",
}

#: Data of a pinocchio model with one number per velocity coordinate.
PER_VELOCITY = (
    "velocityLimit", "effortLimit", "armature", "damping", "rotorInertia", "rotorGearRatio"
)  # fmt: skip


# ---- keys that all these robots have ---------------------------------------------------------


def _beside_the_scenario(path: Path, info: ValidationInfo) -> Path:
    folder = (info.context or {}).get("folder")
    return path if folder is None else (folder / path).resolve()


def _path(value: Any) -> Any:
    if not isinstance(value, str | Path) or not str(value):
        raise ValueError("needs a path")
    return value


FilePath = Annotated[Path, BeforeValidator(_path), AfterValidator(_beside_the_scenario)]
"""A file or folder; in a scenario, a relative one counts from the scenario file's folder."""


@spec
class ArmJoints:
    """Tip and joints of an arm."""

    tip: str
    """Frame of the hand: a link, joint or site of the robot."""
    joints: tuple[str, ...] | None = None
    """Those that this arm moves by; all between base and tip when omitted."""


class _TipAlone:
    """Lets an arm be its tip's name alone, also in the JSON Schema."""

    @staticmethod
    def read(value: Any) -> Any:
        if isinstance(value, dict | ArmJoints):
            return value
        if type(value) not in (str, int):  # a number may be a row of an MDH table
            raise ValueError("needs the tip's frame, or {tip: frame, joints: [...]}")
        return {"tip": str(value)}

    def __get_pydantic_json_schema__(self, core: Any, handler: Any) -> Any:
        return {"anyOf": [{"type": "string"}, handler(core)]}


class _NamesAlone:
    """Lets locked joints be a list of names, also in the JSON Schema."""

    @staticmethod
    def read(value: Any) -> Any:
        if isinstance(value, list | tuple) and all(isinstance(name, str) for name in value):
            return dict.fromkeys(value)
        if not isinstance(value, dict):
            raise ValueError("needs a list of joints, or joints with values")
        return value

    def __get_pydantic_json_schema__(self, core: Any, handler: Any) -> Any:
        return {"anyOf": [{"type": "array", "items": {"type": "string"}}, handler(core)]}


def _some_arms(value: Any) -> Any:
    if not isinstance(value, dict) or not value:
        raise ValueError("needs arms by name, such as {right: TIP, left: TIP}")
    return value


Arms = Annotated[
    dict[str, Annotated[ArmJoints, BeforeValidator(_TipAlone.read), _TipAlone()]],
    BeforeValidator(_some_arms),
]
"""Arms by name, each its tip's frame or {tip: frame, joints: [...]}; the first is the reference."""

Locked = Annotated[dict[str, float | None], BeforeValidator(_NamesAlone.read), _NamesAlone()]
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


# ---- from a description to a robot -----------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class Follower:
    """A joint that follows another one: its value is ratio times the leader's plus offset.

    Without a leader (an empty name) it has one value for good.
    """

    leader: str
    ratio: float = 1.0
    offset: float = 0.0


@dataclass(frozen=True, kw_only=True)
class Description:
    """All that a file says of a robot.

    Attributes:
        name: of the robot.
        model: pinocchio model of all joints.
        followers: joints that follow others (mimic), by name.
        floating: joints that the model leaves out because they are free in space, each with the
            frames that they would move.
        shapes, warnings: as in :class:`coopqp.robot.RobotModel`.
    """

    name: str
    model: pin.Model
    followers: Mapping[str, Follower] = field(default_factory=dict)
    floating: Mapping[str, frozenset[str]] = field(default_factory=dict)
    shapes: tuple[Shape, ...] = ()
    warnings: tuple[str, ...] = ()

    @property
    def joint_names(self) -> list[str]:
        """Of the model's joints and of those left out."""
        return [*list(self.model.names)[1:], *self.floating]


def robot_model(
    description: Description,
    *,
    arms: Mapping[str, ArmJoints],
    free: Sequence[str] = (),
    locked: Mapping[str, float | None],
    joint_limits: Mapping[str, JointLimits] | None = None,
) -> RobotModel:
    """Choose arms and joints of a robot.

    Args:
        description: of the whole robot.
        arms: by name; the order is that of the loops.
        free: joints that join in although they are on no arm's way, or not among its joints.
        locked: joints that stay at a value, or where they are when it is None [rad or m].
        joint_limits: by name of a joint, or a pattern such as ``left_*``.

    Raises:
        UnknownNameError: no such frame or joint.
        InvalidValueError: an arm without joints of its own, a free joint that cannot be one
            coordinate, a value outside the limits, a joint both free and locked.
    """
    moving = _free_joints(description, arms, free, locked)
    reduced = _reduced(description, moving, locked)
    model = _with_one_coordinate(reduced)
    _tell_frames_apart(model)
    _set_limits(description, model, joint_limits or {})
    warnings = [*description.warnings, *_still_followers(description, moving, locked)]
    robot = RobotModel(
        name=description.name,
        model=model,
        arms=tuple(Arm(name=name, tip=arm.tip) for name, arm in arms.items()),
        shapes=description.shapes,
        warnings=tuple(warnings),
    )
    _check_arms(robot)
    return robot


def _free_joints(
    description: Description,
    arms: Mapping[str, ArmJoints],
    free: Sequence[str],
    locked: Mapping[str, float | None],
) -> set[str]:
    known = description.joint_names
    for name in locked:
        if name not in known:
            raise UnknownNameError("joint", name, known, "locked: ")
    for name in free:
        if name not in known:
            raise UnknownNameError("joint", name, known, "free: ")
    wanted = dict.fromkeys(free, "free")
    moving = set(free)
    for name, arm in arms.items():
        way = _way_to_tip(description, name, arm.tip, locked)
        moving.update(way if arm.joints is None else _named(name, arm, way, known))
        wanted.update(dict.fromkeys(arm.joints or (), f"arm {name}"))
    for joint in locked:
        if joint in wanted:
            raise InvalidValueError(
                f"joint {joint}: is listed under {wanted[joint]} and under locked; choose one"
            )
    moving -= set(locked)
    for joint in sorted(moving):
        _check_free(description, joint)
    return moving


def _way_to_tip(
    description: Description, name: str, tip: str, locked: Mapping[str, float | None]
) -> list[str]:
    """Joints between base and tip, base first."""
    model = description.model
    found = [frame for frame in model.frames if frame.name == tip]
    if not found:
        frames = [frame.name for frame in model.frames]
        raise UnknownNameError("frame", tip, frames, f"arm {name}: ")
    for joint, moved in description.floating.items():
        if tip in moved and joint not in locked:
            raise _cannot_move(joint, "is floating")
    return [model.names[j] for j in model.supports[found[0].parentJoint] if j > 0]


def _named(name: str, arm: ArmJoints, way: Sequence[str], known: Sequence[str]) -> Sequence[str]:
    """The joints an arm names, checked."""
    joints = arm.joints or ()
    for joint in joints:
        if joint not in known:
            raise UnknownNameError("joint", joint, known, f"arm {name}: ")
        if joint not in way:
            raise InvalidValueError(
                f"arm {name}: joint {joint} does not move the tip {arm.tip}; "
                f"those that do: {', '.join(way) or 'none'}"
            )
    return joints


def _check_free(description: Description, joint: str) -> None:
    """Refuse a free joint that one coordinate cannot describe."""
    follower = description.followers.get(joint)
    if follower:
        leader = follower.leader or "a fixed value"
        raise _cannot_move(joint, f"follows {leader} (mimic)")
    if joint in description.floating:
        raise _cannot_move(joint, "is floating")
    model = description.model
    kind = model.joints[model.getJointId(joint)]
    if kind.nv != 1:
        word = KINDS.get(kind.shortname(), "spherical")
        raise _cannot_move(joint, f"is {word}, with {kind.nv} coordinates,")


def _cannot_move(joint: str, why: str) -> InvalidValueError:
    return InvalidValueError(
        f"joint {joint}: {why} and cannot be a joint of an arm; list it under locked"
    )


def _reduced(
    description: Description, moving: set[str], locked: Mapping[str, float | None]
) -> pin.Model:
    """The model with all but the free joints locked."""
    model = description.model
    q = np.array(pin.neutral(model))
    for joint in range(1, model.njoints):
        name, kind = model.names[joint], model.joints[joint]
        if name in moving:
            continue
        if kind.nv == 1:
            value = _locked_value(description, name, locked)
            at = [math.cos(value), math.sin(value)] if kind.nq == 2 else [value]
            q[kind.idx_q : kind.idx_q + kind.nq] = at
        elif locked.get(name) is not None:
            raise InvalidValueError(
                f"locked: joint {name} has {kind.nv} coordinates; give its name without a value"
            )
    still = [j for j in range(1, model.njoints) if model.names[j] not in moving]
    return pin.buildReducedModel(model, still, q)


def _locked_value(description: Description, name: str, locked: Mapping[str, float | None]) -> float:
    """Where a joint with one coordinate is locked [rad or m]."""
    model, given = description.model, locked.get(name)
    follower = description.followers.get(name)
    if given is None and follower:
        leader = 0.0
        if follower.leader in model.names:
            unled = replace(description, followers={})  # a chain of followers would be a circle
            leader = _locked_value(unled, follower.leader, locked)
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
        )
    return given


def _still_followers(
    description: Description, moving: set[str], locked: Mapping[str, float | None]
) -> list[str]:
    return [
        f"{description.name}: joint {name} follows {follower.leader}, but is kept still"
        for name, follower in description.followers.items()
        if follower.leader in moving and name not in locked
    ]


def _with_one_coordinate(model: pin.Model) -> pin.Model:
    """The model with (cos, sin) joints made revolute: one angle, without limits.

    pinocchio gives a joint that turns without end two coordinates; here every joint has one, and
    an angle that has gone round once differs by 2 pi.
    """
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


def copy_per_velocity(source: pin.Model, target: pin.Model, prefix: str = "") -> None:
    """Copy limits, friction and rotors of the source's joints, found by name in the target.

    Args:
        source: from where; one velocity coordinate per joint.
        target: to where.
        prefix: of the joints' names in the target.
    """
    at = [target.idx_vs[target.getJointId(prefix + name)] for name in list(source.names)[1:]]
    for key in PER_VELOCITY:
        values = np.array(getattr(target, key))
        values[at] = getattr(source, key)
        setattr(target, key, values)


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
    velocity, effort = _or_infinite(model.velocityLimit), _or_infinite(model.effortLimit)
    for pattern, limits in joint_limits.items():
        if not fnmatch.filter(description.joint_names, pattern):
            raise UnknownNameError("joint", pattern, names, "joint_limits: ")
        at = [i for i, name in enumerate(names) if fnmatch.fnmatchcase(name, pattern)]
        for values, given in (
            (lower, limits.lower), (upper, limits.upper),
            (velocity, limits.velocity), (effort, limits.effort),
        ):  # fmt: skip
            if given is not None:
                values[at] = given
    for name, low, high in zip(names, lower, upper, strict=True):
        if not low < high:
            raise InvalidValueError(
                f"joint {name}: limits {low:g} to {high:g} leave it no room; list it under locked "
                "or give it joint_limits"
            )
    model.lowerPositionLimit, model.upperPositionLimit = lower, upper
    model.velocityLimit, model.effortLimit = velocity, effort


def _or_infinite(limits: NDArray[np.float64]) -> NDArray[np.float64]:
    """Limits with "no limit" where a file has 0 or nothing."""
    values = np.array(limits)
    return np.where(values > 0.0, values, np.inf)


def _check_arms(robot: RobotModel) -> None:
    """Every arm needs a joint that the other arms do not all have."""
    ways = {arm.name: robot.arm_joints(arm) for arm in robot.arms}
    for name, joints in ways.items():
        if not joints:
            raise InvalidValueError(f"arm {name}: no free joint between the base and its tip")
        for other, others in ways.items():
            if other != name and set(joints) <= set(others):
                raise InvalidValueError(
                    f"arm {name}: all its joints ({', '.join(joints)}) also move arm {other}; "
                    "an arm needs joints of its own"
                )


# ---- files -----------------------------------------------------------------------------------


def read_xml(path: Path, root: str, kind: str) -> ET.Element:
    """Read an XML file of a robot.

    Args:
        path: of the file.
        root: name of its outermost element.
        kind: of file, for messages.

    Raises:
        InvalidValueError: no such file, or no such kind of file.
    """
    try:
        tree = ET.parse(path)
    except OSError as error:
        raise InvalidValueError(f"{path}: cannot be read: {error.strerror}") from None
    except (ET.ParseError, UnicodeError, ValueError) as error:
        raise InvalidValueError(f"{path}: is not a {kind} file: {error}") from None
    element = tree.getroot()
    if element.tag != root:
        raise InvalidValueError(
            f"{path}: is not a {kind} file: starts with <{element.tag}>, needs <{root}>"
        )
    return element


def numbers_of(text: str | None, default: str) -> tuple[float, ...]:
    """The numbers of an attribute."""
    return tuple(float(word) for word in (text or default).split())


def missing_meshes(name: str, missing: Sequence[str], count: int) -> tuple[str, ...]:
    """The warning about meshes that were not found, if there are any."""
    if not missing:
        return ()
    shown = ", ".join(missing[:2]) + (", ..." if len(missing) > 2 else "")
    return (f"{name}: {len(missing)} of {count} meshes cannot be found ({shown}); not drawn",)


def pinocchio_says(error: Exception) -> str:
    """What went wrong, without pinocchio's line numbers."""
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    told = [
        line for line in lines if not line.startswith(("From file:", "in function:", "at line:"))
    ]
    return " ".join(told).removeprefix("message: ") or type(error).__name__


def read_urdf(path: Path, package_dirs: Sequence[Path] = ()) -> Description:
    """Read a URDF file; meshes are looked for, but not read.

    Args:
        path: of the file.
        package_dirs: folders that hold ``package://`` packages; the folders above the file are
            searched anyway.

    Raises:
        InvalidValueError: no such file, or not a URDF file.
    """
    xml = read_xml(path, "robot", "URDF")
    if any("xacro" in element.tag for element in xml.iter()):
        raise InvalidValueError(f"{path}: is a xacro file; make a URDF of it first: xacro FILE")
    if xml.find("link") is None:
        raise InvalidValueError(f"{path}: is not a URDF file: has no <link>")
    heard: list[str] = []
    try:
        with _stderr_lines(heard):
            model = pin.buildModelFromUrdf(str(path))
        followers = dict(_mimics(xml))
        shapes, missing = _urdf_shapes(xml, path, package_dirs)
    except (ValueError, RuntimeError) as error:
        why = "; ".join(heard) or pinocchio_says(error)
        raise InvalidValueError(f"{path}: is not a robot that can be read: {why}") from None
    meshes = sum(shape.kind == "mesh" for shape in shapes) + len(missing)
    return Description(
        name=xml.get("name") or path.stem,
        model=model,
        followers=followers,
        shapes=shapes,
        warnings=(
            *(f"{path.name}: {line}" for line in heard),
            *missing_meshes(path.name, missing, meshes),
        ),
    )


@contextmanager
def _stderr_lines(heard: list[str]) -> Iterator[None]:
    """Collect what the URDF parser, in C++, would print about errors."""
    with tempfile.TemporaryFile() as file:
        kept = os.dup(2)
        os.dup2(file.fileno(), 2)
        try:
            yield
        finally:
            os.dup2(kept, 2)
            os.close(kept)
            file.seek(0)
            for line in file.read().decode("utf-8", "replace").splitlines():
                word, _, text = line.partition(":")
                if word in ("Error", "Warning"):
                    heard.append(text.strip())


def _mimics(xml: ET.Element) -> list[tuple[str, Follower]]:
    found = []
    for joint in xml.findall("joint"):
        mimic = joint.find("mimic")
        if mimic is not None:
            (ratio,) = numbers_of(mimic.get("multiplier"), "1")
            (offset,) = numbers_of(mimic.get("offset"), "0")
            follower = Follower(leader=mimic.get("joint", ""), ratio=ratio, offset=offset)
            found.append((joint.get("name", ""), follower))
    return found


def _urdf_shapes(
    xml: ET.Element, path: Path, package_dirs: Sequence[Path]
) -> tuple[tuple[Shape, ...], list[str]]:
    """What the links look like, and the meshes that cannot be found."""
    shapes, missing = [], []
    for link in xml.findall("link"):
        for visual in link.findall("visual"):
            geometry = visual.find("geometry")
            if geometry is None or not len(geometry):
                continue
            place, part = _origin(visual.find("origin")), geometry[0]
            frame, mesh = link.get("name", ""), None
            if part.tag == "mesh":
                uri = part.get("filename", "")
                mesh = find_mesh(uri, path, package_dirs)
                if mesh is None:
                    missing.append(uri)
                    continue
            size = _urdf_size(part)
            if size:
                kind: Any = part.tag
                shapes.append(Shape(frame=frame, placement=place, kind=kind, size=size, mesh=mesh))
    return tuple(shapes), missing


def _urdf_size(part: ET.Element) -> tuple[float, ...]:
    if part.tag == "mesh":
        return numbers_of(part.get("scale"), "1 1 1")
    if part.tag == "box":
        return numbers_of(part.get("size"), "")
    if part.tag in ("cylinder", "capsule"):
        return numbers_of(part.get("radius"), "") + numbers_of(part.get("length"), "")
    return numbers_of(part.get("radius"), "") if part.tag == "sphere" else ()


def _origin(origin: ET.Element | None) -> pin.SE3:
    if origin is None:
        return pin.SE3.Identity()
    roll, pitch, yaw = numbers_of(origin.get("rpy"), "0 0 0")
    place = numbers_of(origin.get("xyz"), "0 0 0")
    return pin.SE3(pin.rpy.rpyToMatrix(roll, pitch, yaw), np.array(place))


def find_mesh(uri: str, urdf: Path, package_dirs: Sequence[Path]) -> Path | None:
    """The file behind a mesh's address, or None.

    Args:
        uri: ``package://NAME/PATH`` (or ``model://``), ``file://PATH`` or a path, relative to
            the URDF's folder.
        urdf: the file that has the address.
        package_dirs: folders that hold packages.
    """
    scheme, _, rest = uri.rpartition("://")
    folder = urdf.resolve().parent
    if scheme in ("package", "model"):
        package, _, inside = rest.partition("/")
        candidates = []
        for parent in (*package_dirs, folder, *folder.parents):
            candidates.append(parent / package / inside)
            if parent.name == package:
                candidates.append(parent / inside)
    else:
        candidates = [folder / rest]
    return next((file for file in candidates if file.is_file()), None)
