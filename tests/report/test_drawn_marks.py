"""The playback draws the marks of tasks and limits, those of a user too, and nothing else."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import coopqp
import coopqp.tasks
from coopqp.base.spec import Pose as PoseValue
from coopqp.base.spec import spec
from coopqp.limits import Obstacle, Obstacles, Workspace
from coopqp.model import marker
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.marker import Marker
from coopqp.model.profile import Profile
from coopqp.model.state import State
from coopqp.report.page import render
from coopqp.report.scene.playback import scene
from coopqp.scenario.loader import load
from coopqp.signal import Instant
from coopqp.task import Evaluate, Task, TaskRows
from coopqp.tasks import (
    Orientation,
    Pointing,
    PointOnPlane,
    Pose,
)

Array = NDArray[np.float64]
Walk = Callable[[ClosedChain, int], list[Array]]

POINT, AXIS = (0.03, -0.02, 0.05), (2, -1, 0.5)  # of the object
AT, ALONG = (0.2, 0.01, 0.06), (1, -1, 3)  # in space

AT_ONCE = Profile(kind="step")
RPY = (0.3, -0.2, 0.5)


@spec
class Own(Task):
    """A user's task: shows a line, for a while a pose, and has fields that look like goals."""

    goal: tuple[float, float, float] = (9.0, 9.0, 9.0)
    """Not a place."""
    normal: tuple[float, float, float] = (1.0, 0.0, 0.0)
    """Not of a plane."""
    through: tuple[float, float, float] = (9.0, 9.0, 9.0)
    """Not a place."""
    wrong: bool = False
    """Whether it shows what is no mark."""

    def rows(self, chain: ClosedChain) -> tuple[str, ...]:
        return ("z",)

    def bind(self, start: State) -> Evaluate:
        def evaluate(state: State, rows: TaskRows) -> None:
            rows.J[0] = state.J_task[2]

        return evaluate

    def marks(self, at: Instant) -> tuple[Marker, ...]:
        if self.wrong:
            return (np.zeros(3),)  # type: ignore[return-value]
        line = marker.LineMarker(
            direction=np.array([0, 0, 1.0]), through=np.array([0.2 + at.t, 0, 0])
        )
        axes = marker.PoseMarker(rotation=np.eye(3), position=np.array([0.1, 0.0, 0.1]))
        return (line, marker.TrackedMarker(point=POINT), *([axes] if 0.095 < at.t < 0.205 else []))


def drawn(*tasks: Task, limits: tuple[coopqp.Limit, ...] = ()) -> Any:
    scenario = load("point_on_point")
    short = replace(
        scenario, tasks=tasks, duration=0.3, limits=(*scenario.limits, *limits), secondary=()
    )
    return scene(coopqp.compare(short, controllers=["qp"]))


def test_a_users_own_task_is_drawn_by_its_marks_and_by_nothing_else() -> None:
    found = drawn(Own(name="own"))
    assert not found["goals"]
    assert not found["planes"]
    (line,), (pose,) = found["lines"], found["poses"]
    ends = np.array(line["ends"])
    x = 0.2 + np.array(found["t"])
    np.testing.assert_allclose(ends[:, :, 0], np.stack([x, x], axis=1))
    assert (line["name"], line["first"], line["last"]) == ("own", 0, 30)
    assert (pose["first"], pose["last"], len(pose["at"])) == (10, 20, 11)
    (way,) = found["controllers"][0]["tracked"]
    R = np.reshape(found["controllers"][0]["rotation"], (-1, 3, 3))
    expected = np.array(found["controllers"][0]["position"]) + R @ np.array(POINT)
    np.testing.assert_allclose(way["points"], expected, atol=2e-4)


def test_what_is_no_mark_is_left_out_with_a_note() -> None:
    found = drawn(Own(name="own", wrong=True))
    (note,) = found["notes"]
    assert note.startswith("own.marks: ndarray among its marks, needs PointMarker")
    assert not found["lines"]


def test_the_plane_of_a_limit_is_drawn_near_the_object() -> None:
    wall = Workspace(normal=(0, 0, 1), through=(5.0, 5.0, -0.02))
    found = drawn(Own(name="own"), limits=(wall,))
    (plane,) = found["planes"]
    assert plane["limit"]
    assert (plane["name"], plane["first"], plane["last"]) == ("workspace", 0, 30)
    corners = np.array(plane["corners"])
    np.testing.assert_allclose(corners[:, :, 2], -0.02, atol=1e-4)
    middle, start = corners[0].mean(axis=0), found["controllers"][0]["position"][0]
    np.testing.assert_allclose(middle[:2], start[:2], atol=2e-4)


def test_a_far_plane_of_a_task_is_in_the_first_view() -> None:
    """And a wall as far away is not: it would make all else small."""
    far = (0.0, 0.0, 3.0)
    plane = PointOnPlane(name="up", normal=(0, 0, 1), through=far)
    wall = Workspace(normal=(0, 0, -1), through=far)
    assert drawn(plane)["view"]["high"][2] == pytest.approx(3.0)
    assert drawn(Own(name="own"), limits=(wall,))["view"]["high"][2] < 1.0


def test_the_goal_of_a_pose_is_drawn_as_axes() -> None:
    found = drawn(Pose(name="carry", goal=PoseValue(position=AT, rpy=RPY), profile=AT_ONCE))
    (pose,) = found["poses"]
    np.testing.assert_allclose(pose["at"], 31 * [AT], atol=1e-4)
    axes = np.array(pose["axes"][0])
    size = np.linalg.norm(axes[0])
    roll, pitch, yaw = RPY
    turn = {
        axis: [[math.cos(s), -math.sin(s)], [math.sin(s), math.cos(s)]]
        for axis, s in (("x", roll), ("y", -pitch), ("z", yaw))
    }
    R_x, R_y, R_z = np.eye(3), np.eye(3), np.eye(3)
    R_x[1:, 1:], R_y[::2, ::2], R_z[:2, :2] = turn["x"], turn["y"], turn["z"]
    np.testing.assert_allclose(axes.T / size, R_z @ R_y @ R_x, atol=1e-3)


def test_what_has_no_place_is_drawn_at_the_object() -> None:
    found = drawn(
        Pointing(name="up", direction=ALONG, axis=AXIS, profile=AT_ONCE),
        Orientation(name="level", rpy=RPY, profile=AT_ONCE),
    )
    (way,), (axes,) = found["directions"], found["orientations"]
    assert np.cross(way["way"][0], ALONG) == pytest.approx(0.0, abs=1e-3)
    assert "at" not in axes
    assert not found["controllers"][0]["tracked"]


def test_every_kind_of_mark_has_its_key_on_the_page() -> None:
    scenario = replace(load("point_on_point"), duration=0.3, secondary=())
    page = render(coopqp.compare(replace(scenario, tasks=(Own(name="own"),)), controllers=["qp"]))
    for key in ("goal", "plane", "line", "way", "axes", "posture", "wall", "trail"):
        assert page.count(f'id="{key}-key"') == 1


def test_obstacles_are_drawn_where_they_stand() -> None:
    """A slab of 20 x 30 x 2 cm, turned by a quarter about z: its corners, in the world."""
    slab = Obstacle(box=(0.2, 0.3, 0.02), position=(0.2, 0.0, 0.25), rpy_deg=(0.0, 0.0, 90.0))
    scenario = replace(
        load("point_on_point"),
        limits=(Obstacles(shapes={"slab": slab}),),
        duration=0.02,
    )
    bodies = scene(coopqp.compare(scenario))["bodies"]
    (drawn,) = (body for body in bodies[-1:] if not body["moves"])
    corners = np.array(drawn["vertices"]).reshape(-1, 3)
    assert corners.min(axis=0) == pytest.approx([0.05, -0.1, 0.24], abs=1e-4)
    assert corners.max(axis=0) == pytest.approx([0.35, 0.1, 0.26], abs=1e-4)
    assert len(drawn["triangles"]) == 3 * 12
