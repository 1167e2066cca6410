"""Values that are most likely in another unit: degrees for radians, millimetres for metres."""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import partial

import numpy as np
import pinocchio as pin

from coopqp.checked import Array
from coopqp.closed_chain import ClosedChain
from coopqp.input import InputSettings
from coopqp.mark import (
    CircleMark,
    LineMark,
    Mark,
    PlaneMark,
    PointMark,
    PoseMark,
    SphereMark,
    asked,
)
from coopqp.robot import RobotModel
from coopqp.scenario.scenario import Scenario
from coopqp.signal import POINT, POSE, Kind, Moment
from coopqp.table import read_table

#: A goal this many times the arms' reach from where the object starts cannot be meant [-].
FAR = 3.0
#: A hand that is fastened to the object, this far from it, is worth a word [m].
FAR_HAND = 0.1
#: How many instants of a signal are looked at.
LOOKS = 9
#: An object whose longest edge is this many times the arms' reach cannot either [-].
LARGE = 20.0


def like_degrees(robot: RobotModel, q: Array) -> bool:
    """Whether joints are outside their limits by more than a turn, and inside them in degrees."""
    lower, upper = robot.model.lowerPositionLimit, robot.model.upperPositionLimit
    turns = np.array([unit == "rad" for unit in robot.joint_units])
    outside = turns & ((q < lower) | (q > upper))
    inside = (lower <= np.radians(q)) & (np.radians(q) <= upper)
    return bool((np.abs(q[outside]) > 2.0 * math.pi).any() and inside[turns].all())


def too_large(chain: ClosedChain) -> str:
    """What is wrong with an object that no such arms hold; empty if nothing is."""
    longest = max(chain.held.size)
    if longest <= LARGE * chain.reach:
        return ""
    return (
        f"found an edge of {longest:g} m, but the arms reach {chain.reach:.2g} m; "
        "lengths are metres"
    )


def far_hands(chain: ClosedChain) -> Iterator[str]:
    """A sentence on each hand that is fastened to an object which it does not touch."""
    model, X_WO = chain.model, chain.object_pose(chain.q_start)
    data, half = model.createData(), 0.5 * np.array(chain.held.size)
    pin.framesForwardKinematics(model, data, chain.q_start)
    for arm in chain.arms[: chain.holding]:
        if chain.grasps[arm.name].contact:
            continue
        p_OT = X_WO.actInv(data.oMf[model.getFrameId(arm.tip)]).translation
        away = float(np.linalg.norm(np.maximum(np.abs(p_OT) - half, 0.0)))
        if away > FAR_HAND:
            yield (
                f"the tip of {arm.name} is {1e3 * away:.0f} mm from the object's surface and holds "
                "it as if a rigid link joined them; see object.size, object_in_hand and the start"
            )


def far_goals(scenario: Scenario) -> Iterator[str]:
    """A sentence on each task whose goal is nowhere near."""
    chain = scenario.chain
    for phase in scenario.schedule:
        for task in phase.tasks:
            marks = asked(task.name, partial(task.marks, Moment(phase.duration)), [])
            far = max((_distance(mark, chain.start_position) for mark in marks), default=0.0)
            if far > FAR * chain.reach:
                yield (
                    f"the goal of '{task.name}' is {far:.3g} m from where the object starts, but "
                    f"the arms reach {chain.reach:.2g} m; lengths are metres"
                )


def far_inputs(scenario: Scenario) -> Iterator[str]:
    """A sentence on each input that is sent a place which is nowhere near."""
    chain = scenario.chain
    for name, kind in scenario.followed().items():
        if kind not in (POINT, POSE):
            continue
        places = _sent(scenario.inputs[name], kind, scenario.duration)
        far = max((float(np.linalg.norm(p - chain.start_position)) for p in places), default=0.0)
        if far > FAR * chain.reach:
            yield (
                f"the input '{name}' is sent a place {far:.3g} m from where the object starts, but "
                f"the arms reach {chain.reach:.2g} m; lengths are metres"
            )


def _sent(settings: InputSettings, kind: Kind, duration: float) -> Iterator[Array]:
    """Places that are sent in a comparison, some of a signal's and all of a file's."""
    if settings.feed_file is not None:
        yield from read_table(settings.feed_file).take(POINT.columns)
    elif settings.feed is not None:
        course = settings.feed.bind(kind, Moment(), None)
        for t in np.linspace(0.0, duration, LOOKS).tolist():
            course.update(Moment(t))
            yield course.value[:3].copy()


def _distance(mark: Mark, p: Array) -> float:
    """How far a point is from what a mark shows [m]; 0 where that has no place."""
    match mark:
        case PointMark():
            return float(np.linalg.norm(mark.at - p))
        case PoseMark() if mark.position is not None:
            return float(np.linalg.norm(mark.position - p))
        case PlaneMark():
            return abs(float(mark.normal @ (mark.through - p)))
        case LineMark() if mark.through is not None:
            return float(np.linalg.norm(np.cross(mark.direction, mark.through - p)))
        case SphereMark() | CircleMark():
            return abs(float(np.linalg.norm(mark.center - p)) - mark.radius)
    return 0.0
