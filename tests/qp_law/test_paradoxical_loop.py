"""Bennett's linkage: four hinges that move on one path, although their rows say that they cannot.

Twists alpha, beta and lengths a, b with a / sin(alpha) = b / sin(beta), opposite links alike.
"""

from __future__ import annotations

import math
from collections import Counter

import numpy as np
import pinocchio as pin
import pytest
from laws import problem, ticks
from scipy.optimize import least_squares

from coopqp.base.spec import Array
from coopqp.controllers import QPController
from coopqp.grasps import Rigid
from coopqp.limits import JointPosition, JointVelocity
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.grasp_configuration import HeldObject
from coopqp.robot import Arm, RobotModel
from coopqp.tasks import PointOnPoint

LENGTH, OTHER, TWIST = 0.3, 0.4, math.radians(40.0)


def link(length: float, twist: float) -> pin.SE3:
    turned = pin.SE3(pin.utils.rotate("x", twist), np.zeros(3))
    return pin.SE3(np.eye(3), np.array([length, 0.0, 0.0])) * turned


def bennett() -> RobotModel:
    """Two arms of two joints from the base to the link that they hold together."""
    short = link(LENGTH, TWIST)
    long = link(OTHER, math.asin(OTHER * math.sin(TWIST) / LENGTH))
    model, one = pin.Model(), np.ones(1)

    def hinge(parent: int, place: pin.SE3, name: str) -> int:
        joint = pin.JointModelRZ()
        return int(model.addJoint(parent, joint, place, name, 50 * one, 2 * one, -3 * one, 3 * one))

    second = hinge(hinge(0, pin.SE3.Identity(), "a1"), short, "a2")
    model.addFrame(pin.Frame("tip_a", second, long, pin.FrameType.OP_FRAME))
    third = hinge(hinge(0, long.inverse(), "b1"), short.inverse(), "b2")
    model.addFrame(pin.Frame("tip_b", third, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
    arms = (Arm(name="a", tip="tip_a"), Arm(name="b", tip="tip_b"))
    return RobotModel(name="bennett", model=model, arms=arms)


def gap(robot: RobotModel, q: Array) -> Array:
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, q)
    a, b = (data.oMf[robot.model.getFrameId(arm.tip)] for arm in robot.arms)
    return np.asarray(pin.log6(a.actInv(b)).vector, float)


def on_the_path(robot: RobotModel, q: Array, first: float) -> Array:
    """The closed configuration near q with the first joint where it is wanted."""
    found = least_squares(
        lambda x: np.append(gap(robot, x), x[0] - first), q, xtol=1e-15, ftol=1e-15, gtol=1e-15
    )
    assert np.abs(found.fun).max() < 1e-10
    return np.asarray(found.x, float)


@pytest.fixture(scope="module")
def robot() -> RobotModel:
    return bennett()


@pytest.fixture(scope="module")
def q(robot: RobotModel) -> Array:
    return on_the_path(robot, np.array([2.22, 2.31, 2.31, 2.22]), 2.22)


def test_the_rank_is_that_of_the_closed_linkage(robot: RobotModel, q: Array) -> None:
    chain = ClosedChain.attach(robot, q, Rigid(), HeldObject())
    assert chain.loops.rank == 3
    sizes = np.linalg.svd(chain.loop_jacobian(q))[1]
    assert sizes[3] < 1e-9 < sizes[2]


@pytest.mark.parametrize("kappa", [100.0, 0.0])
def test_the_linkage_moves_along_its_path(robot: RobotModel, q: Array, kappa: float) -> None:
    goal_q = q
    for first in np.linspace(q[0], q[0] + 0.4, 9)[1:]:
        goal_q = on_the_path(robot, goal_q, float(first))
    chain = ClosedChain.attach(robot, q, Rigid(), HeldObject())
    x, y, z = chain.object_pose(goal_q).translation.tolist()
    reach = PointOnPoint(name="reach", goal=(x, y, z))
    law = QPController().build(
        problem(chain, reach, limits=(JointPosition(), JointVelocity()), kappa=kappa)
    )
    state = law.start()
    statuses = Counter(command.status.name for command in ticks(law, state, 300))
    assert set(statuses) <= {"OPTIMAL", "INACCURATE"}
    assert np.linalg.norm(state.p_WO - reach.goal) < reach.tolerance  # open by 0.3 mm at kappa 0
    assert state.loop_position_error < 1e-3
    assert np.abs(gap(robot, state.q)).max() < 1e-3
