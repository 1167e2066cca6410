"""Goals that move with the robot are drawn where forward kinematics has them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from scenario_files import HEAD, PHASES, TAIL, phased

import coopqp
from coopqp.base.spec import Pose as PoseValue
from coopqp.execution.comparison import Comparison
from coopqp.grasp import pose_matrix
from coopqp.model.marker import PostureMarker, RelativeMarker
from coopqp.model.state import State
from coopqp.report.scene.playback import scene
from coopqp.scenario.loader import load
from coopqp.signal import Moment
from coopqp.task import TaskStack
from coopqp.tasks import Posture, RelativeMotion

RIGHT = [0.6, -0.1, 1.1, 0.8, 0.0]
ROUNDED = 1e-4  # m: what the page rounds to

MEET = """\
  - name: meet
    duration: 0.3
    released: [left]
    tasks:
      - relative_motion: {name: meet, goal: {position: [0, 0.03, 0], rpy: [0.1, 0.2, 0.3]},
                          gain: 5, profile: {duration: 0.2}}
"""


def compared(task: Posture) -> tuple[Comparison, Any]:
    scenario = replace(load("point_on_point"), tasks=(task,), duration=0.3, secondary=())
    comparison = coopqp.compare(scenario, controllers=["qp"])
    return comparison, scene(comparison)["controllers"][0]


def test_a_posture_is_drawn_as_the_arm_stands_in_it() -> None:
    comparison, run = compared(Posture(goal={"right": RIGHT}))
    (shown,) = run["postures"]  # the left arm has no goal
    robot = comparison.scenario.chain.robot
    data, q = robot.model.createData(), pin.neutral(robot.model)
    joints = robot.arm_joints(robot.arms[0])
    q[[robot.joint_names.index(name) for name in joints]] = RIGHT
    pin.framesForwardKinematics(robot.model, data, q)
    expected = [data.oMi[robot.model.getJointId(name)].translation for name in joints]
    expected.append(data.oMf[robot.model.getFrameId(robot.arms[0].tip)].translation)
    points = np.array(shown["points"])
    np.testing.assert_allclose(points, np.tile(expected, (len(points), 1, 1)), atol=ROUNDED)


def test_joints_without_a_goal_are_drawn_where_they_are() -> None:
    """An elbow's goal moves the hand alone: up to the elbow the arm is as the law has it."""
    _, run = compared(Posture(goal={"RElbowRoll": 1.5}))
    (shown,), arm = run["postures"], run["arms"][0]
    asked, own = np.array(shown["points"]), np.array(arm["points"])
    np.testing.assert_allclose(asked[:, :4], own[:, :4], atol=ROUNDED)
    assert np.linalg.norm(asked[0, -1] - own[0, -1]) > 0.02


def test_a_posture_given_as_numbers_of_all_joints_shows_all_arms() -> None:
    _, run = compared(Posture(goal=load("point_on_point").chain.q_start.tolist()))
    assert len(run["postures"]) == 2
    (mark,) = Posture(goal={"right": RIGHT}).marks(Moment(0.3))
    assert isinstance(mark, PostureMarker)


def test_a_relative_goal_is_as_far_from_the_second_hand_as_the_error_says(tmp_path: Path) -> None:
    """Its axes stand where the second arm's object frame shall be, whatever the first does."""
    scenario = phased(tmp_path, HEAD + PHASES.split("  - name: alone")[0] + MEET + TAIL)
    comparison = coopqp.compare(scenario)
    trace, drawn = comparison.traces["qp"], scene(comparison)
    (run,) = drawn["controllers"]
    (shown,) = run["relatives"]
    rows = np.searchsorted(trace.t, np.array(drawn["t"])[shown["first"] : shown["last"] + 1] - 1e-6)
    chain = list(scenario.problems(lambda first: trace.q[first]))[1].chain
    task = scenario.schedule[1].tasks[0].at_goal()
    assert isinstance(task, RelativeMotion)
    state, data = State(chain), chain.model.createData()
    tasks = TaskStack([task], state)
    for k, at, axes in zip(rows, shown["at"], shown["axes"], strict=True):
        state.t, state.q[:] = 0.2, trace.q[k]
        state.update()
        tasks.update(state)
        pin.framesForwardKinematics(chain.model, data, trace.q[k])
        second = data.oMf[chain.frames[1]]
        far = np.linalg.norm(np.array(at) - second.translation)
        assert abs(far - np.linalg.norm(tasks.e[:3])) < 2 * ROUNDED
        R = np.array(axes).T / np.linalg.norm(axes, axis=1)
        turn = np.linalg.norm(pin.log3(R.T @ second.rotation))
        assert abs(turn - np.linalg.norm(tasks.e[3:])) < 5e-3
    assert far < 1e-3, "it has got there"


def test_a_relative_mark_has_the_goal() -> None:
    goal = PoseValue(position=(0.0, 0.03, 0.0), rpy=(0.1, 0.2, 0.3))
    (mark,) = RelativeMotion(goal=goal).marks(Moment(1.0))
    assert isinstance(mark, RelativeMarker)
    np.testing.assert_array_equal(mark.position, goal.position)
    np.testing.assert_allclose(mark.rotation, pose_matrix(goal).rotation)
