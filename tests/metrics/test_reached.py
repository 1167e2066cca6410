"""Whether forces that oscillate, or have come to rest, reach what was asked of them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from explained import hurried_reruns, traced  # noqa: F401 - a fixture
from scenario_files import needs_robots

import coopqp
from coopqp.assessment import assess
from coopqp.base.spec import Array
from coopqp.execution.comparison import Comparison, summarize
from coopqp.plant import Disturbance, Push
from coopqp.plants import RigidBody
from coopqp.scenario.scenario import Scenario
from coopqp.study.explanation import explain_run
from coopqp.study.trace_file import trace_from_file
from coopqp.trace import Trace

TOLERANCE = 1.0  # [N]


@pytest.fixture(scope="module")
def scenario() -> Scenario:
    return coopqp.load("point_on_point")


@pytest.fixture(scope="module")
def trace(scenario: Scenario) -> Trace:
    return coopqp.run(scenario, controller="qp")


def judged(scenario: Scenario, trace: Trace, off: Array, unit: str) -> Comparison:
    """With one task that is off by so much."""
    task = replace(trace.tasks[0], name="press", unit=unit, tolerance=TOLERANCE)
    e, error = off[:, None], np.abs(off)[:, None]
    asked = replace(
        trace,
        tasks=(task,),
        task_rows=("press.squeeze",),
        e=e,
        rate=np.zeros_like(e),
        task_error=error,
        goal_error=error,
        manipulability=trace.manipulability[:1],
    )
    return summarize(scenario, {"qp": asked})


def test_a_force_that_oscillates_has_not_reached_what_one_sample_says(
    scenario: Scenario, trace: Trace
) -> None:
    """3.9 sin(2 pi t / 0.05 s), shifted so that the last sample is 0.87 off."""
    phase = 2.0 * np.pi * (trace.t - trace.t[-1]) / 0.05
    wave = 3.9 * np.sin(phase + np.arcsin(0.87 / 3.9))
    assert abs(wave[-1]) < TOLERANCE
    found = judged(scenario, trace, wave, "N")
    assert not found.metrics["qp"]["reached"]
    said = found.metrics["qp"]["task_error"]["press"]
    assert said == pytest.approx(3.9, rel=0.1)  # samples are some ticks from the peak
    assert (
        f"Oscillates to the end, up to {said:.3g} N off the goal of 'press'" in found.verdicts["qp"]
    )
    # Places are where they are in the end.
    assert judged(scenario, trace, wave, "m").metrics["qp"]["reached"]


def test_a_force_that_has_come_to_rest_for_a_fifth_of_a_second_has_reached_it(
    scenario: Scenario, trace: Trace
) -> None:
    for seconds, reached in ((0.25, True), (0.1, False)):
        off = np.where(trace.t > trace.t[-1] - seconds, 0.9, 5.0)
        found = judged(scenario, trace, off, "N").metrics["qp"]
        assert found["reached"] is reached


def test_a_force_that_jumps_from_one_side_to_the_other_oscillates(
    scenario: Scenario, trace: Trace
) -> None:
    """It is never near to what was asked."""
    jumps = 43.0 * (-1.0) ** np.arange(len(trace.t))
    found = judged(scenario, trace, jumps, "N")
    assert "Oscillates to the end, up to 43 N off the goal of 'press'" in found.verdicts["qp"]


def test_a_force_that_stays_off_ends_so(scenario: Scenario, trace: Trace) -> None:
    found = judged(scenario, trace, np.full(len(trace.t), 12.0), "N m")
    assert "Ends 12 N m off the goal of 'press'" in found.verdicts["qp"]


def test_a_force_that_is_no_number_is_lost(scenario: Scenario, trace: Trace) -> None:
    off = np.zeros(len(trace.t))
    off[-1] = np.nan
    found = judged(scenario, trace, off, "N")
    assert not found.metrics["qp"]["reached"]
    assert "its error is no number" in found.verdicts["qp"]


@pytest.mark.full
@needs_robots
@pytest.mark.usefixtures("hurried_reruns")
def test_an_impedance_that_is_pushed_to_the_end_has_to_be_where_its_springs_are(
    tmp_path: Path,
) -> None:
    """F/K is 6/3000 and 8/400 m; after 0.1 s of the push it is not there yet."""
    given = replace(coopqp.load("impedance"), dt=0.002, plant=RigidBody(time_step=0.002))
    push = Push(force=(6.0, 8.0, 0.0), start=0.1, duration=9.0)
    for seconds, there in ((1.6, True), (0.2, False)):
        pushed = replace(given, duration=seconds, disturbance=Disturbance(push=push))
        found = coopqp.compare(pushed, controllers=["torque_qp"])
        assert found.metrics["torque_qp"]["reached"] is there
        words = "Yields 20.0 mm to the push, as 'springs.position' specifies"
        assert found.verdicts["torque_qp"].startswith(words) is there
        (trace,) = found.traces.values()
        off = np.linalg.norm(trace.e[-1, :3] - [6.0 / 3000.0, 8.0 / 400.0, 0.0])
        assert assess(trace).errors[0] == pytest.approx(off)
        read = trace_from_file(traced(found, tmp_path), pushed, "torque_qp")
        np.testing.assert_array_equal(assess(read).errors, assess(trace).errors)
        told = explain_run(pushed, read)
        assert told.kind == ("reached" if there else "short")
        assert "gain" not in told.sentence
