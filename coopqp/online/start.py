"""A scenario that begins where the robot is, the object held as its hands hold it there.

A scenario says where the object is in the hands by ``object_in_hand`` or ``object.pose``, for its
own start. The hands of the robot are not quite there: links, encoders and grasp are some
millimetres off. The object is then where the hands have it in the mean, and each hand holds it
there. Where the scenario says nothing, each hand holds it midway between the hands, as ever.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pinocchio as pin

from coopqp.checked import Array, Pose, finite, vector
from coopqp.closed_chain import ClosedChain
from coopqp.errors import GraspError
from coopqp.grasp import Grasp
from coopqp.hold import grasp_of_each
from coopqp.loop_observer import MOST_ORIENTATION, MOST_POSITION
from coopqp.scenario.scenario import Scenario
from coopqp.state import State

#: Numbers of a scenario file are at least so large, or zero.
LEAST = 1e-30


def as_held(scenario: Scenario, q: Array) -> Scenario:
    """The scenario with its start where the robot is, and the grasp as it is held there.

    Raises:
        GraspError: the hands are so far from how the scenario says they hold the object that it
            cannot be the model's error.
        InvalidValueError: q is no n finite numbers.
    """
    chain = scenario.chain
    q = _plain(finite("q", vector("q", q, chain.n)))
    start = dict(zip(chain.joint_names, q.tolist(), strict=True))
    grasps = grasp_of_each(scenario.robot_model, scenario.grasps)
    holders = chain.hold.holders
    if scenario.held.pose is None and not any(grasps[arm].object_in_hand for arm in holders):
        return replace(scenario, start=start)
    _check(chain, q)
    held = replace(scenario.held, pose=_pose(chain.object_pose(q)))
    return replace(scenario, start=start, held=held, grasps=without_places(grasps, holders))


def without_places(grasps: Mapping[str, Grasp], holders: tuple[str, ...]) -> dict[str, Grasp]:
    """The grasps, those of holding arms without where the object is in the hand."""
    return {
        arm: replace(grasp, object_in_hand=None) if arm in holders else grasp
        for arm, grasp in grasps.items()
    }


def _plain(numbers: Array) -> Array:
    return np.where(np.abs(numbers) < LEAST, 0.0, numbers)


def _pose(X: pin.SE3) -> Pose:
    place, angles = _plain(X.translation), _plain(pin.rpy.matrixToRpy(X.rotation))
    return Pose(position=tuple(place.tolist()), rpy=tuple(angles.tolist()))


def _check(chain: ClosedChain, q: Array) -> None:
    state = State(chain, q)
    apart, turned = state.loop_position_error, state.loop_orientation_error
    if apart > MOST_POSITION or turned > MOST_ORIENTATION:
        raise GraspError(
            f"the hands are {1e3 * apart:.0f} mm and {1e3 * turned:.0f} mrad from how the scenario "
            "says they hold the object, more than a model's error; bring the robot near the "
            "scenario's start, or leave out object_in_hand and object.pose to hold it as it is"
        )
