"""Every task follows each kind of signal: exact rates, and no lag in the object."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from following import NAMES, following, moving_fields, one_of_each, place, way
from laws import problem
from scipy.spatial.transform import Rotation

from coopqp.base.spec import Array
from coopqp.controllers import QPController
from coopqp.execution.controller_run import run
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.profile import Profile
from coopqp.model.state import State
from coopqp.scenario.catalog import Catalog
from coopqp.scenario.loader import load
from coopqp.signal import POSE, InputValues, Kind, Signal, Trajectory
from coopqp.signals import Circle, Input, Line, Waypoints
from coopqp.task import Task, TaskStack
from coopqp.tasks import Twist
from coopqp.torque_law.task_dynamics import TaskDynamics

H = 1e-5  # step of the central differences [s]
BETWEEN = ["linear", "minimum_jerk", "cubic"]


def test_all_tasks_with_a_goal_are_here(chain: ClosedChain) -> None:
    assert sorted(one_of_each(chain)) == sorted(NAMES)


def check_rates(task: Task, chain: ClosedChain, walk: list[Array], inputs: Any = None) -> None:
    """E at a fixed configuration changes by -rate, and J is as if nothing moved."""
    start = State(chain)
    start.inputs = inputs(0.0) if inputs else InputValues()
    stack = TaskStack([task], start)

    def look(q: Array, t: float) -> TaskStack:
        state = State(chain, q, t)
        state.inputs = inputs(t) if inputs else InputValues()
        stack.update(state)
        return stack

    for q, t in zip(walk, (0.55, 1.3, 2.3, 4.6), strict=True):
        before, after = look(q, t - H).e.copy(), look(q, t + H).e.copy()
        found = look(q, t)
        if not task.asks_velocity:
            np.testing.assert_allclose(found.rate, -(after - before) / (2.0 * H), atol=5e-7)
        v = np.random.default_rng(1).standard_normal(chain.n)
        ahead, behind = look(q + H * v, t).e.copy(), look(q - H * v, t).e.copy()
        if not task.asks_velocity:
            moved = (ahead - behind) / (2.0 * H)
            np.testing.assert_allclose(look(q, t).J @ v, moved, atol=1e-5)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("between", BETWEEN)
def test_every_task_follows_way_points_with_their_exact_rate(
    name: str, between: str, chain: ClosedChain, closed_loop_walk: Any
) -> None:
    repeat = {"linear": "once", "minimum_jerk": "round", "cubic": "back_and_forth"}[between]
    task = following(one_of_each(chain)[name], chain, way(chain, between, repeat))
    check_rates(task, chain, closed_loop_walk(chain, 4))


def arrived(task: Task, chain: ClosedChain, between: str) -> Callable[[float], InputValues]:
    """What inputs by the names of a task's fields are at a time [s]."""
    moves = {
        key: way(chain, between, "round")(key, kind).bind(kind, State(chain), None)
        for key, kind in moving_fields(task, chain).items()
    }

    def inputs(t: float) -> InputValues:
        found, at = InputValues(), State(chain, t=t)
        for key, course in moves.items():
            course.update(at)
            found[key] = Trajectory(course.kind, course.value)
            found[key].rate[:] = course.rate
        return found

    return inputs


@pytest.mark.parametrize("name", NAMES)
def test_every_task_follows_an_input_with_its_exact_rate(
    name: str, chain: ClosedChain, closed_loop_walk: Any
) -> None:
    task = one_of_each(chain)[name]
    followed = following(task, chain, lambda key, kind: Input(name=key))
    check_rates(followed, chain, closed_loop_walk(chain, 4), arrived(task, chain, "cubic"))


@pytest.mark.parametrize("name", NAMES)
def test_accelerations_are_those_of_the_way_that_an_input_goes(
    name: str, chain: ClosedChain, closed_loop_walk: Any
) -> None:
    """Where a tick before it went elsewhere, too: what it does next is not what it did last."""
    task = one_of_each(chain)[name]
    inputs, v = arrived(task, chain, "linear"), np.random.default_rng(1).standard_normal(chain.n)
    goes = way(chain, "linear", "round")

    def arriving(key: str, kind: Kind) -> Signal:
        return Input(name=key, start=goes(key, kind).values[0])

    asked = following(task, chain, goes), following(task, chain, arriving)
    exact, found = (TaskDynamics(problem(chain, one)) for one in asked)
    for q, t in zip(closed_loop_walk(chain, 4), (0.55, 1.3, 2.3, 4.9), strict=True):
        state = State(chain, q, t)
        state.v[:], state.inputs = v, inputs(t)
        state.update()
        exact.update(state)
        found.update(state)
        np.testing.assert_allclose(found.e_dot, exact.e_dot, atol=1e-9)
        np.testing.assert_allclose(found.drift, exact.drift, atol=1e-5)


@pytest.mark.parametrize("name", NAMES)
def test_every_task_follows_closed_forms_where_they_are_of_its_kind(
    name: str, chain: ClosedChain, closed_loop_walk: Any
) -> None:
    task = one_of_each(chain)[name]
    for made in (_circle, _line):
        kinds = moving_fields(task, chain)

        def signal_of(key: str, kind: Kind, made: Any = made) -> Any:
            return made(place(kind, chain)) or getattr(task, key)

        if any(made(place(kind, chain)) for kind in kinds.values()):
            check_rates(following(task, chain, signal_of), chain, closed_loop_walk(chain, 4))


def test_a_signal_that_several_rows_follow_moves_once_a_state(
    chain: ClosedChain, monkeypatch: pytest.MonkeyPatch
) -> None:
    signal, moved = way(chain, "linear", "once")("goal", POSE), list[float]()
    task = following(one_of_each(chain)["pose"], chain, lambda key, kind: signal)
    stack = TaskStack([task], State(chain))
    course = type(signal.bind(POSE, State(chain), None))
    monkeypatch.setattr(course, "update", lambda self, at: moved.append(at.t))
    stack.update(State(chain, t=0.5))
    assert moved == [0.5]


def _circle(value: Array) -> Signal | None:
    center = tuple(value.tolist())
    return (
        Circle(center=center, radius=0.05, normal=(1, 2, 3), period=2.0)
        if len(value) == 3
        else None
    )  # type: ignore[arg-type]


def _line(value: Array) -> Signal | None:
    if len(value) in (4, 7):
        return None
    return Line(start=value.tolist(), end=(value + 0.05).tolist(), period=2.0)


def test_twists_command_the_value_of_their_signal(chain: ClosedChain) -> None:
    signal = Waypoints(times=[0, 2], values=[[0, 0, 0], [0.1, 0.2, 0.3]], between="linear")
    task = Twist(velocity=signal, components=("x", "y", "z"), profile=Profile(kind="step"))
    stack = TaskStack([task], State(chain))
    stack.update(State(chain, t=1.0))
    np.testing.assert_allclose(stack.rate, [0.05, 0.1, 0.15])


#: [m/s]; what is left goes with its square: the motion of a tick is straight in the joints.
MOTION = np.array([-0.007, 0.003, 0.004])


@pytest.mark.parametrize(("damping", "left"), [(1e-9, 1e-6), (None, 2.5e-6)])
def test_the_object_does_not_lag_at_constant_speed(damping: float | None, left: float) -> None:
    """A point that goes straight on: after the start, the object is there to a micrometre.

    With the damping that the law has by default two more are missing, as near a singular pose.
    """
    law = QPController() if damping is None else QPController(damping=damping)
    scenario = load("point_on_point")
    p = State(scenario.chain).p_WO
    ends = [p.tolist(), (p + 3.0 * MOTION).tolist()]
    goal = Waypoints(times=[0.0, 3.0], values=ends, between="linear")
    task = replace(scenario.tasks[0], goal=goal, profile=Profile(duration=0.5))
    scenario = replace(scenario, tasks=(task,), duration=2.5, controllers={"qp": law})
    trace = run(scenario, controller="qp")
    k = np.flatnonzero(trace.t > 1.5)
    expected = p + trace.t[k][:, None] * MOTION
    assert np.abs(trace.position[k] - expected).max() < left


def test_a_turning_object_does_not_lag_at_constant_speed() -> None:
    scenario = load("point_on_point")
    R, axis = State(scenario.chain).R_WO, np.array([0.0, 1.0, 0.0])
    ends = [Rotation.from_matrix(pin.exp3(a * axis) @ R).as_quat().tolist() for a in (0.0, 0.2)]
    goal = Waypoints(times=[0.0, 3.0], values=ends, between="linear")
    task = Catalog().entries("tasks")["orientation"].cls(goal=goal, profile=Profile(duration=0.5))
    trace = run(replace(scenario, tasks=(task,), secondary=(), duration=2.5), controller="qp")
    k = int(np.flatnonzero(trace.t > 2.0)[0])
    wanted = pin.exp3(0.2 * trace.t[k] / 3.0 * axis) @ R
    assert np.linalg.norm(pin.log3(trace.rotation[k] @ wanted.T)) < 1e-6
