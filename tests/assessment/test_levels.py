"""Who comes first is told first: verdict and explanation name the same tasks in the same order."""

from __future__ import annotations

import re
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from explained import traced
from scenario_files import HEAD, TAIL, phased

import coopqp
from coopqp.assessment import assess
from coopqp.execution.comparison import summarize
from coopqp.execution.controller_run import run
from coopqp.limits import JointAcceleration
from coopqp.model.profile import Profile
from coopqp.recordings import read
from coopqp.report.cells import cells
from coopqp.report.files import write
from coopqp.report.page import how_to_read
from coopqp.scenario.scenario import Scenario
from coopqp.study.explanation import RunExplanation, explain_run
from coopqp.study.trace_file import trace_from_file, worth_explaining
from coopqp.tasks import PointOnPlane
from coopqp.trace import Trace

from .contract import disagreements


def lifted(duration: float, *controllers: str) -> Scenario:
    """Two SO-101 that shall lift a bar higher than they reach, and then to the front."""
    base = coopqp.load("two_so101")
    up = PointOnPlane(
        name="up", mode="hard", normal=(0, 0, 1), through=(0, 0, 0.375),
        profile=Profile(kind="quintic", duration=3.0),
    )  # fmt: skip
    fore = PointOnPlane(name="fore", normal=(1, 0, 0), through=(0.33, 0, 0))
    chosen = {name: base.controllers[name] for name in controllers or ("qp",)}
    return replace(base, tasks=(up, fore), duration=duration, controllers=chosen)


@cache
def hurried(controller: str = "qp") -> tuple[Scenario, Trace]:
    """The same with too little time."""
    scenario = lifted(5.0 if controller == "qp" else 3.0, controller)
    return scenario, run(scenario, controller=controller)


def lacks(trace: Trace) -> tuple[str, str]:
    """How far off both tasks end, in words."""
    fore, _, up = 1e3 * np.abs(trace.position[-1] - (0.33, 0.0, 0.375))
    return f"{up:.1f} mm off", f"{fore:.1f} mm off"


@cache
def told() -> RunExplanation:
    """Why it falls short."""
    return explain_run(*hurried())


def test_the_verdict_tells_the_hard_task_first_and_then_who_gave_way() -> None:
    scenario, trace = hurried()
    found = assess(trace)
    assert [task.name for task in found.missed] == ["up", "fore"]
    assert [task.name for task in found.gave_way] == ["fore"]
    assert found.missed[1].share > found.missed[0].share
    said = summarize(scenario, {"qp": trace}).verdicts["qp"]
    up, fore = lacks(trace)
    assert f"Ends {up} the goal of hard task 'up' and {fore} that of 'fore'" in said
    assert not list(disagreements(scenario, trace))


def test_a_law_without_levels_has_none() -> None:
    scenario, trace = hurried("pseudoinverse")
    found = assess(trace)
    assert not found.gave_way
    assert found.missed[0].share == max(task.share for task in found.missed)
    said = summarize(scenario, {"pseudoinverse": trace}).verdicts["pseudoinverse"]
    assert "hard task" not in said
    assert "comes after" not in explain_run(scenario, trace).sentence


def test_a_run_that_ends_in_motion_is_told_so() -> None:
    scenario, trace = hurried()
    joint, speed, unit = assess(trace).fastest or ("", 0.0, "")
    assert speed > 0.5
    said = summarize(scenario, {"qp": trace}).verdicts["qp"]
    assert f"still moves when the run ends, {joint} at {speed:.2g} {unit}" in said
    still = replace(trace, v=0.0 * trace.v)
    assert "still moves" not in summarize(scenario, {"qp": still}).verdicts["qp"]


def test_what_is_unreachable_is_told_apart_from_what_time_would_bring() -> None:
    found = told()
    assert found.kind == "reach"
    assert found.distance == pytest.approx(0.00515, abs=1e-4)
    up, fore = lacks(hurried()[1])
    behind = r"up ends ([\d.]+) mm off, still moving, ([\d.]+) mm of it for lack of time"
    words = re.search(behind + r": after ([\d.]+) s ([\d.]+) mm are left", found.sentence)
    assert words
    off, lost, seconds, left = map(float, words.groups())
    later, _ = lacks(run(lifted(seconds), controller="qp"))
    assert [f"{off:.1f} mm off", f"{left:.1f} mm off"] == [up, later]
    assert lost == pytest.approx(off - left, abs=0.1)
    assert f"fore, which comes after up, ends {fore} because of that" in found.sentence


def test_levels_are_read_back_from_a_recorded_run(tmp_path: Path) -> None:
    scenario, trace = hurried()
    comparison = summarize(scenario, {"qp": trace})
    again = trace_from_file(traced(comparison, tmp_path), scenario, "qp")
    assert [(t.mode, t.priority) for t in again.tasks] == [("hard", 0), ("soft", 0)]
    assert [task.name for task in assess(again).missed] == ["up", "fore"]


def test_who_falls_short_is_explained(tmp_path: Path) -> None:
    scenario = coopqp.load("joint_limit_stress")
    goes = coopqp.compare(scenario, controllers=("pseudoinverse", "qp"))
    assert worth_explaining(read(traced(goes, tmp_path)), scenario).controller == "qp"


def test_angles_below_their_thresholds_resolution_are_left_out() -> None:
    scenario, trace = hurried()
    assert 0.0 < trace.loop_orientation.max() < 1e-6
    trace = replace(trace, loop_position=np.full_like(trace.loop_position, 1.1e-4))
    said = summarize(scenario, {"qp": trace}).verdicts["qp"]
    assert "lets the loop open by 0.11 mm;" in said


def test_an_acceleration_is_told_with_advice_where_there_is_one() -> None:
    advice = "times what the loop for robots allows: add joint_acceleration to limits"
    scenario, trace = hurried()
    assert advice in summarize(scenario, {"qp": trace}).verdicts["qp"]
    _, deaf = hurried("pseudoinverse")
    assert (
        "add joint_acceleration"
        not in summarize(scenario, {"pseudoinverse": deaf}).verdicts["pseudoinverse"]
    )
    limits = (*scenario.limits, JointAcceleration(max=500.0))
    bounded = replace(scenario, limits=limits)
    kept = run(bounded, controller="qp")
    assert assess(kept).acceleration is not None
    assert "add joint_acceleration" not in summarize(bounded, {"qp": kept}).verdicts["qp"]


def test_the_cell_says_which_language_filled_the_rows() -> None:
    scenario, trace = hurried()
    us = np.ones(trace.ticks)
    alone = replace(trace, tick_us=us)
    metrics = summarize(scenario, {"qp": alone}).metrics["qp"]
    assert metrics["engine"]["rows_in_python"] == []
    assert cells(alone, metrics)["tick"].lines == ("1", "C++")
    told = replace(trace, tick_us=9.0 * us, rows_us=4.0 * us, rows_in_python=("mine",))
    metrics = summarize(scenario, {"qp": told}).metrics["qp"]
    assert metrics["engine"]["rows_in_python"] == ["mine"]
    rows = "+\N{NO-BREAK SPACE}Python rows:\N{NO-BREAK SPACE}4"
    assert cells(told, metrics)["tick"].lines == ("9", "C++", rows)


def test_verdict_and_explanation_name_the_same_limits() -> None:
    scenario = lifted(9.0)
    trace = run(scenario, controller="qp")
    names = assess(trace).at_limits(0)
    assert names
    said = summarize(scenario, {"qp": trace}).verdicts["qp"]
    sentence = explain_run(scenario, trace).sentence
    assert all(name in said and name in sentence for name in names[:3])


def test_how_to_read_says_what_is_allowed_and_what_a_tick_must_be() -> None:
    scenario, trace = hurried()
    (said,) = (p for p in how_to_read(summarize(scenario, {"qp": trace})) if "OnlineLoop" in p)
    assert "joint_acceleration in the scenario's limits bounds it here as well" in said
    assert "stay below the control period, 10 ms" in said


MOVING = """\
phases:
  - name: first
    duration: 0.5
    tasks: [{point_on_point: {goal: [0.15, 0.0, 0.06], gain: 1.0,
             profile: {kind: constant_velocity, duration: 0.5}}}]
  - name: then
    duration: 1.0
    tasks: [{point_on_point: {goal: [0.15, 0.0, 0.08], gain: 5.0,
             profile: {kind: constant_velocity, duration: 1.0}}}]
limits: [joint_position, joint_velocity, {joint_acceleration: {max: 10}}]
"""


def test_a_phase_that_begins_in_motion_accelerates_from_there(tmp_path: Path) -> None:
    """Live and read back: what the joints do between two phases is what its differences say."""
    scenario = phased(tmp_path, HEAD + MOVING + TAIL)
    compared = coopqp.compare(scenario)
    write(compared, tmp_path / "out")
    live = compared.traces["qp"]
    again = trace_from_file(tmp_path / "out" / "trace.csv", scenario, "qp")
    steps = np.abs(np.diff(live.v, axis=0)).max(axis=1) / scenario.dt
    assert np.abs(live.v[49]).max() > 0.5
    assert steps[49] > 9.0
    for trace in (live, again):
        margins = [m for row, m in trace.margins.items() if row.label.startswith("acceleration")]
        assert len(margins) == 20
        least = np.min(margins, axis=0)
        np.testing.assert_allclose(least[1:], 10.0 - steps, atol=1e-6)
        assert not assess(trace).broken
