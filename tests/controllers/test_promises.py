"""A law says what of its problem it supports, keeps that, and never decides on old kinematics."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import get_args

import numpy as np
import pytest
from laws import problem

import coopqp
from coopqp.base.spec import Array
from coopqp.controller import Features
from coopqp.controllers import QPController
from coopqp.limit import Limit
from coopqp.limits import JointAcceleration, JointPosition, JointVelocity, ObjectSpeed, Workspace
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.profile import Profile
from coopqp.model.state import State
from coopqp.plants import RigidBody
from coopqp.report import audit
from coopqp.scenario.catalog import Catalog
from coopqp.scenario.notes import notes
from coopqp.tasks import JointCentering, PointOnPoint
from coopqp.trace import Trace

LIMITS: dict[str, Limit] = {
    "joint_velocity": JointVelocity(scale=0.002),
    "object_speed": ObjectSpeed(linear=0.005),
    "workspace": Workspace(
        normal=(0.0, 0.0, 1.0), through=(0.0, 0.0, 0.035), points=((0.0, 0.0, 0.0),)
    ),
    "joint_acceleration": JointAcceleration(max=0.3),
}
#: The plant integrates through the period, and torques act on a model that is linear in it.
HELD = {"joint_velocity": 2e-5, "object_speed": 2e-5, "workspace": 2e-5, "joint_acceleration": 5e-2}


def carried(*limits: Limit) -> Trace:
    """The torque QP on rigid bodies, on a way of 0.6 s."""
    scenario = coopqp.load("passive_grasp_pose")
    tasks = tuple(replace(task, profile=Profile(duration=0.6)) for task in scenario.tasks)
    own = (JointPosition(), *limits)
    given = replace(
        scenario, tasks=tasks, plant=RigidBody(time_step=0.002), duration=0.8, limits=own
    )
    return coopqp.run(given, controller="torque_qp")


@cache
def free() -> Trace:
    """Held back by the robot's own speeds alone."""
    return carried(JointVelocity())


@pytest.mark.few(2)
@pytest.mark.parametrize("name", LIMITS)
def test_the_torque_qp_keeps_the_limits_of_its_scenario(name: str) -> None:
    kept = carried(LIMITS[name])
    # Rounding decides whether a tick's certificate is a digit short; its velocity is feasible.
    others = [status for status in kept.status if status != "OPTIMAL"]
    assert set(others) <= {"INACCURATE"}
    assert len(others) <= 1
    broken = min(
        float(margin.min())
        for row, margin in kept.margins.items()
        if row.owner in (name, name.removeprefix("joint_"))
    )
    assert broken > -HELD[name]
    assert free().keeps_limits
    assert np.abs(free().q - kept.q).max() > 1e-3  # it had to be held back


def test_a_law_never_decides_on_the_kinematics_of_another_state(chain: ClosedChain) -> None:
    reach = PointOnPoint(goal=(0.2, 0.0, 0.06), name="reach")
    given = problem(chain, reach, limits=(JointPosition(), JointVelocity()))
    law, other = QPController().build(given), QPController().build(given)
    state = law.start()
    law.tick(state)
    state.q += 0.001 * np.arange(chain.n)  # nobody says so
    fresh = other.start(state.q)
    fresh.v[:] = state.v
    np.testing.assert_array_equal(law.tick(state).v, other.tick(fresh).v)
    np.testing.assert_array_equal(state.J_loop, State(chain, state.q).J_loop)


def rows_that_matter(trace: Trace) -> Array:
    return np.array([margin.min() for margin in trace.margins.values()])


@pytest.mark.parametrize("name", Catalog().entries("controllers"))
def test_what_a_controller_heeds_is_part_of_a_problem(name: str) -> None:
    known = set(get_args(get_args(Features)[0]))
    assert set(Catalog().entries("controllers")[name].cls.supports) <= known


def test_only_those_who_promise_to_keep_limits_are_audited() -> None:
    scenario = replace(coopqp.load("point_on_point"), duration=0.1)
    scenario = replace(scenario, tasks=(replace(scenario.tasks[0], profile=Profile(kind="step")),))
    traces = coopqp.compare(scenario).traces
    assert set(audit.audited(traces)) == {"qp"}
    assert rows_that_matter(traces["qp"]).min() >= -1e-9


def test_what_has_no_effect_on_a_controller_is_said() -> None:
    plain = coopqp.load("point_on_point")
    assert notes(replace(plain, secondary=())) == []
    said = notes(
        replace(
            plain,
            secondary=(JointCentering(name="centre"),),
            limits=(*plain.limits, ObjectSpeed(linear=0.1)),
            tasks=(replace(plain.tasks[0], mode="hard"),),
            on_infeasible="hold",
        )
    )
    assert said == [
        "no effect on pseudoinverse and pseudoinverse_null_space: the limits, that tasks are hard "
        "or scaled, on_infeasible",
        "no effect on pseudoinverse: the secondary objectives",
    ]
