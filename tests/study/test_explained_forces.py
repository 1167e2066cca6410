"""Runs that end by forces: an object that was lost, and springs that give way to a push."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from explained import explained, traced

import coopqp
from coopqp.assessment import assess
from coopqp.controllers import TorqueQp, WrenchSplit
from coopqp.execution.comparison import summarize
from coopqp.plant import Disturbance, Push
from coopqp.plants import QuasiStatic, RigidBody
from coopqp.scenario.scenario import Scenario
from coopqp.study.explanation import explain_run
from coopqp.study.trace_file import trace_from_file
from coopqp.tasks import InternalWrench


def lifted(**settings: object) -> Scenario:
    """The lift of ``press_and_lift`` on rigid bodies, short and coarse."""
    scenario = coopqp.load("press_and_lift")
    given = {"plant": RigidBody(time_step=0.002), "dt": 0.002, "duration": 0.3, **settings}
    return replace(scenario, **{"disturbance": Disturbance(), **given})  # type: ignore[arg-type]


def test_a_lost_object_is_said_first_and_what_is_advised_holds_it() -> None:
    """Half of the friction, which the safety of 1.5 and the inner square do not make up for."""
    scenario = lifted(disturbance=Disturbance(friction=0.4))
    found = explained(scenario, "torque_qp")
    assert found.kind == "lost"
    assert found.sentence.startswith("the object is lost at ")
    assert "friction coefficient 0.2 (modelled as 0.5)" in found.sentence
    assert "left/arm" in found.sentence
    assert "hold it back" not in found.sentence  # no limit of a joint is spoken of
    assert found.tried
    assert "torque_qp: {safety: 2.25}" in found.sentence
    firmer = replace(scenario, controllers={"torque_qp": TorqueQp(safety=2.25)})
    assert coopqp.run(firmer, controller="torque_qp").signals["held"].all()


def test_a_pad_whose_pressure_reaches_its_edge_is_named_and_a_squeeze_that_holds() -> None:
    """Walker's split asks the pads for torques of m g a / (2 X) = 32.7 N: with 25 N they tip."""
    law = WrenchSplit(name="equal", split="walker", squeeze=25.0)
    scenario = lifted(controllers={"equal": law})
    found = explained(scenario, "equal")
    assert found.kind == "lost"
    assert "the pressure reaches the pad's edge" in found.sentence
    assert "equal: {squeeze: 37.5} it is held (tried)" in found.sentence


@pytest.mark.full
def test_springs_that_bear_a_weight_that_is_wrong_ask_for_the_mass_that_helps(
    tmp_path: Path,
) -> None:
    """300 g more, whoever pushes."""
    given = coopqp.load("impedance")
    push = Push(force=(6.0, 8.0, 0.0), start=0.2, duration=9.0)
    scenario = replace(
        given, plant=RigidBody(time_step=0.002), dt=0.002, duration=2.5,
        disturbance=Disturbance(object_mass=1.3, push=push),
    )  # fmt: skip
    trace = coopqp.run(scenario, controller="torque_qp")
    path = traced(summarize(scenario, {"torque_qp": trace}), tmp_path)
    found = explain_run(scenario, trace_from_file(path, scenario, "torque_qp"))
    assert found.kind == "model"
    assert "gain" not in found.sentence
    words = found.sentence.split()
    loads = [float(words[i - 2]) for i, word in enumerate(words) if word == "along"]
    assert np.allclose(loads, (6.0, 8.0, -2.943), rtol=0.02)
    assert "with object.mass 1.3 the goal is reached (tried)" in found.sentence
    told = replace(given.held, mass=1.3)
    advised = replace(scenario, held=told, disturbance=Disturbance(push=push))
    assert assess(coopqp.run(advised, controller="torque_qp")).reached


@pytest.mark.full
def test_a_push_that_holds_an_object_away_is_no_error_of_the_model() -> None:
    """The hands' servos give way by half a millimetre, which no calibration mends."""
    push = Push(force=(0.0, 80.0, 0.0), start=0.1, duration=99.0)
    scenario = replace(
        coopqp.load("two_pandas"), plant=QuasiStatic(stiffness=3000.0),
        disturbance=Disturbance(push=push),
    )  # fmt: skip
    sentence = explained(scenario, "qp").sentence
    assert "a push holds it away: without it the goal is reached (tried)" in sentence
    assert "calibrate" not in sentence


def test_an_object_that_is_held_is_explained_as_ever() -> None:
    assert explained(lifted(), "torque_qp").kind != "lost"


def test_a_written_run_ends_where_the_run_itself_does(tmp_path: Path) -> None:
    """A force that oscillates by 3.9 N, and passes what was asked for in the last sample."""
    pressing = InternalWrench(name="press", squeeze=120.0)
    scenario = lifted(tasks=(*lifted().tasks, pressing))
    trace = coopqp.run(scenario, controller="torque_qp")
    (k,) = (k for k, task in enumerate(trace.tasks) if task.name == "press")
    error = trace.task_error.copy()
    error[:, k] = np.abs(3.9 * np.sin(2.0 * np.pi * (trace.t - trace.t[-1]) / 0.05))
    trace = replace(trace, task_error=error)
    path = traced(summarize(scenario, {"torque_qp": trace}), tmp_path)
    ends = assess(trace_from_file(path, scenario, "torque_qp")).tasks
    read = {task.name: task.error for task in ends}
    own = dict(zip((task.name for task in trace.tasks), assess(trace).errors.tolist(), strict=True))
    assert read == pytest.approx(own, rel=1e-5)
    assert read["press"] == pytest.approx(3.9, rel=0.02)
