"""Robots by name."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from chains import held
from scenario_files import needs_robots

from coopqp.base.errors import MissingDependencyError, UnknownNameError
from coopqp.execution.controller_run import run
from coopqp.robot import Robot
from coopqp.robots import ExampleRobot, Several, example_robot
from coopqp.scenario.loader import load
from coopqp.tasks import PointOnPoint

BAXTER = {"right": "right_gripper", "left": "left_gripper"}
TIAGO = {"right": "arm_right_tool_link", "left": "arm_left_tool_link"}
PR2 = {"right": "r_gripper_tool_frame", "left": "l_gripper_tool_frame"}


@needs_robots
def test_baxter_has_two_arms_of_seven_joints() -> None:
    robot = ExampleRobot(name="baxter", arms=BAXTER).build()
    assert [len(robot.arm_joints(arm)) for arm in robot.arms] == [7, 7]
    assert "head_pan" not in robot.joint_names
    assert robot.model.nq == 14
    assert not robot.warnings
    assert len(robot.shapes) > 20
    for shape in robot.shapes:
        assert robot.model.existFrame(shape.frame)
        assert shape.mesh is None or shape.mesh.is_file()
    assert np.isfinite(robot.model.velocityLimit).all()


@needs_robots
def test_what_is_done_to_a_robot_is_not_done_to_the_next() -> None:
    """All its joints move, so that nothing has to be left out of what was read."""
    ur5 = ExampleRobot(name="ur5_robot", arms={"arm": "tool0"})
    robot = ur5.build()
    slow = 0.1 * robot.model.velocityLimit
    robot.model.velocityLimit, robot.model.names[1] = slow, "mine"
    assert (ur5.build().model.velocityLimit > slow).all()
    assert "mine" not in ur5.build().joint_names


@needs_robots
def test_a_shared_torso_moves_both_arms(rng: np.random.Generator) -> None:
    robot = ExampleRobot(name="tiago_dual", arms=TIAGO).build()
    assert robot.joint_names[0] == "torso_lift_joint"
    assert robot.model.nq == 15
    chain = held(robot)
    torso = chain.joint_names.index("torso_lift_joint")
    for q in chain.sample(rng, 5):
        up = [0.0, 0.0, 1.0, 0.0, 0.0, 0.0]
        np.testing.assert_allclose(chain.object_jacobians(q)[:, :, torso], [up, up], atol=1e-12)
        # It moves both hands alike, so that no loop opens.
        np.testing.assert_allclose(chain.loop_jacobian(q)[:, torso], 0.0, atol=1e-12)
    locked = ExampleRobot(name="tiago_dual", arms=TIAGO, locked={"torso_lift_joint": 0.3}).build()
    assert locked.joint_names == robot.joint_names[1:]


@needs_robots
def test_a_locked_joint_stays_at_its_value() -> None:
    heights = []
    for lift in (0.0, 0.3):
        robot = ExampleRobot(
            name="tiago_dual", arms=TIAGO, locked={"torso_lift_joint": lift}
        ).build()
        data = robot.model.createData()
        pin.framesForwardKinematics(robot.model, data, robot.configuration({}))
        heights.append(data.oMf[robot.model.getFrameId(TIAGO["left"])].translation[2])
    assert heights[1] - heights[0] == pytest.approx(0.3, abs=1e-12)


@needs_robots
def test_joints_that_turn_without_end_have_one_coordinate(rng: np.random.Generator) -> None:
    path = example_robot.robots()["pr2"]
    whole = pin.buildModelFromUrdf(str(path))
    robot = ExampleRobot(name="pr2", arms=PR2).build()
    roll = robot.joint_names.index("l_wrist_roll_joint")
    assert robot.model.nq == robot.model.nv == 15
    assert robot.model.lowerPositionLimit[roll] == -np.inf
    assert robot.model.velocityLimit[roll] == pytest.approx(3.6)
    q = rng.uniform(-0.3, 0.3, 15)
    q_whole = pin.neutral(whole)
    for name, value in zip(robot.joint_names, q, strict=True):
        joint = whole.joints[whole.getJointId(name)]
        both = [math.cos(value), math.sin(value)] if joint.nq == 2 else [value]
        q_whole[joint.idx_q : joint.idx_q + joint.nq] = both
    mine, theirs = robot.model.createData(), whole.createData()
    pin.framesForwardKinematics(robot.model, mine, q)
    pin.framesForwardKinematics(whole, theirs, q_whole)
    for tip in PR2.values():
        found, wanted = robot.model.getFrameId(tip), whole.getFrameId(tip)
        np.testing.assert_allclose(
            mine.oMf[found].homogeneous, theirs.oMf[wanted].homogeneous, atol=1e-12
        )
    assert pin.computeTotalMass(robot.model) <= pin.computeTotalMass(whole)
    at = [whole.joints[whole.getJointId(name)].idx_v for name in robot.joint_names]
    M = pin.crba(whole, theirs, q_whole)
    M = np.triu(M) + np.triu(M, 1).T
    found = pin.crba(robot.model, mine, q)
    found = np.triu(found) + np.triu(found, 1).T
    np.testing.assert_allclose(found, M[np.ix_(at, at)], atol=1e-10)


@needs_robots
def test_two_pandas_hold_one_object() -> None:
    pair = panda_pair().build()
    assert [arm.name for arm in pair.arms] == ["left/arm", "right/arm"]
    assert pair.joint_names[7] == "right/panda_joint1"
    q = pair.configuration({"left/arm": PANDA_BENT, "right/arm": PANDA_BENT})
    chain = held(pair, q)
    assert chain.loops.rank == 6


BAXTER_BENT = [-0.4, -0.6, 0.0, 1.3, 0.0, 0.8, 0.0]  # right arm, forward and down
PANDA_BENT = [0.0, 0.3, 0.0, -1.8, 0.0, 2.1, 0.8]


def panda_pair() -> Several:
    panda = ExampleRobot(name="panda", arms={"arm": "panda_hand_tcp"})
    return Several(
        robots={
            "left": {"robot": panda, "position": (0.0, 0.4, 0.0)},
            "right": {"robot": panda, "position": (0.0, -0.4, 0.0)},
        }
    )


def baxter_pose() -> dict[str, list[float]]:
    mirror = np.array([-1, 1, -1, 1, -1, 1, -1])
    return {"right": BAXTER_BENT, "left": list(mirror * BAXTER_BENT)}


@needs_robots
@pytest.mark.parametrize(
    ("robot", "start"),
    [
        (ExampleRobot(name="baxter", arms=BAXTER), baxter_pose()),
        (panda_pair(), {"left/arm": PANDA_BENT, "right/arm": PANDA_BENT}),
    ],
    ids=["baxter", "two_pandas"],
)
def test_the_object_is_carried_by_robots_from_the_package(
    robot: Robot, start: dict[str, list[float]]
) -> None:
    scenario = replace(load("point_on_point"), robot=robot, start=start, duration=2.5)
    goal = scenario.chain.start_position + np.array([0.03, 0.02, 0.05])
    scenario = replace(scenario, tasks=(PointOnPoint(name="lift", goal=tuple(goal), gain=5.0),))
    trace = run(scenario, controller="qp")
    assert not trace.failures
    assert np.linalg.norm(trace.position[-1] - goal) < 1e-3
    assert trace.loop_position.max() < 1e-4


@needs_robots
@pytest.mark.parametrize(
    ("name", "arms"),
    [
        ("talos_full_v2", {"right": "gripper_right_base_link", "left": "gripper_left_base_link"}),
        ("romeo", {"right": "r_gripper", "left": "l_gripper"}),
        ("icub", {"right": "r_hand", "left": "l_hand"}),
        ("g1_29dof_rev_1_0", {"right": "right_rubber_hand", "left": "left_rubber_hand"}),
    ],
)
def test_humanoids_load_with_their_torso_joints(name: str, arms: dict[str, str]) -> None:
    robot = ExampleRobot(name=name, arms=arms).build()
    right, left = (set(robot.arm_joints(arm)) for arm in robot.arms)
    assert right & left, "the torso moves both arms"
    assert right - left
    assert left - right
    assert (robot.model.velocityLimit > 0.0).all()


@needs_robots
def test_an_unknown_example_robot_is_refused() -> None:
    with pytest.raises(UnknownNameError, match="unknown example robot 'baxtre'; did you mean 'b"):
        ExampleRobot(name="baxtre", arms=BAXTER).build()


def test_the_missing_package_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(example_robot, "PACKAGE", "no-such-package-here")
    with pytest.raises(MissingDependencyError, match=r"pip install 'coopqp\[robots\]'"):
        ExampleRobot(name="baxter", arms=BAXTER).build()
