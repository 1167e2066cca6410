"""Value and rate of every signal, against finite differences and closed forms."""

from __future__ import annotations

import math
from itertools import product

import numpy as np
import pinocchio as pin
import pytest
from example_signals import EXAMPLES, TIMES, near
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation, Slerp

from coopqp.base.errors import InvalidValueError
from coopqp.base.spec import Array
from coopqp.signal import (
    DIRECTION,
    POINT,
    POSE,
    ROTATION,
    Kind,
    Moment,
    Signal,
    Trajectory,
    of_joints,
    of_twist,
)
from coopqp.signals import Circle, Line, Waypoints

H = 1e-6  # step of the central differences [s]
KINDS = [POINT, ROTATION, DIRECTION, POSE, of_joints(("a", "b", "c", "d")), of_twist(("x", "y"))]
#: Off the corners of the signals.
INSTANTS = (0.35, 0.77, 1.31, 2.02, 3.7, 8.13)


def waypoints(kind: Kind, between: str, repeat: str) -> Waypoints:
    values = near(kind, kind.zero, np.random.default_rng(7))
    return Waypoints(times=TIMES, values=values, between=between, repeat=repeat)  # type: ignore[arg-type]


def look(course: Trajectory, t: float) -> tuple[Array, Array]:
    course.update(Moment(t))
    return course.value.copy(), course.rate.copy()


def seen_rate(kind: Kind, course: Trajectory, t: float) -> Array:
    """The rate by central differences."""
    before, after = look(course, t - H)[0], look(course, t + H)[0]
    k = kind.numbers
    rate = (after[:k] - before[:k]) / (2.0 * H)
    if not kind.turns:
        return rate
    R = [Rotation.from_quat(q[k:]).as_matrix() for q in (before, after)]
    return np.concatenate([rate, pin.log3(R[1] @ R[0].T) / (2.0 * H)])


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.name)
@pytest.mark.parametrize("between", ["linear", "minimum_jerk", "cubic"])
@pytest.mark.parametrize("repeat", ["once", "back_and_forth", "round"])
def test_the_rate_of_way_points_is_the_derivative_of_their_value(
    kind: Kind, between: str, repeat: str
) -> None:
    course = waypoints(kind, between, repeat).bind(kind, Moment(), None)
    for t in INSTANTS:
        np.testing.assert_allclose(look(course, t)[1], seen_rate(kind, course, t), atol=2e-8)


@pytest.mark.parametrize("name", ["circle", "line", "waypoints"])
def test_the_rate_of_a_place_is_the_derivative_of_its_value(name: str) -> None:
    course = EXAMPLES[name].bind(POINT, Moment(), None)
    for t in INSTANTS:
        np.testing.assert_allclose(look(course, t)[1], seen_rate(POINT, course, t), atol=2e-8)


@pytest.mark.parametrize("between", ["linear", "minimum_jerk", "cubic"])
def test_way_points_are_met_and_held(between: str) -> None:
    for kind in KINDS:
        signal = waypoints(kind, between, "once")
        course = signal.bind(kind, Moment(), None)
        assert signal.rest == TIMES[-1]
        for t, value in zip(TIMES, signal.values or (), strict=True):
            found, given = look(course, t)[0], np.array(value)
            if kind.axis:
                found, given = course.R[:, 2], given / np.linalg.norm(given)
            k = kind.numbers
            np.testing.assert_allclose(found[:k], given[:k], atol=1e-12)
            if kind.turns and not kind.axis:
                assert abs(found[k:] @ given[k:]) == pytest.approx(1.0, abs=1e-12)
            elif kind.axis:
                np.testing.assert_allclose(found, given, atol=1e-12)
        for t in (-1.0, 0.1, TIMES[-1] + 0.1, 99.0):
            assert not look(course, t)[1].any()


def test_what_lies_between_is_what_scipy_says() -> None:
    points, poses = waypoints(POINT, "cubic", "round"), waypoints(ROTATION, "linear", "once")
    course, turning = points.bind(POINT, Moment(), None), poses.bind(ROTATION, Moment(), None)
    spline = CubicSpline(TIMES, np.array(points.values), bc_type="periodic")
    slerp = Slerp(TIMES, Rotation.from_quat(np.array(poses.values)))
    for t in (0.3, 1.2, 2.9):
        np.testing.assert_allclose(look(course, t)[0], spline(t), atol=1e-12)
        found = Rotation.from_quat(look(turning, t)[0])
        assert (found * slerp(t).inv()).magnitude() == pytest.approx(0.0, abs=1e-12)


def test_a_round_trip_goes_on_smoothly_and_back_and_forth_turns_round() -> None:
    length = TIMES[-1] - TIMES[0]
    for kind, between in product(KINDS, ["cubic", "minimum_jerk"]):
        course = waypoints(kind, between, "round").bind(kind, Moment(), None)
        t = TIMES[-1]
        before, after = look(course, t - 1e-9), look(course, t + 1e-9)
        np.testing.assert_allclose(before[1], after[1], atol=1e-6)
        np.testing.assert_allclose(look(course, 1.0)[1], look(course, 1.0 + length)[1], atol=1e-12)
        course = waypoints(kind, between, "back_and_forth").bind(kind, Moment(), None)
        there, back = look(course, 1.0), look(course, 2.0 * (TIMES[0] + length) - 1.0)
        np.testing.assert_allclose(there[0], back[0], atol=1e-12)
        np.testing.assert_allclose(there[1], -back[1], atol=1e-12)


def test_a_whole_turn_goes_round() -> None:
    """The quaternion is the opposite one after one turn, and the rotation the same."""
    angles = np.radians([0.0, 120.0, 240.0, 360.0])
    values = [Rotation.from_rotvec([0, 0, a]).as_quat().tolist() for a in angles]
    for between in ("linear", "cubic"):
        signal = Waypoints(times=[0, 1, 2, 3], values=values, between=between, repeat="round")
        course = signal.bind(ROTATION, Moment(), None)
        for t in np.linspace(0.1, 8.9, 12):
            value, rate = look(course, t)
            assert rate[2] == pytest.approx(math.radians(120.0), rel=0.1)
            angle = Rotation.from_quat(value).as_rotvec()[2] - math.radians(120.0) * t
            assert abs((angle + math.pi) % (2.0 * math.pi) - math.pi) < 0.05


def test_a_circle_is_round_and_comes_up_to_speed() -> None:
    circle = Circle(center=(1, 2, 3), radius=0.5, normal=(0, 0, 2), period=4.0, begin=(0, 7, 1))
    course = circle.bind(POINT, Moment(), None)
    value, rate = look(course, 0.0)
    np.testing.assert_allclose(value, [1, 2.5, 3], atol=1e-15)
    assert not rate.any()
    for t in (0.3, 1.0, 2.7, 9.0):
        value, rate = look(course, t)
        radius = value - [1, 2, 3]
        assert np.linalg.norm(radius) == pytest.approx(0.5)
        assert radius @ rate == pytest.approx(0.0, abs=1e-12)
        assert np.cross(radius, rate)[2] > 0.0, "counter-clockwise"
    assert np.linalg.norm(rate) == pytest.approx(0.5 * 2.0 * math.pi / 4.0)
    np.testing.assert_allclose(look(course, 5.0)[0], look(course, 9.0)[0], atol=1e-12)


def test_a_line_goes_there_and_back() -> None:
    course = Line(start=[0.0, 1.0], end=[2.0, 0.0], period=4.0).bind(
        of_joints(("a", "b")), Moment(), None
    )
    for t, value in ((0.0, (0, 1)), (1.0, (1, 0.5)), (2.0, (2, 0)), (4.0, (0, 1))):
        np.testing.assert_allclose(look(course, t)[0], value, atol=1e-12)
    assert not look(course, 2.0)[1].round(12).any()


WRONG = [
    (Circle(center=(0, 0, 0), radius=1, period=1), POSE, "circle: is 3 numbers, but a pose"),
    (Line(start=[0.0], end=[1.0], period=1), ROTATION, "line: does not turn"),
    (Line(start=[0.0], end=[1.0], period=1), POINT, "line.start: found shape"),
    (
        Waypoints(times=[0, 1], values=[[0, 0, 0], [1, 2]]),
        POINT,
        "waypoints.values[1]: found shape (2,), needs 3 numbers: x, y, z",
    ),
    (
        Waypoints(times=[0, 1], values=[[0, 0, 0, 2], [0, 0, 0, 1]]),
        ROTATION,
        "waypoints.values[0]: found a quaternion of length 2",
    ),
    (
        Waypoints(times=[0, 1], values=[[0, 0, 1], [0, 0, -1]]),
        DIRECTION,
        "waypoints.values[1]: is the opposite of the direction before",
    ),
    (
        Waypoints(times=[0, 1], values=[[0, 0, 1], [0, 1, 1]], repeat="round"),
        POINT,
        "round needs the last value to be the first",
    ),
]


@pytest.mark.parametrize(("signal", "kind", "words"), WRONG)
def test_what_cannot_be_is_refused(signal: Signal, kind: Kind, words: str) -> None:
    with pytest.raises(InvalidValueError) as caught:
        signal.bind(kind, Moment(), None)
    assert words in str(caught.value)


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"times": [0, 1, 1], "values": [[0]] * 3}, "found 1 s after 1 s"),
        ({"times": [1, 0], "values": [[0]] * 2}, "found 0 s after 1 s"),
        ({"times": [0, 1, 2], "values": [[0]] * 2}, "found 3 times and 2 values"),
        ({"times": [0, 1]}, "give times and values, or file"),
        ({}, "give times and values, or file"),
    ],
)
def test_way_points_that_do_not_fit_are_refused(values: dict[str, object], words: str) -> None:
    with pytest.raises(InvalidValueError) as caught:
        Waypoints(**values)  # type: ignore[arg-type]
    assert words in str(caught.value)


@pytest.mark.parametrize(
    ("kind", "given", "expected"),
    [
        (POSE, np.eye(4), [0, 0, 0, 0, 0, 0, 1]),
        (POSE, pin.SE3(np.eye(3), np.array([1.0, 2, 3])), [1, 2, 3, 0, 0, 0, 1]),
        (ROTATION, np.eye(3), [0, 0, 0, 1]),
        (DIRECTION, (0, 0, 5), [0, 0, 0, 1]),
        (POINT, [1, 2, 3], [1, 2, 3]),
    ],
)
def test_values_may_come_as_matrices(kind: Kind, given: object, expected: list[float]) -> None:
    np.testing.assert_allclose(kind.read(given), expected, atol=1e-15)


@pytest.mark.parametrize(
    ("kind", "given", "words"),
    [
        (ROTATION, 2 * np.eye(3), "is no rotation"),
        (ROTATION, np.diag([1.0, 1.0, -1.0]), "is no rotation"),
        (POINT, [1, 2, math.nan], "NaN"),
        (POINT, "abc", "needs 3 numbers"),
        (POINT, [[1], [2, 3]], "needs 3 numbers"),
        (POSE, np.eye(3), "found shape (3, 3), needs 7 numbers"),
        (DIRECTION, (0, 0, 0), "needs a direction"),
    ],
)
def test_values_that_are_none_are_refused(kind: Kind, given: object, words: str) -> None:
    with pytest.raises(InvalidValueError) as caught:
        kind.read(given)
    assert words in str(caught.value)


NEAR = [0.15, 0.0, 0.06]


@pytest.mark.parametrize(
    ("signal", "said"),
    [
        (Waypoints(times=[0, 1], values=[NEAR, [1e9, 0, 0]]), "waypoints.values[1]: found 1e+09, "),
        (Waypoints(times=[0, 1e-12], values=[NEAR, [0, 0, 0]]), "values[1]: goes at 1.5e+11 m/s"),
        (
            Circle(center=[0, 0, 0], radius=1e6, period=9.0),
            "circle: found 1e+06, needs at most 100",
        ),
        (Circle(center=NEAR, radius=0.1, period=1e-9), "circle.period: goes at 6.28e+08 m/s"),
        (Line(start=NEAR, end=[0, 0, 1e9], period=1.0), "line: found 1e+09, needs at most 10000"),
        (Line(start=NEAR, end=[0, 0, 0], period=1e-9), "line.period: goes at 4.71e+08 m/s"),
    ],
)
def test_signals_that_nothing_can_follow_are_refused(signal: Signal, said: str) -> None:
    with pytest.raises(InvalidValueError) as refused:
        signal.bind(POINT, Moment(), None)
    assert said in str(refused.value)
