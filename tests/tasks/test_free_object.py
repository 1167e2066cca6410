"""Where tasks take an object that nothing holds."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, cast

import numpy as np
import pinocchio as pin
import pytest
from example_tasks import AXIS, EXAMPLES, MOVING, POINT, THROUGH, TILTED, object_point, plane_at
from free_body import FreeBody, block_of

from coopqp import tasks
from coopqp.base.spec import Array
from coopqp.model.profile import Profile
from coopqp.signal import axes_along
from coopqp.task import Task


def angle_between(a: Array, b: Array) -> float:
    return math.atan2(float(np.linalg.norm(np.cross(a, b))), float(a @ b))


AXIS_O = np.array(AXIS) / np.linalg.norm(AXIS)


def reference_at(t: float) -> tuple[Array, Array]:
    """A point and the direction of the examples that move."""
    return plane_at(t, velocity=np.array(MOVING), turning=True)


def off_line(p: Array, c: Array, d: Array) -> float:
    return float(np.linalg.norm(np.cross(d, p - c)))


ENDS: dict[str, Callable[[Array, Array, Array, Array], list[float]]] = {
    # What must be zero at the end: p the point and a the axis of the object, c and d in space.
    "line moves": lambda p, a, c, d: [off_line(p, c, d)],
    "circle moves": lambda p, a, c, d: [off_line(p, c, d) - 0.03, d @ (p - c)],
    "pointing turns": lambda p, a, c, d: [angle_between(a, d)],
    "line on plane that moves": lambda p, a, c, d: [d @ (p - c), a @ d],
    "plane on plane that moves": lambda p, a, c, d: [d @ (p - c), angle_between(a, d)],
    "line on line that moves": lambda p, a, c, d: [off_line(p, c, d)],
    "revolute that moves": lambda p, a, c, d: [*(p - c), angle_between(a, d)],
    "prismatic that moves": lambda p, a, c, d: [off_line(p, c, d)],
}


@pytest.mark.parametrize("name", ENDS)
def test_free_object_ends_up_as_the_task_says_and_follows_the_reference(
    name: str, rng: np.random.Generator
) -> None:
    """The feed-forward is complete: nothing is left but what an Euler step is off by."""
    for _ in range(3):
        body = FreeBody(rng)
        _, errors = body.follow(EXAMPLES[name], 3.0, 0.005)
        assert max(errors) < 0.02
        state = body.state
        c, d = reference_at(3.0)
        left = ENDS[name](object_point(state, POINT), state.R_WO @ AXIS_O, c, d)
        np.testing.assert_allclose(left, 0, atol=1e-3)


def test_object_on_a_slide_turns_with_it(rng: np.random.Generator) -> None:
    body, task = FreeBody(rng), EXAMPLES["prismatic that moves"]
    body.follow(task, 3.0)
    turned = pin.exp3(0.8 * np.array([1, 2, -1]) / math.sqrt(6))
    wanted = turned @ pin.rpy.rpyToMatrix(*np.radians([20, -10, 30]))
    np.testing.assert_allclose(body.state.R_WO, wanted, atol=1e-3)


def test_object_on_a_slide_keeps_its_orientation_unless_told(rng: np.random.Generator) -> None:
    body = FreeBody(rng)
    before = body.state.R_WO.copy()
    body.follow(tasks.Prismatic(direction=TILTED, through=THROUGH, point=POINT), 1.5)
    np.testing.assert_allclose(body.state.R_WO, before, atol=1e-12)


@pytest.mark.parametrize("goal", [(20, -10, 30), (180, 0, 0), (0, 0, 179.9)])
def test_free_object_turns_to_its_orientation(goal: tuple[float, float, float]) -> None:
    body = FreeBody()
    block, errors = body.follow(tasks.Orientation(rpy_deg=goal), 2.0)
    assert max(errors) < 0.02
    np.testing.assert_allclose(body.state.R_WO, pin.rpy.rpyToMatrix(*np.radians(goal)), atol=1e-3)
    np.testing.assert_allclose(block.e, 0, atol=1e-3)


def test_half_a_turn_at_once_is_finite_and_done(rng: np.random.Generator) -> None:
    task = tasks.Orientation(rpy_deg=(180, 0, 0), profile=Profile(kind="step"))
    block, errors = FreeBody().follow(task, 3.0)
    assert errors[0] == pytest.approx(math.pi)
    assert errors[-1] < 1e-4
    assert np.isfinite(block.J).all()


@pytest.mark.each_value
@pytest.mark.parametrize("off", [0.0, 1e-15, 1e-9, 1e-4, 0.01, 0.1])
@pytest.mark.parametrize("kind", ["step", "quintic"])
@pytest.mark.parametrize(
    "task", [tasks.Pointing, tasks.PlaneOnPlane, tasks.LineOnLine, tasks.Revolute]
)
def test_axis_leaves_the_opposite_direction(task: type[Task], kind: Any, off: float) -> None:
    """From straight against the direction, or nearly so, it turns round all the same."""
    body = FreeBody()
    body.turn_to(pin.exp3(np.array([0.6, -0.8, 0.0]) * (math.pi - off)))
    along = {} if task is tasks.Pointing else {"through": (0.1, 0.2, 0.3)}
    keys: Any = {("normal" if task is tasks.PlaneOnPlane else "direction"): (0, 0, 1), **along}
    _, errors = body.follow(task(axis=(0, 0, 2), profile=Profile(kind=kind), **keys), 4.0)
    assert errors[-1] < 1e-3
    assert body.state.R_WO[2, 2] > 1.0 - 1e-6
    if kind == "step" and task is tasks.Pointing:
        assert errors[0] == pytest.approx(math.pi - off)
        assert all(np.diff(errors) <= 1e-12)


def test_direction_error_is_exact_up_to_the_cone_about_the_opposite(
    rng: np.random.Generator,
) -> None:
    """Jacobian against central differences from zero to all but half a turn; rows stay bounded."""
    task = tasks.Pointing(direction=(0, 0, 1), axis=(0, 0, 1), profile=Profile(kind="step"))
    for lean in (0.0, 1e-13, 1e-10, 1e-6, 1e-3, 0.5, 1.57, 2.5, 3.0, 3.1):
        for _ in range(5):
            way, omega = rng.uniform(0, 2 * math.pi), rng.normal(size=3)
            R = np.array(pin.exp3(lean * np.array([math.cos(way), math.sin(way), 0.0])))
            e = []
            for h in (-1e-6, 0.0, 1e-6):
                body = FreeBody()
                body.turn_to(pin.exp3(h * omega) @ R)
                block = block_of(task, body.state, cast(Any, None))
                e.append(block.e.copy())
                if h == 0.0:
                    J = block.J.copy()
            assert np.linalg.norm(e[1]) == pytest.approx(lean, abs=1e-12)
            np.testing.assert_allclose(J[:, 3:] @ omega, (e[2] - e[0]) / 2e-6, rtol=1e-5, atol=1e-7)
    for lean in math.pi - np.array([0.0, 1e-18, 1e-12, 1e-6, 1e-3, 0.019]):
        body = FreeBody()
        body.turn_to(pin.exp3(np.array([lean, 0, 0])))
        block = block_of(task, body.state, cast(Any, None))
        assert np.linalg.norm(block.e) == pytest.approx(lean)
        assert np.abs(block.J).max() < math.pi / 0.02 + 1e-9


def test_line_may_end_either_way_when_allowed() -> None:
    for sign, axis in ((1, (1, 0, 0.3)), (-1, (1, 0, -0.3))):
        body = FreeBody()
        task = tasks.LineOnLine(direction=(0, 0, 1), through=(0, 0, 0), axis=axis, either_way=True)
        body.follow(task, 1.5)
        a = body.state.R_WO @ np.array(axis) / np.linalg.norm(axis)
        assert a[2] == pytest.approx(sign, abs=1e-5)


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("kind", ["step", "quintic"])
def test_line_normal_to_the_plane_falls_into_it(kind: Any, sign: int) -> None:
    body = FreeBody()
    task = tasks.LineOnPlane(
        normal=(0, 0, 1), through=(0, 0, 0), axis=(0, 0, sign), profile=Profile(kind=kind)
    )
    block, errors = body.follow(task, 4.0)
    assert errors[-1] < 1e-3
    assert np.linalg.norm(block.J[1]) == pytest.approx(1.0)
    assert body.state.R_WO[2, 2] == pytest.approx(0.0, abs=1e-3)


@pytest.mark.parametrize("kind", ["step", "quintic"])
def test_point_leaves_the_circles_axis_and_the_middle_of_the_sphere(kind: Any) -> None:
    profile = Profile(kind=kind)
    body = FreeBody()
    circle = tasks.PointOnCircle(center=(0, 0, 0.1), normal=(0, 0, 1), radius=0.05, profile=profile)
    block, errors = body.follow(circle, 4.0)
    assert errors[-1] < 1e-5
    assert np.linalg.norm(body.state.p_WO[:2]) == pytest.approx(0.05, abs=1e-5)
    body = FreeBody()
    block, errors = body.follow(tasks.Distance(to=(0, 0, 0), length=0.05, profile=profile), 4.0)
    assert errors[-1] < 1e-5
    assert np.linalg.norm(block.J) == pytest.approx(1.0)
    assert np.linalg.norm(body.state.p_WO) == pytest.approx(0.05, abs=1e-5)


def test_lines_that_are_parallel_already_ask_for_no_turn() -> None:
    task = tasks.LineOnLine(direction=(0, 0, 3), through=(0, 0.1, 0), axis=(0, 0, 1))
    block = block_of(task, FreeBody().state, cast(Any, None))
    np.testing.assert_allclose(block.J[2:], [[0, 0, 0, 0, 1, 0], [0, 0, 0, -1, 0, 0]], atol=1e-12)
    np.testing.assert_allclose(block.e, 0, atol=1e-12)


def test_axes_along_a_direction_are_right_handed_and_end_with_it(rng: np.random.Generator) -> None:
    for d in (*rng.normal(size=(20, 3)), *np.eye(3), *-np.eye(3)):
        axes = axes_along(tuple(3.0 * d))
        np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-15)
        assert np.linalg.det(axes) == pytest.approx(1.0)
        np.testing.assert_allclose(axes[2], d / np.linalg.norm(d), atol=1e-15)
