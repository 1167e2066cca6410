"""From a description of a whole robot and a choice of its arms to a robot model.

A description has all joints of a robot; what is controlled are the joints that move a tip:

1. free are the joints on the arms' ways to their tips (:mod:`coopqp.robot_files.free_joints`);
2. all others are locked (:mod:`coopqp.robot_files.locked_joints`);
3. joints that turn without end get one coordinate, an angle without limits;
4. a velocity or effort limit that is 0 or missing counts as no limit, and so does any limit of
   1e9 or more.
"""

from __future__ import annotations

import fnmatch
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pinocchio as pin

from coopqp.base.errors import InvalidValueError, UnknownNameError
from coopqp.base.spec import Array
from coopqp.robot import Arm, RobotModel, copy_per_velocity
from coopqp.robot_files.description import Description
from coopqp.robot_files.free_joints import free_joints, still_followers
from coopqp.robot_files.keys import ArmJoints, JointLimits
from coopqp.robot_files.locked_joints import without_locked_joints

#: A limit of this size is none; files write 1e10, 1e16 or 3.4e38 for it.
BEYOND = 1e9


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
    moving = free_joints(description, arms, free, locked)
    reduced = without_locked_joints(description, moving, locked)
    model = _with_one_coordinate(reduced)
    _tell_frames_apart(model)
    _set_limits(description, model, joint_limits or {})
    warnings = [*description.warnings, *still_followers(description, moving, locked)]
    robot = RobotModel(
        name=description.name,
        model=model,
        arms=tuple(Arm(name=name, tip=arm.tip) for name, arm in arms.items()),
        shapes=description.shapes,
        collision_shapes=description.collision_shapes,
        unseen=description.unseen,
        warnings=tuple(warnings),
    )
    _check_arms(robot)
    return robot


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
    for pattern, limits in joint_limits.items():
        if not fnmatch.filter(description.joint_names, pattern):
            unknown = UnknownNameError("joint", pattern, names, "joint_limits: ")
            raise unknown.at("joint_limits", pattern)
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
                f"{description.joint(name)}: limits {low:g} to {high:g} leave it no room; list it "
                "under locked or give it joint_limits"
            )
    model.lowerPositionLimit, model.upperPositionLimit = lower, upper
    model.velocityLimit, model.effortLimit = velocity, effort


def _or_infinite(limits: Array) -> Array:
    """Limits with "no limit" where a file has 0, nothing or a number beyond all."""
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
                raise InvalidValueError(
                    f"arm {name}: all its joints ({', '.join(joints)}) also move arm {other}; "
                    "an arm needs joints of its own"
                ).at("arms", name)
