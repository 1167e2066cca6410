"""Velocities of the object that are commanded."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from chains import Walk
from example_tasks import EXAMPLES, POINT, H, at, object_point, rows

from coopqp.assessment import assess
from coopqp.base.qp import names_of
from coopqp.execution.controller_run import run
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.profile import Profile
from coopqp.scenario.loader import load
from coopqp.signals import Waypoints
from coopqp.tasks import Twist


@pytest.mark.parametrize("turned", [False, True])
def test_twist_rows_are_the_velocity_of_the_point(
    turned: bool, chain: ClosedChain, closed_loop_walk: Walk, rng: np.random.Generator
) -> None:
    names = ("x", "y", "z", "rot_x", "rot_y", "rot_z")
    task = Twist(
        velocity=dict.fromkeys(reversed(names), 0.0),
        point=POINT,
        axes="object" if turned else "world",
    )
    assert task.rows(chain) == names
    for q in closed_loop_walk(chain, 3):
        v = rng.normal(size=chain.n)
        state, after, before = (at(chain, q + h * v, 0.0) for h in (0.0, H, -H))
        linear = (object_point(after, POINT) - object_point(before, POINT)) / (2 * H)
        angular = pin.log3(after.R_WO @ before.R_WO.T) / (2 * H)
        R = state.R_WO.T if turned else np.eye(3)
        stack = rows(task, state)
        np.testing.assert_allclose(stack.J @ v, [*(R @ linear), *(R @ angular)], atol=1e-7)
        np.testing.assert_array_equal(stack.e, np.zeros(6))


def test_twist_commands_the_velocity_given_once_it_has_grown(chain: ClosedChain) -> None:
    task = EXAMPLES["twist"]
    assert task.rows(chain) == ("x", "z", "rot_y")
    for t, share in ((0.3, 0.0), (1.3, 0.5), (9.0, 1.0)):
        rate = rows(task, at(chain, chain.q_start, t)).rate
        np.testing.assert_allclose(rate, share * np.array([0.01, -0.02, 0.2]), atol=1e-15)


def test_twist_can_be_commanded_by_a_signal(chain: ClosedChain) -> None:
    there = Waypoints(times=[0.0, 1.0], values=[[0.0, 0.0], [2.0, 0.1]], between="linear")
    task = Twist(velocity=there, components=("rot_z", "x"), profile=Profile(kind="step"))
    stack = rows(task, at(chain, chain.q_start, 0.5))
    assert names_of(stack.rows) == ("task[twist].x", "task[twist].rot_z")
    np.testing.assert_allclose(stack.rate, [0.05, 1.0])


@pytest.mark.parametrize(("duration", "reached"), [(0.5, True), (6.0, False)])
def test_twist_is_missed_where_a_limit_stops_it(duration: float, reached: bool) -> None:
    """Upwards at 8 cm/s: the arms can follow for a while, then they stand still and stretched."""
    task = Twist(name="up", velocity={"z": 0.08})
    scenario = replace(load("point_on_point"), tasks=(task,), secondary=(), duration=duration)
    trace = run(scenario, controller="qp")
    (info,) = trace.tasks
    assert (info.name, info.unit) == ("up.velocity", "m/s")
    speed = (trace.position[-1] - trace.position[-2])[2] / scenario.dt
    assert assess(trace).errors[0] == pytest.approx(abs(0.08 - speed), abs=1e-3)
    if not reached:
        assert np.abs(trace.v[-50:]).max() < 0.1, "without rattling about the singular pose"
    assert bool(assess(trace).errors[0] <= info.tolerance) == reached


@pytest.mark.parametrize("velocity", [{}, {"roll": 1.0}, {"x": math.nan}])
def test_twist_of_nothing_or_of_unknown_components_is_refused(velocity: dict[Any, float]) -> None:
    with pytest.raises(ValueError, match="velocity"):
        Twist(velocity=velocity)
