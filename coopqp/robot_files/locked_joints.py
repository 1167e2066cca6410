"""A robot without the joints that stay where they are.

A locked joint stands at the value given, where its leader puts it, or at zero (or at its limit
nearest to zero).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
import pinocchio as pin

from coopqp.base.errors import InvalidValueError
from coopqp.robot_files.description import Description

#: Added to names for a moment; no name in a file ends so.
NAMESAKE = "\0namesake"


def without_locked_joints(
    description: Description, moving: set[str], locked: Mapping[str, float | None]
) -> pin.Model:
    """The model of the joints that move, a copy.

    Args:
        description: of the whole robot.
        moving: names of those joints.
        locked: where the others are [rad or m], as far as that is given.

    Raises:
        InvalidValueError: a value outside the limits, or for a joint of several coordinates.
    """
    model = description.model.copy()  # for its names are changed for a moment
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
            ).at("locked", name)
    still = [j for j in range(1, model.njoints) if model.names[j] not in moving]
    if not still:
        return model
    with _joints_alone_by_name(model):
        reduced = pin.buildReducedModel(model, still, q)
    for frame in reduced.frames:
        frame.name = frame.name.removesuffix(NAMESAKE)
    return reduced


@contextmanager
def _joints_alone_by_name(model: pin.Model) -> Iterator[None]:
    """Call frames that share a joint's name otherwise: pinocchio finds joints' frames by name."""
    joints = set(model.names)
    frames = list(model.frames)[1:]  # but the world's, which joint 0 shares its name with
    namesakes = [f for f in frames if f.name in joints and f.type != pin.FrameType.JOINT]
    for frame in namesakes:
        frame.name += NAMESAKE
    try:
        yield
    finally:
        for frame in namesakes:
            frame.name = frame.name.removesuffix(NAMESAKE)


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
        ).at("locked", name)
    return given
