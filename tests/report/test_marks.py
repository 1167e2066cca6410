"""What tasks and limits show of themselves agrees with their errors, and the playback draws it."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import singledispatch
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import coopqp
import coopqp.tasks
from coopqp import tasks
from coopqp.base.spec import Pose as PoseValue
from coopqp.limits import Workspace
from coopqp.model import marker
from coopqp.model.closed_chain import AXES, ClosedChain
from coopqp.model.geometry import Turn
from coopqp.model.marker import Marker
from coopqp.model.profile import Profile
from coopqp.model.state import State
from coopqp.scenario.catalog import Catalog
from coopqp.signal import Moment
from coopqp.task import Task, TaskStack

Array = NDArray[np.float64]
Walk = Callable[[ClosedChain, int], list[Array]]

POINT, AXIS = (0.03, -0.02, 0.05), (2, -1, 0.5)  # of the object
AT, ALONG = (0.2, 0.01, 0.06), (1, -1, 3)  # in space
AT_ONCE = Profile(kind="step")
TURN = Turn(axis=(1, 2, -1), angle=0.8, profile=Profile(duration=1.5, delay=0.1))
VELOCITY = (0.02, -0.03, 0.01)  # m/s
MOVES: dict[str, Any] = {
    "point": POINT, "velocity": VELOCITY, "turn": TURN, "profile": AT_ONCE
}  # fmt: skip
TIMES = (0.0, 0.4, 0.9, 3.0)  # before, during and after the turn [s]
RPY = (0.3, -0.2, 0.5)


@singledispatch
def off(mark: Any, p: Array) -> float:
    """How far a point is from what is shown, from the definition of each."""
    raise AssertionError(mark)


@off.register
def _(mark: marker.PointMarker, p: Array) -> float:
    return math.dist(p, mark.at)


@off.register
def _(mark: marker.LineMarker, p: Array) -> float:
    return float(np.linalg.norm(np.cross(p - mark.through, mark.direction)))


@off.register
def _(mark: marker.PlaneMarker, p: Array) -> float:
    return abs(float((p - mark.through) @ mark.normal))


@off.register
def _(mark: marker.CircleMarker, p: Array) -> float:
    height = float((p - mark.center) @ mark.normal)
    beside = np.linalg.norm(p - mark.center - height * mark.normal)
    return math.hypot(float(beside) - mark.radius, height)


@off.register
def _(mark: marker.SphereMarker, p: Array) -> float:
    return abs(math.dist(p, mark.center) - mark.radius)


@off.register
def _(mark: marker.PoseMarker, p: Array) -> float:
    return math.dist(p, mark.position)


def angle(a: Array, b: Array) -> float:
    """Between two unit vectors."""
    return 2.0 * math.atan2(float(np.linalg.norm(a - b)), float(np.linalg.norm(a + b)))


def turned_off(mark: Marker, state: State) -> float:
    """Angle of the rotation from the orientation shown to the object's, by its trace."""
    assert isinstance(mark, marker.PoseMarker)
    return math.acos(0.5 * (float(np.trace(state.R_WO @ mark.rotation.T)) - 1.0))


def tracked(marks: tuple[Marker, ...], state: State) -> Array:
    (mark,) = (mark for mark in marks if isinstance(mark, marker.TrackedMarker))
    return state.p_WO + state.R_WO @ np.array(mark.point)


def axis_in_world(state: State) -> Array:
    a = np.array(AXIS) / np.linalg.norm(AXIS)
    return state.R_WO @ a


#: By name: the task, and for each mark in turn the norm of which rows says how far the tracked
#: point is from it.
PLACED: dict[str, tuple[Task, tuple[slice | None, ...]]] = {
    "point_on_point": (tasks.PointOnPoint(goal=AT, point=POINT, profile=AT_ONCE), (slice(3), None)),
    "point_on_plane": (tasks.PointOnPlane(normal=ALONG, through=AT, **MOVES), (slice(1), None)),
    "point_on_line": (tasks.PointOnLine(direction=ALONG, through=AT, **MOVES), (slice(2), None)),
    "point_on_circle": (
        tasks.PointOnCircle(center=AT, normal=ALONG, radius=0.03, **MOVES),
        (slice(2), None),
    ),
    "distance": (
        tasks.Distance(to=AT, length=0.1, point=POINT, velocity=VELOCITY, profile=AT_ONCE),
        (slice(1), None),
    ),
    "line_on_plane": (
        tasks.LineOnPlane(normal=ALONG, through=AT, axis=AXIS, **MOVES),
        (slice(1), None),
    ),
    "plane_on_plane": (
        tasks.PlaneOnPlane(normal=ALONG, through=AT, axis=AXIS, **MOVES),
        (slice(1), None),
    ),
    "line_on_line": (
        tasks.LineOnLine(direction=ALONG, through=AT, axis=AXIS, **MOVES),
        (slice(2), None),
    ),
    "revolute": (
        tasks.Revolute(direction=ALONG, through=AT, axis=AXIS, **MOVES),
        (slice(2), slice(3), None),
    ),
    "prismatic": (
        tasks.Prismatic(direction=ALONG, through=AT, rpy=RPY, **MOVES),
        (slice(2), None, None),
    ),
    "pose": (
        tasks.Pose(goal=PoseValue(position=AT, rpy=RPY), profile=AT_ONCE),
        (slice(3), None),
    ),
    "impedance": (
        tasks.Impedance(
            goal=PoseValue(position=AT, rpy=RPY),
            stiffness=dict.fromkeys(AXES, 100.0),  # type: ignore[arg-type]
            profile=AT_ONCE,
        ),
        (slice(3), None),
    ),
}

#: By name: the task, its rows that are an angle, and that angle from the first mark or the last.
TURNED: dict[str, tuple[Task, slice, Callable[[tuple[Marker, ...], State], float]]] = {
    "line_on_plane": (
        PLACED["line_on_plane"][0],
        slice(1, 2),
        lambda marks, state: abs(0.5 * math.pi - angle(axis_in_world(state), marks[0].normal)),  # type: ignore[union-attr]
    ),
    "plane_on_plane": (
        PLACED["plane_on_plane"][0],
        slice(1, 3),
        lambda marks, state: angle(axis_in_world(state), marks[0].normal),  # type: ignore[union-attr]
    ),
    "line_on_line": (
        PLACED["line_on_line"][0],
        slice(2, 4),
        lambda marks, state: angle(axis_in_world(state), marks[0].direction),  # type: ignore[union-attr]
    ),
    "revolute": (
        PLACED["revolute"][0],
        slice(3, 5),
        lambda marks, state: angle(axis_in_world(state), marks[0].direction),  # type: ignore[union-attr]
    ),
    "pointing": (
        tasks.Pointing(direction=ALONG, axis=AXIS, turn=TURN, profile=AT_ONCE),
        slice(0, 2),
        lambda marks, state: angle(axis_in_world(state), marks[0].direction),  # type: ignore[union-attr]
    ),
    "prismatic": (
        PLACED["prismatic"][0],
        slice(2, 5),
        lambda marks, state: turned_off(marks[1], state),
    ),
    "orientation": (
        tasks.Orientation(rpy=RPY, profile=AT_ONCE),
        slice(0, 3),
        lambda marks, state: turned_off(marks[0], state),
    ),
    **{
        name: (
            PLACED[name][0],
            slice(3, 6),
            lambda marks, state: turned_off(marks[0], state),
        )
        for name in ("pose", "impedance")
    },
}

#: These have nothing to go to.
BARE = {
    "joint_centering", "joint_limit_barrier", "manipulability", "minimum_kinetic_energy",
    "minimum_velocity",
}  # fmt: skip
#: These ask for forces, which have no place.
FORCES = {"internal_wrench"}
#: The goals of these move with the robot; test_carried_marks.py holds what is drawn against them.
CARRIED = {"posture", "relative_motion", "twist"}


def states(chain: ClosedChain, walk: Walk, t: float) -> list[State]:
    return [State(chain, q, t) for q in walk(chain, 3)]


def error(task: Task, state: State) -> Array:
    stack = TaskStack([task], State(state.chain))
    stack.update(state)
    return stack.e


def test_every_task_is_held_against_its_marks_here() -> None:
    shipped = set(Catalog().entries("tasks"))
    assert shipped == {*PLACED, *TURNED, *BARE, *FORCES, *CARRIED}


@pytest.mark.parametrize("name", PLACED)
@pytest.mark.parametrize("t", TIMES)
def test_the_tracked_point_is_as_far_from_each_mark_as_the_error_says(
    name: str, t: float, chain: ClosedChain, closed_loop_walk: Walk
) -> None:
    task, rows = PLACED[name]
    marks = task.marks(Moment(t))
    assert len(marks) == len(rows)
    for state in states(chain, closed_loop_walk, t):
        p, e = tracked(marks, state), error(task, state)
        for mark, part in zip(marks, rows, strict=True):
            if part is not None:
                assert off(mark, p) == pytest.approx(np.linalg.norm(e[part]), abs=1e-12)


@pytest.mark.parametrize("name", TURNED)
@pytest.mark.parametrize("t", TIMES)
def test_the_object_is_turned_from_its_mark_as_the_error_says(
    name: str, t: float, chain: ClosedChain, closed_loop_walk: Walk
) -> None:
    task, rows, turned = TURNED[name]
    for state in states(chain, closed_loop_walk, t):
        expected = float(np.linalg.norm(error(task, state)[rows]))
        assert turned(task.marks(Moment(t)), state) == pytest.approx(expected, abs=1e-7)


@pytest.mark.parametrize("name", [n for n, (task, _) in PLACED.items() if "velocity" in dir(task)])
def test_marks_are_where_the_reference_is_then(name: str) -> None:
    """The place moves at the velocity, also while the way there is not over."""
    task = replace(PLACED[name][0], profile=Profile(duration=2.0))
    for t in TIMES:
        mark: Any = task.marks(Moment(t))[0]
        place = (
            mark.center
            if isinstance(mark, marker.CircleMarker | marker.SphereMarker)
            else mark.through
        )
        np.testing.assert_allclose(place, np.array(AT) + t * np.array(VELOCITY), atol=1e-15)


def test_a_turning_plane_is_drawn_turned() -> None:
    quarter = Turn(axis=(3, 0, 0), angle_deg=90.0, profile=Profile(duration=3.0))
    task = tasks.PointOnPlane(normal=(0, 0, 2), through=AT, turn=quarter)
    begin, middle, end = (task.marks(Moment(t))[0] for t in (0.0, 1.5, 3.0))
    assert isinstance(begin, marker.PlaneMarker)
    assert isinstance(middle, marker.PlaneMarker)
    assert isinstance(end, marker.PlaneMarker)
    np.testing.assert_allclose(begin.normal, (0, 0, 1), atol=1e-15)
    np.testing.assert_allclose(middle.normal, np.array((0, -1, 1)) / math.sqrt(2), atol=1e-15)
    np.testing.assert_allclose(end.normal, (0, -1, 0), atol=1e-15)


def test_a_slide_without_an_orientation_shows_its_line_alone() -> None:
    marks = tasks.Prismatic(direction=ALONG, through=AT, point=POINT).marks(Moment(0.5))
    assert [type(mark) for mark in marks] == [marker.LineMarker, marker.TrackedMarker]


def test_twist_shows_the_point_whose_velocity_it_asks_for(
    chain: ClosedChain, closed_loop_walk: Walk, rng: np.random.Generator
) -> None:
    task, h = tasks.Twist(velocity={"x": 0.1, "y": 0.0, "z": 0.2}, point=POINT), 1e-5
    stack = TaskStack([task], State(chain))
    for state in states(chain, closed_loop_walk, 0.5):
        v = rng.normal(size=chain.n)
        before, after = (
            tracked(task.marks(Moment(0.5)), State(chain, state.q + s * h * v)) for s in (-1.0, 1.0)
        )
        stack.update(state)
        np.testing.assert_allclose((after - before) / (2 * h), stack.J @ v, atol=1e-8)


@pytest.mark.parametrize("name", sorted(BARE))
def test_what_has_no_goal_shows_nothing(name: str) -> None:
    task = Catalog().entries("tasks")[name].cls()
    assert isinstance(task, Task)
    assert task.marks(Moment(0.3)) == ()


# ---- limits ----------------------------------------------------------------------------------


def test_the_plane_of_a_workspace_is_as_near_as_its_margin_says(
    chain: ClosedChain, closed_loop_walk: Walk
) -> None:
    wall = Workspace(normal=ALONG, through=(0.1, 0.0, -0.1), points=(POINT,))
    (mark,) = wall.marks(0.7)
    assert isinstance(mark, marker.PlaneMarker)
    q = np.array([chain.q_start, *closed_loop_walk(chain, 3)])
    (margin,) = wall.margins(chain, q, np.zeros((3, chain.n)), 0.01).values()
    for row, left in zip(q[1:], margin, strict=True):
        p = State(chain, row).point(np.array(POINT))
        assert (p - mark.through) @ mark.normal == pytest.approx(left, abs=1e-14)


def test_limits_without_a_place_show_nothing() -> None:
    settings: dict[str, dict[str, Any]] = {
        "joint_acceleration": {"max": 10.0},
        "object_speed": {"linear": 0.1},
        "workspace": {"normal": (0, 0, 1), "through": (0, 0, 0)},
        "obstacles": {"shapes": {"ball": {"sphere": 0.1}}},
    }
    for name, entry in Catalog().entries("limits").items():
        limit = entry.cls(**settings.get(name, {}))
        assert isinstance(limit, coopqp.Limit)
        assert bool(limit.marks(0.0)) == (name in ("workspace", "obstacles"))


# ---- marks -----------------------------------------------------------------------------------


def test_marks_take_any_length_and_keep_a_copy() -> None:
    through = np.array([1.0, 2.0, 3.0])
    mark = marker.PlaneMarker(normal=np.array([0.0, 3.0, 4.0]), through=through)
    through[:] = 0.0
    np.testing.assert_allclose(mark.normal, (0.0, 0.6, 0.8))
    np.testing.assert_allclose(mark.through, (1.0, 2.0, 3.0))


@pytest.mark.parametrize(
    ("build", "words"),
    [
        (lambda: marker.PointMarker(at=np.zeros(2)), "at"),
        (lambda: marker.PointMarker(at=np.array([0.0, math.nan, 0.0])), "3 finite numbers"),
        (lambda: marker.PointMarker(at=None), "3 finite numbers"),  # type: ignore[arg-type]
        (lambda: marker.LineMarker(direction=np.zeros(3)), "needs a direction"),
        (lambda: marker.PoseMarker(rotation=np.diag([1.0, 1.0, -1.0])), "needs a rotation matrix"),
        (lambda: marker.PoseMarker(rotation=2.0 * np.eye(3)), "needs a rotation matrix"),
        (lambda: marker.SphereMarker(center=np.zeros(3), radius=-1.0), "radius"),
    ],
)
def test_marks_that_cannot_be_drawn_are_refused(build: Callable[[], Marker], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        build()
