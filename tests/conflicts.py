"""Situations in which not everything can hold."""

from __future__ import annotations

import numpy as np
import pytest
from chains import HANDS
from laws import NEAR, STEP

from coopqp.base.spec import Array
from coopqp.base.spec import Pose as PoseValue
from coopqp.controller import Law
from coopqp.grasp import Grasp
from coopqp.grasps import Revolute, Rigid
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.grasp_configuration import HeldObject
from coopqp.model.state import State
from coopqp.robot import RobotModel
from coopqp.tasks import PointOnPoint, Pose

#: Six rows, of which firm hands leave four.
TURN = Pose(
    name="turn",
    goal=PoseValue(position=(0.175, 0.008, 0.020), rpy_deg=(-9, 12, 0)),
    gain=10.0,
    profile=STEP,
    mode="hard",
)
#: NAO's joints that begin outside their limits [rad].
OUTSIDE: dict[str, dict[str, float]] = {
    "elbow": {"RElbowRoll": 1.64},
    "shoulder": {"LShoulderPitch": -2.2},
    "both elbows": {"RElbowRoll": 1.7, "LElbowRoll": -1.7},
    "both wrists": {"RWristYaw": 2.0, "LWristYaw": -2.0},
    "both shoulders": {"RShoulderRoll": 0.5, "LShoulderRoll": -0.5},
    "four joints": {"RElbowRoll": 1.7, "LElbowRoll": -1.65, "RShoulderRoll": 0.4, "RWristYaw": 2.0},
}
GRASPS: dict[str, Grasp] = {"rigid": Rigid(), "revolute": Revolute(point=(0.0, 0.0, -0.05))}
each_grasp = pytest.mark.parametrize("grasp", list(GRASPS))
REACH = PointOnPoint(name="reach", goal=NEAR, profile=STEP)


def slightly_open(chain: ClosedChain, gap: float) -> Array:
    """The start with the left hand moved by this much along all axes [m, rad]."""
    q = chain.q_start + np.linalg.pinv(State(chain).J_rel) @ np.full(6, gap)
    assert np.abs(State(chain, q).loop_error).max() > 0.5 * gap
    return q


def jerked(law: Law, speed: float) -> State:
    """One joint moves as the loop cannot, so that no speed within reach closes it."""
    state = law.start()
    state.v[3] = speed
    return state


def started_outside(nao: RobotModel, grasp: str, joints: dict[str, float]) -> ClosedChain:
    """Hands closed on the object while some joints are where they should not be."""
    q = np.asarray(nao.configuration(HANDS), float)
    for name, value in joints.items():
        q[nao.joint_names.index(name)] = value
    return ClosedChain.attach(nao, q, GRASPS[grasp], HeldObject())


def beyond(chain: ClosedChain, q: Array) -> Array:
    """How far each joint is outside its range [rad]."""
    return np.maximum(np.maximum(chain.lower - q, q - chain.upper), 0.0)
