"""Goals that a leash or a wrong model keeps a run from: told so, and true."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from explained import hurried_reruns, traced  # noqa: F401 - a fixture

import coopqp
from coopqp.execution.comparison import summarize
from coopqp.limits import FollowingError, JointPosition, JointVelocity
from coopqp.plant import Disturbance, Fault
from coopqp.plants import RigidBody
from coopqp.scenario.scenario import Scenario
from coopqp.study.explanation import RunExplanation, explain_run
from coopqp.study.trace_file import trace_from_file


def explained(scenario: Scenario, folder: Path, controller: str = "qp") -> RunExplanation:
    trace = coopqp.run(scenario, controller=controller)
    path = traced(summarize(scenario, {controller: trace}), folder)
    return explain_run(scenario, trace_from_file(path, scenario, controller))


@pytest.mark.full
def test_a_leash_that_holds_the_commands_back_is_named(tmp_path: Path) -> None:
    scenario = replace(
        coopqp.load("point_on_point"),
        duration=2.5,
        plant=RigidBody(time_step=0.002),
        disturbance=Disturbance(noise_position=1e-5),
        limits=(JointPosition(), JointVelocity(), FollowingError(max=1e-4)),
    )
    found = explained(scenario, tmp_path)
    assert found.kind == "speed"
    assert "following_error" in found.sentence
    free = replace(scenario, limits=scenario.limits[:2])
    assert explained(free, tmp_path).kind == "reached"


@pytest.mark.full
@pytest.mark.usefixtures("hurried_reruns")
def test_what_the_model_gets_wrong_is_not_blamed_on_the_law(tmp_path: Path) -> None:
    wrong = Disturbance(grasp_offset=3e-3, encoder_offset=5e-3)
    plant = RigidBody(time_step=0.002)
    given = coopqp.load("point_on_point")
    scenario = replace(given, duration=2.5, plant=plant, disturbance=wrong)
    found = explained(scenario, tmp_path)
    assert found.kind == "model", found.sentence
    assert "the model's errors are the cause" in found.sentence


@pytest.mark.full
@pytest.mark.usefixtures("hurried_reruns")
def test_a_run_that_an_injected_fault_keeps_from_its_goal_is_told_of_it(tmp_path: Path) -> None:
    fault = Fault(kind="motor_reversed", joint="LElbowRoll", start=0.5)
    plant = RigidBody(time_step=0.002)
    given = coopqp.load("point_on_point")
    scenario = replace(given, duration=2.5, plant=plant, disturbance=Disturbance(faults=(fault,)))
    sentence = explained(scenario, tmp_path).sentence
    assert "it has faults (motor_reversed of LElbowRoll from 0.5 s)" in sentence
    assert "without the disturbance the goal is reached (tried)" in sentence


def test_a_law_that_knows_no_priorities_puts_nobody_first(tmp_path: Path) -> None:
    low = coopqp.load("point_on_plane").tasks[0]
    assert isinstance(low, coopqp.tasks.PointOnPlane)
    high = replace(low, name="high", through=(0.0, 0.0, low.through[2] + 0.03), priority=1)
    scenario = replace(coopqp.load("point_on_plane"), tasks=(low, high), duration=3.0)
    assert "comes first" in explained(scenario, tmp_path).sentence
    other = explained(scenario, tmp_path, "pseudoinverse")
    assert "cannot hold together" in other.sentence
    assert "first" not in other.sentence


@pytest.mark.full
@pytest.mark.usefixtures("hurried_reruns")
def test_a_load_heavier_than_told_asks_for_its_mass(tmp_path: Path) -> None:
    scenario = replace(
        coopqp.load("two_pandas"),
        plant=RigidBody(time_step=0.005),
        disturbance=Disturbance(object_mass=6.0),
    )
    sentence = explained(scenario, tmp_path).sentence
    assert "the object is heavier than modelled: with object.mass 6 the goal is reached" in sentence
    assert "calibrate" not in sentence
