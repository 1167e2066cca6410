"""The error to the goal is that of the goal's own definition, wherever the reference is."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scenario_files import phased
from scipy.spatial.transform import Rotation

import coopqp
from coopqp.base.spec import Pose as PoseValue
from coopqp.execution.comparison import summarize
from coopqp.execution.controller_run import run
from coopqp.model.profile import Profile
from coopqp.report.curves import Chart
from coopqp.report.figures.groups import task_errors
from coopqp.scenario.loader import load
from coopqp.task import Task
from coopqp.tasks import JointCentering, PointOnPlane, Pose, Posture, Twist
from coopqp.trace import Trace

SLOW = Profile(duration=0.5)
RPY = (0.2, -0.1, 0.3)
POINT = (0.03, -0.02, 0.05)


def traced(*tasks: Task, ticks: int = 60) -> Trace:
    scenario = load("point_on_point")
    short = replace(scenario, tasks=tasks, duration=ticks * scenario.dt, secondary=())
    return run(short, controller="qp")


def test_of_a_pose_it_is_the_distance_and_the_angle_to_the_goal() -> None:
    goal = PoseValue(position=(0.17, 0.01, 0.06), rpy=RPY)
    trace = traced(Pose(goal=goal, profile=SLOW))
    far = np.linalg.norm(trace.position - goal.position, axis=1)
    turn = Rotation.from_euler("xyz", RPY) * Rotation.from_matrix(trace.rotation).inv()
    np.testing.assert_allclose(trace.goal_error[:, 0], far, atol=1e-14)
    np.testing.assert_allclose(trace.goal_error[:, 1], turn.magnitude(), atol=1e-12)
    assert trace.task_error[0] == pytest.approx(0.0, abs=1e-12), "the reference sets out from here"
    assert trace.goal_error[0, 0] > 0.01


def test_of_a_moving_plane_it_is_the_height_above_where_the_plane_then_is() -> None:
    normal, velocity = np.array([0.0, 0.6, 0.8]), np.array([0.01, 0.0, 0.05])
    task = PointOnPlane(
        normal=(0, 3, 4),
        through=(0.2, 0, 0.02),
        velocity=tuple(velocity),
        point=POINT,
        profile=SLOW,
    )
    trace = traced(task)
    p = trace.position + trace.rotation @ np.array(POINT)
    through = np.array([0.2, 0, 0.02]) + trace.t[:, None] * velocity
    expected = np.abs((p - through) @ normal)
    np.testing.assert_allclose(trace.goal_error[:, 0], expected, atol=1e-14)


def test_of_joints_it_is_their_distance() -> None:
    right = [0.6, -0.1, 1.1, 0.8, 0.0]
    trace = traced(Posture(goal={"right": right}, profile=SLOW))
    columns = [trace.joints.index(name) for name in load("point_on_point").chain.joint_names[:5]]
    far = np.linalg.norm(trace.q[:, columns] - right, axis=1)
    np.testing.assert_allclose(trace.goal_error[:, 0], far, atol=1e-14)


def test_both_errors_are_one_when_the_reference_has_arrived() -> None:
    trace = traced(Pose(goal=PoseValue(position=(0.17, 0.01, 0.06), rpy=RPY), profile=SLOW))
    arrived = trace.t >= 0.5 - 1e-9
    assert arrived.sum() > 5
    np.testing.assert_allclose(
        trace.goal_error[arrived], trace.task_error[arrived], rtol=1e-9, atol=1e-15
    )


def test_of_a_velocity_it_is_what_is_missing_to_the_full_velocity() -> None:
    trace = traced(Twist(velocity={"x": 0.02, "y": 0.0, "z": 0.0}, profile=SLOW), ticks=30)
    speed = np.diff(trace.position, axis=0) / trace.dt
    missing = np.linalg.norm(speed - [0.02, 0.0, 0.0], axis=1)
    np.testing.assert_allclose(trace.goal_error[1:, 0], missing, atol=2e-4)
    assert trace.task_error[1, 0] < 1e-6 < 0.01 < trace.goal_error[1, 0]


def test_a_task_whose_reference_stands_has_one_error() -> None:
    task = JointCentering()
    assert task.at_goal() is task
    assert task.way is None
    trace = traced(task, ticks=5)
    np.testing.assert_array_equal(trace.goal_error, trace.task_error)


def test_in_phases_it_is_known_while_its_phase_lasts(tmp_path: Path) -> None:
    trace = run(phased(tmp_path), controller="qp")
    np.testing.assert_array_equal(np.isnan(trace.goal_error), np.isnan(trace.task_error))
    goal = np.array([0.17, 0.01, 0.06])
    first = trace.tasks[0].rows
    expected = np.linalg.norm(trace.position[first] - goal, axis=1)
    np.testing.assert_allclose(trace.goal_error[first, 0], expected, atol=1e-14)


def test_missed_tasks_come_first_and_every_task_once(tmp_path: Path) -> None:
    scenario = phased(tmp_path)
    trace = run(scenario, controller="qp")

    def shown(trace: Trace) -> tuple[list[str], list[str]]:
        figures = task_errors(Chart(summarize(scenario, {"qp": trace})))
        return tuple([f.title.split("'")[1] for f in part] for part in figures)  # type: ignore[return-value]

    names = [task.name for task in trace.tasks]
    first, rest = shown(trace)
    assert (list(dict.fromkeys(first)), list(dict.fromkeys(rest))) == (names[:3], names[3:])
    missed = trace.goal_error.copy()
    missed[-1, 3] = np.nan  # the last task's end
    first, rest = shown(replace(trace, goal_error=missed))
    assert names[3] in first
    assert list(dict.fromkeys(rest)) == names[2:3]


def test_a_task_that_moves_has_two_figures_and_the_recorded_errors_in_millimetres() -> None:
    scenario = replace(load("point_on_point"), controllers={})
    comparison = coopqp.compare(scenario, controllers=["qp"])
    (goal, reference), rest = task_errors(Chart(comparison))
    trace = comparison.traces["qp"]
    assert not rest
    for figure, error in ((goal, trace.goal_error), (reference, trace.task_error)):
        (line,) = figure.data
        np.testing.assert_allclose(line["y"], 1e3 * np.maximum(error[:, 0], 1e-12), rtol=1e-6)


def test_controllers_with_other_tasks_are_drawn_where_they_have_them() -> None:
    scenario = load("point_on_point")
    posture = Posture(name="way", goal=scenario.chain.q_start)
    one, both = traced(*scenario.tasks), traced(posture, *scenario.tasks)
    name = scenario.tasks[0].name
    for traces in ({"qp": both, "pseudoinverse": one}, {"qp": one, "pseudoinverse": both}):
        first, _ = task_errors(Chart(summarize(scenario, traces)))
        drawn = {figure.title.split("'")[1]: figure.data for figure in first}
        assert (len(drawn["way"]), len(drawn[name])) == (1, 2)
