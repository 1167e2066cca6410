"""Points on points and planes that move and turn, and distances, against their definitions."""

from __future__ import annotations

import math

import numpy as np
import pytest
from chains import Walk
from example_tasks import (
    EXAMPLES,
    IN_SPACE,
    MOVING,
    POINT,
    THROUGH,
    TIMES,
    at,
    error,
    object_point,
    plane_at,
    rows,
)

from coopqp.model.closed_chain import ClosedChain
from coopqp.model.geometry import Turn, polar
from coopqp.model.profile import Profile
from coopqp.model.state import State
from coopqp.tasks import PointOnPlane


@pytest.mark.parametrize("size", 10.0 ** -np.arange(1.0, 14.0))
def test_an_axis_that_leans_by_little_has_the_error_of_its_own_direction(size: float) -> None:
    """Of 1e-12 rad it was another direction's, which gains of 180 1/s make 2e-10 rad/s of."""
    y = size * np.array([-0.6, 0.8])
    seen = polar(np.append(y, np.sqrt(1.0 - size**2)))
    error = seen.angle * np.array(seen.way)
    np.testing.assert_allclose(error, y * np.arcsin(size) / size, rtol=1e-14)


def test_point_error_is_the_way_to_the_moving_reference(
    chain: ClosedChain, closed_loop_walk: Walk
) -> None:
    task = IN_SPACE["point on point"]
    start, goal = object_point(State(chain), POINT), np.array([0.2, 0.02, 0.08])
    for q in closed_loop_walk(chain, 5):
        for t in TIMES:
            x = min(max((t - 0.3) / 2.0, 0.0), 1.0)
            share = 10 * x**3 - 15 * x**4 + 6 * x**5
            state = at(chain, q, t)
            wanted = object_point(state, POINT) - (start + share * (goal - start))
            np.testing.assert_allclose(error(task, state), wanted, atol=1e-15)


@pytest.mark.parametrize(
    "name", [n for n, task in EXAMPLES.items() if type(task) is PointOnPlane][1:]
)
def test_plane_error_is_the_height_above_the_moving_and_turning_plane(
    name: str, chain: ClosedChain, closed_loop_walk: Walk
) -> None:
    task = EXAMPLES[name]
    assert isinstance(task, PointOnPlane)
    velocity, turning = np.array(task.velocity), task.turn is not None
    c, n = plane_at(0.0, velocity=velocity, turning=False)
    height = n @ (object_point(State(chain), task.point) - c)
    for q in closed_loop_walk(chain, 5):
        for t in TIMES:
            x = min(max((t - 0.3) / 2.0, 0.0), 1.0)
            reference = height * (1 - (10 * x**3 - 15 * x**4 + 6 * x**5))
            state = at(chain, q, t)
            c, n = plane_at(t, velocity=velocity, turning=turning)
            wanted = n @ (object_point(state, task.point) - c) - reference
            assert error(task, state) == pytest.approx([wanted], abs=1e-14)


def test_plane_has_turned_by_its_angle_at_the_end(chain: ClosedChain) -> None:
    """A quarter turn about x makes the plane z = 0.06 the plane y = 0.01, seen from -y."""
    turn = Turn(axis=(3, 0, 0), angle_deg=90.0, profile=Profile(duration=3.0))
    task = PointOnPlane(normal=(0, 0, 1), through=(0.2, 0.01, 0.06), turn=turn)
    assert task.end == 3.0
    state = at(chain, chain.q_start, task.end)
    assert error(task, state) == pytest.approx([-(state.p_WO[1] - 0.01)], abs=1e-15)


def test_length_of_the_normal_does_not_count(chain: ClosedChain) -> None:
    state = at(chain, chain.q_start, 1.0)
    short, long = (
        rows(PointOnPlane(normal=n, through=THROUGH), state) for n in ((0.1, 0, 0.2), (10, 0, 20))
    )
    np.testing.assert_allclose(short.e, long.e, rtol=1e-14)
    np.testing.assert_allclose(short.J, long.J, atol=1e-15)


def test_angle_in_degrees_is_the_angle_in_radians() -> None:
    assert Turn(axis=(0, 0, 1), angle_deg=180.0).radians == pytest.approx(math.pi)


@pytest.mark.parametrize("keys", [{}, {"angle": 1.0, "angle_deg": 57.3}])
def test_turn_needs_its_angle_once(keys: dict[str, float]) -> None:
    with pytest.raises(ValueError, match="angle_deg"):
        Turn(axis=(0, 0, 1), **keys)


@pytest.mark.parametrize("normal", [(0, 0, 0), (0, 0), (0, 0, math.nan), (0, 0, math.inf)])
def test_plane_without_a_direction_is_refused(normal: tuple[float, ...]) -> None:
    with pytest.raises(ValueError, match="normal"):
        PointOnPlane(normal=normal, through=(0, 0, 0))  # type: ignore[arg-type]


def test_distance_error_is_the_distance_less_its_reference(
    chain: ClosedChain, closed_loop_walk: Walk
) -> None:
    task = EXAMPLES["distance to what moves"]
    before = np.linalg.norm(object_point(State(chain), POINT) - THROUGH)
    for q in closed_loop_walk(chain, 5):
        for t in TIMES:
            x = min(max((t - 0.3) / 2.0, 0.0), 1.0)
            share = 10 * x**3 - 15 * x**4 + 6 * x**5
            state = at(chain, q, t)
            to = np.array(THROUGH) + np.array(MOVING) * t
            wanted = np.linalg.norm(object_point(state, POINT) - to) - 0.1
            wanted -= (1 - share) * (before - 0.1)
            assert error(task, state) == pytest.approx([wanted], abs=1e-14)
