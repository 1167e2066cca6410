"""What every robot keeps: a model that pinocchio accepts, two arms, limits that mean something."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from example_robots import EXAMPLES
from scenario_files import HAS_ROBOTS

from coopqp.robot import RobotModel


@pytest.fixture(params=EXAMPLES)
def robot(request: pytest.FixtureRequest, tmp_path: Path) -> RobotModel:
    if request.param == "example_robot" and not HAS_ROBOTS:
        pytest.skip("needs coopqp[robots]")
    return EXAMPLES[request.param](tmp_path).build()


def test_its_model_has_one_coordinate_a_joint_and_frames_for_its_tips(robot: RobotModel) -> None:
    model = robot.model
    assert model.check(model.createData())
    assert model.nq == model.nv == len(robot.joint_names) == len(set(robot.joint_names))
    assert len(robot.arms) >= 2
    assert len({arm.name for arm in robot.arms}) == len(robot.arms)
    for arm in robot.arms:
        assert model.existFrame(arm.tip)
        assert robot.arm_joints(arm)


def test_its_limits_are_finite_and_leave_room(robot: RobotModel) -> None:
    model = robot.model
    ends = np.array([model.lowerPositionLimit, model.upperPositionLimit])
    assert np.isfinite(ends).all()
    assert (ends[0] < ends[1]).all()
    assert np.isfinite(model.velocityLimit).all()
    assert (model.velocityLimit > 0.0).all()
    assert (model.effortLimit > 0.0).all()  # or without limit
    assert not np.isnan(model.effortLimit).any()


def test_a_configuration_puts_each_arm_where_it_is_told(robot: RobotModel) -> None:
    arm = robot.arms[-1]
    joints = robot.arm_joints(arm)
    q = robot.configuration({arm.name: [0.01 * (k + 1) for k in range(len(joints))]})
    assert q.shape == (robot.model.nq,)
    np.testing.assert_allclose(np.sort(q[q != 0.0]), 0.01 * np.arange(1, len(joints) + 1))


def test_it_is_the_same_when_it_is_built_again(
    request: pytest.FixtureRequest, robot: RobotModel, tmp_path: Path
) -> None:
    name = request.node.callspec.params["robot"]
    again = EXAMPLES[name](tmp_path).build()
    assert again.joint_names == robot.joint_names
    assert again.model == robot.model
