"""Where the object is, its goals and references: against the trace and closed forms."""

from __future__ import annotations

import html
from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from numpy.typing import NDArray
from scenario_files import cut
from scipy.spatial.transform import Rotation, Slerp

import coopqp
from coopqp.base.spec import Pose as PoseValue
from coopqp.execution.comparison import Comparison
from coopqp.model import marker
from coopqp.model.marker import Marker
from coopqp.model.profile import Profile
from coopqp.report.curves import Chart, Figure
from coopqp.report.figures.object import Coordinate, Tilt, object_figures, targets
from coopqp.scenario.loader import load
from coopqp.tasks import PointOnPlane, PointOnPoint, Pose

Array = NDArray[np.float64]

AT = (0.17, 0.01, 0.06)
RPY = (0.2, -0.1, 0.3)
POINT = (0.03, -0.02, 0.05)


@pytest.fixture(scope="module")
def comparison() -> Comparison:
    return coopqp.compare(load("point_on_point"), controllers=["qp", "pseudoinverse"])


def line(figure: Figure, name: str) -> tuple[Array, Array]:
    (found,) = (data for data in figure.data if html.unescape(data.get("name", "")) == name)
    return np.array(found["x"], float), np.array(found["y"], float)


def quintic(t: Array, duration: float) -> Array:
    x = np.clip(t / duration, 0.0, 1.0)
    share: Array = 6 * x**5 - 15 * x**4 + 10 * x**3
    return share


def test_figures_show_the_trace_the_goal_and_the_reference(comparison: Comparison) -> None:
    (task,) = comparison.scenario.tasks
    assert isinstance(task, PointOnPoint)
    figures, others = object_figures(Chart(comparison))
    assert not others
    for i, figure in enumerate(figures[:3]):
        assert figure.title == f"{'xyz'[i]} of the object"
        for name, trace in comparison.traces.items():
            t, y = line(figure, name)
            np.testing.assert_allclose(t, trace.t, atol=1e-7)
            np.testing.assert_allclose(y, trace.position[:, i], rtol=1e-6, atol=1e-9)
        assert set(line(figure, "goal of 'reach'")[1]) == {task.goal[i]}
        t, y = line(figure, "reference of 'reach'")
        start = comparison.traces["qp"].position[0, i]
        expected = start + quintic(t, task.profile.duration) * (task.goal[i] - start)
        np.testing.assert_allclose(y, expected, rtol=1e-5, atol=1e-8)


def test_the_references_are_as_far_away_as_the_recorded_error_says(comparison: Comparison) -> None:
    chart = Chart(comparison)
    for name, trace in comparison.traces.items():
        off = []
        for i in range(3):
            (target,) = targets(chart, Coordinate(axis=i))
            rows = np.searchsorted(trace.t, target.t)
            np.testing.assert_array_equal(trace.t[rows], target.t)
            off.append(trace.position[rows, i] - target.references[name])
        expected = trace.task_error[rows, 0]
        np.testing.assert_allclose(np.linalg.norm(off, axis=0), expected, atol=1e-12)


def test_a_reference_turns_as_slerp_does_and_the_tilt_with_it() -> None:
    pose = Pose(name="carry", goal=PoseValue(position=AT, rpy=RPY), profile=Profile(duration=0.25))
    scenario = replace(cut(load("point_on_point"), 30), tasks=(pose,), secondary=())
    comparison = coopqp.compare(scenario, controllers=["qp"])
    (target,) = targets(Chart(comparison), Tilt())
    trace = comparison.traces["qp"]
    ends = Rotation.concatenate(
        [Rotation.from_matrix(trace.rotation[0]), Rotation.from_euler("xyz", RPY)]
    )
    between = Slerp([0, 1], ends)(quintic(target.t, 0.25)).as_matrix()
    expected = np.degrees(np.arccos(np.clip(between[:, 2, 2], -1, 1)))
    np.testing.assert_allclose(target.references["qp"], expected, atol=1e-5)
    assert target.goal == pytest.approx(expected[-1], abs=1e-6)


def test_tilt_is_the_angle_to_the_vertical(rng: np.random.Generator) -> None:
    R = np.array([pin.exp3(turn) for turn in rng.normal(size=(50, 3))])
    angles = np.degrees(np.arccos(R[:, 2, 2]))
    np.testing.assert_allclose(Tilt().of(np.zeros((50, 3)), R), angles, atol=1e-6)
    small = pin.exp3(np.array([1e-9, 0.0, 0.5]))
    assert Tilt().of(np.zeros((1, 3)), small[None])[0] == pytest.approx(np.degrees(1e-9), rel=0.1)


#: A mark, and the coordinates x, y, z that it fixes.
FIXED: dict[str, tuple[Marker, tuple[Any, Any, Any]]] = {
    "point": (marker.PointMarker(at=AT), AT),
    "pose": (marker.PoseMarker(rotation=np.eye(3), position=AT), AT),
    "orientation": (marker.PoseMarker(rotation=np.eye(3)), (None, None, None)),
    "level plane": (marker.PlaneMarker(normal=(0, 0, -2), through=AT), (None, None, 0.06)),
    "slanted plane": (marker.PlaneMarker(normal=(0, 1, 1), through=AT), (None, None, None)),
    "upright line": (marker.LineMarker(direction=(0, 0, 3), through=AT), (0.17, 0.01, None)),
    "line in a level plane": (
        marker.LineMarker(direction=(1, 1, 0), through=AT),
        (None, None, 0.06),
    ),
    "direction": (marker.LineMarker(direction=(0, 0, 1)), (None, None, None)),
    "level circle": (
        marker.CircleMarker(center=AT, normal=(0, 0, 1), radius=0.1),
        (None, None, 0.06),
    ),
}


@pytest.mark.parametrize("name", FIXED)
def test_a_mark_fixes_what_all_its_points_have_in_common(name: str) -> None:
    mark, expected = FIXED[name]
    for i, value in enumerate(expected):
        found = Coordinate(axis=i).goal([mark, marker.TrackedMarker()])
        assert np.isnan(found) if value is None else found == value


def test_a_goal_of_another_point_is_none_of_this_one() -> None:
    marks = [marker.PointMarker(at=AT), marker.TrackedMarker(point=POINT)]
    assert np.isnan(Coordinate(axis=0).goal(marks))
    assert Coordinate(axis=0, point=POINT).goal(marks) == AT[0]


def test_other_points_that_tasks_steer_have_figures_of_their_own() -> None:
    up = (0.0, 0.0, 0.02)
    tasks = (
        PointOnPlane(name="corner", normal=(0, 0, 1), through=AT, point=POINT, velocity=up),
        PointOnPoint(name="middle", goal=AT),
    )
    scenario = replace(cut(load("point_on_point"), 30), tasks=tasks, secondary=())
    comparison = coopqp.compare(scenario, controllers=["qp"])
    shown, others = object_figures(Chart(comparison))
    assert [figure.title for figure in shown[:1]] == ["x of the object"]
    assert len(others) == 3
    trace = comparison.traces["qp"]
    _, z = line(others[2], "qp")
    corner = trace.position + trace.rotation @ np.array(POINT)
    np.testing.assert_allclose(z, corner[:, 2], rtol=1e-6)
    t, goal = line(others[2], "goal of 'corner'")
    np.testing.assert_allclose(goal, 0.06 + 0.02 * t, rtol=1e-6)
    assert not any("corner" in data.get("name", "") for data in others[0].data)
