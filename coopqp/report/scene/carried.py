"""What marks show that move with the robot, and so differ between controllers.

Letters: f frames in which a mark is seen.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from coopqp.checked import Array
from coopqp.closed_chain import ClosedChain
from coopqp.instants import arm_points
from coopqp.report.scene.marks import POSTURE, RELATIVE, TRACKED, Shown, short
from coopqp.scenario.scenario import Scenario
from coopqp.tasks.posture import posture
from coopqp.trace import Trace

Json = dict[str, Any]


def carried(
    marks: Sequence[Shown], scenario: Scenario, trace: Trace, frames: NDArray[np.int64]
) -> dict[str, list[Json]]:
    """By kind, for ``playback.js``."""
    found: dict[str, list[Json]] = {"tracked": [], "postures": [], "relatives": []}
    for mark in marks:
        own = frames[mark.first : mark.last + 1]
        if mark.kind == TRACKED:
            found["tracked"].append(mark.frames | {"points": _way(trace, mark, own)})
        elif mark.kind == POSTURE:
            arms = _posture(scenario, trace, mark, own)
            found["postures"] += [mark.frames | {"points": points} for points in arms]
        elif mark.kind == RELATIVE:
            found["relatives"].append(mark.frames | _relative(scenario, trace, mark, own))
    return found


def _way(trace: Trace, mark: Shown, own: NDArray[np.int64]) -> Any:
    """Of the point of the object that a task steers, f points."""
    turned = np.einsum("fij,fj->fi", trace.rotation[own], mark.stacked("point"))
    return short(trace.position[own] + turned)


def _posture(scenario: Scenario, trace: Trace, mark: Shown, own: NDArray[np.int64]) -> list[Any]:
    """Of each arm with a joint that has a goal, f times its joints and its hand."""
    chain = scenario.chain
    goals = np.array([posture(values["goal"], chain) for values in mark.values])
    asked = {
        name: values
        for name, values in zip(chain.joint_names, goals.T, strict=True)
        if np.isfinite(values).all()
    }
    q = trace.q[own].copy()
    for name, values in asked.items():
        q[:, trace.joints.index(name)] = values
    points = arm_points(chain, q)
    return [
        short(points[arm.name])
        for arm in chain.arms
        if set(asked) & set(chain.robot.arm_joints(arm))
    ]


def _relative(scenario: Scenario, trace: Trace, mark: Shown, own: NDArray[np.int64]) -> Json:
    """Origin and axes in the world, f each."""
    problems = list(scenario.problems(lambda first: np.asarray(trace.commanded[first])))
    phase = int(np.searchsorted(scenario.first_ticks, own[0], side="right")) - 1
    first = _object_of_first_arm(problems[phase].chain, trace.q[own])
    at, axes = mark.stacked("at"), mark.stacked("axes")
    return {
        "at": short(np.array([X.act(p) for X, p in zip(first, at, strict=True)])),
        "axes": short(np.array([A @ X.rotation.T for X, A in zip(first, axes, strict=True)])),
    }


def _object_of_first_arm(chain: ClosedChain, q: Array) -> list[pin.SE3]:
    """The object's pose as the first arm carries it."""
    data, poses = chain.model.createData(), []
    for row in q:
        pin.framesForwardKinematics(chain.model, data, row)
        poses.append(data.oMf[chain.frames[0]].copy())
    return poses
