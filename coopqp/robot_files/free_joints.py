"""Which joints of a robot its arms move by.

Free are the joints between base and tip of every arm (or those the arm names) and the joints
asked for by name, without the locked ones.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import pinocchio as pin

from coopqp.base.errors import InvalidValueError, UnknownNameError, under
from coopqp.robot_files.description import Description
from coopqp.robot_files.keys import ArmJoints

#: Names and kinds of pinocchio's joints with more than one coordinate of motion.
KINDS = {
    "JointModelFreeFlyer": "floating",
    "JointModelPlanar": "planar",
    "JointModelTranslation": "translation",
    "JointModelUniversal": "universal",
    "JointModelComposite": "composite",
}

#: What pinocchio and others call the joint of a floating base: one that a file does not have is
#: fixed anyway, so that locking it asks for nothing.
FIXED_BASE = "root_joint"


def free_joints(
    description: Description,
    arms: Mapping[str, ArmJoints],
    free: Sequence[str],
    locked: Mapping[str, float | None],
) -> set[str]:
    """Names of the joints that move.

    Args:
        description: of the whole robot.
        arms: by name.
        free: joints that join in although they are on no arm's way, or not among its joints.
        locked: joints that stay where they are.

    Raises:
        UnknownNameError: no such frame or joint.
        InvalidValueError: a joint both free and locked, or one that is not one free coordinate.
    """
    known = description.joint_names
    for name in locked:
        if name not in known and name != FIXED_BASE:
            raise UnknownNameError("joint", name, known, "locked: ").at("locked", name)
    for i, name in enumerate(free):
        if name not in known:
            raise UnknownNameError("joint", name, known, "free: ").at("free", i)
    wanted = dict.fromkeys(free, "free")
    moving = set(free)
    for name, arm in arms.items():
        with under("arms", name):
            way = _way_to_tip(description, name, arm.tip, locked)
            moving.update(way if arm.joints is None else _named(name, arm, way, known))
        wanted.update(dict.fromkeys(arm.joints or (), f"arm {name}"))
    for joint in locked:
        if joint in wanted:
            raise InvalidValueError(
                f"joint {joint}: is listed under {wanted[joint]} and under locked; choose one"
            ).at("locked", joint)
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
    found.sort(key=lambda frame: frame.type != pin.FrameType.BODY)  # of namesakes the link counts
    if not found:
        frames = [frame.name for frame in model.frames]
        raise UnknownNameError("frame", tip, frames, f"arm {name}: ")
    for joint, moved in description.floating.items():
        if tip in moved and joint not in locked:
            raise _cannot_move(description, joint, "is floating")
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
        raise _cannot_move(description, joint, f"follows {leader} (mimic)")
    if joint in description.floating:
        raise _cannot_move(description, joint, "is floating")
    model = description.model
    kind = model.joints[model.getJointId(joint)]
    if kind.nv != 1:
        word = KINDS.get(kind.shortname(), "spherical")
        words = f"is {word}, with {kind.nv} coordinates,"
        raise _cannot_move(description, joint, words)


def _cannot_move(description: Description, joint: str, why: str) -> InvalidValueError:
    words = f"{why} and cannot be a joint of an arm; list it under locked"
    return InvalidValueError(f"{description.joint(joint)}: {words}")


def still_followers(
    description: Description, moving: set[str], locked: Mapping[str, float | None]
) -> list[str]:
    """Warnings about locked joints that ought to follow one that moves."""
    return [
        f"{description.name}: joint {name} follows {follower.leader}, but is kept still"
        for name, follower in description.followers.items()
        if follower.leader in moving and name not in locked
    ]
