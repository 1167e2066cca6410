"""Verdict, metrics, table, study, random goals, explanation and page say the same of every run.

``python -m tests.assessment`` asks the same of all shipped scenarios and of many random rollouts.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scenario_files import phased

import coopqp
from coopqp.assessment import assess
from coopqp.assessment.thresholds import TABLE
from coopqp.execution.comparison import summarize
from coopqp.execution.controller_run import run
from coopqp.limit import Limit
from coopqp.model.profile import Profile
from coopqp.plants import RigidBody
from coopqp.report import files
from coopqp.scenario.input import InputSettings
from coopqp.scenario.scenario import Scenario
from coopqp.signals import Input
from coopqp.solver import Status
from coopqp.study.explanation import explain_run
from coopqp.study.trace_file import trace_from_file
from coopqp.tasks import PointOnPoint
from coopqp.trace import Failure, Trace

from .contract import disagreements, of_stress

PAGE = Path(__file__).parents[2] / "docs" / "assessment.md"
SEEDS = (*range(18), 337, 414)  # the last two stand still where they have arrived


def short(**changes: Any) -> Scenario:
    """The demo with a goal that is soon reached."""
    goal = PointOnPoint(
        name="reach", goal=(0.19, 0.0, 0.05), gain=20.0, profile=Profile(duration=0.2)
    )
    given = {"tasks": (goal,), "secondary": (), "duration": 0.6, **changes}
    return replace(coopqp.load("point_on_point"), **given)


def steered(**settings: Any) -> Scenario:
    """The same with a goal that is an input."""
    task = PointOnPoint(name="reach", goal=Input(name="target"), gain=20.0)
    return short(tasks=(task,), inputs={"target": InputSettings(**settings)})


def said_of(scenario: Scenario, trace: Trace) -> tuple[str, str, str]:
    """Verdict, and the explanation's kind and sentence."""
    found = explain_run(scenario, trace)
    said = summarize(scenario, {trace.controller: trace}).verdicts
    return said[trace.controller], found.kind, found.sentence


def fed(folder: Path, *rows: str, **settings: Any) -> Scenario:
    """Steered by what a file says was sent."""
    path = folder / "sent.csv"
    path.write_text("\n".join(("t,x,y,z", *rows)), encoding="utf-8")
    return steered(feed_file=path, **settings)


NEAR = [f"{t:.2f},0.185,0.0,0.04" for t in np.arange(0.0, 0.6, 0.02)]


def test_an_input_that_nobody_feeds_reaches_nothing() -> None:
    scenario = steered()
    trace = run(scenario, controller="qp")
    assert not list(disagreements(scenario, trace, drawn_too=True))
    said, kind, sentence = said_of(scenario, trace)
    assert "nothing that can be used arrives at the input target" in said
    assert kind == "input"
    assert "nothing that can be used arrives at the input target" in sentence


def test_an_input_that_is_refused_to_the_end_reaches_nothing(tmp_path: Path) -> None:
    scenario = fed(tmp_path, *NEAR[:20], *(f"{t:.2f},1e9,0,0" for t in np.arange(0.4, 0.7, 0.01)))
    trace = run(scenario, controller="qp")
    assert assess(trace).inputs.refused_at_end
    assert not list(disagreements(scenario, trace, drawn_too=True))
    assert said_of(scenario, trace)[1] == "input"


def test_an_input_that_falls_silent_may_have_led_there(tmp_path: Path) -> None:
    scenario = fed(tmp_path, *NEAR[:2], when_stale="hold")
    trace = run(replace(scenario, duration=1.5), controller="qp")
    assert assess(trace).inputs.stale
    assert assess(trace).reached
    assert not list(disagreements(replace(scenario, duration=1.5), trace, drawn_too=True))


def test_a_loop_that_nothing_corrects_opens_and_no_goal_counts_as_kept() -> None:
    """``cases/answers/kappa_zero.yaml``: half a millimetre, which is closed for no one."""
    goal = PointOnPoint(name="reach", goal=(0.13, 0.05, 0.03), gain=5.0)
    scenario = short(tasks=(goal,), kappa=0.0, duration=2.5)
    trace = run(scenario, controller="qp")
    found = assess(trace)
    assert found.reached
    assert found.broken == ("loop",)
    assert not list(disagreements(scenario, trace, drawn_too=True))
    said, kind, sentence = said_of(scenario, trace)
    assert "lets the loop open by" in said
    assert kind == "open"
    assert "kappa: 0 corrects no drift" in sentence


def test_hands_torn_apart_reach_nothing() -> None:
    goal = PointOnPoint(name="reach", goal=(0.5, 0.0, 0.0), gain=20.0)
    scenario = short(tasks=(goal,))
    trace = run(scenario, controller="pseudoinverse")
    assert any(task.torn for task in assess(trace).tasks)
    still = replace(trace, task_error=0.0 * trace.task_error)
    assert not assess(still).reached
    for each in (trace, still):
        assert not list(disagreements(scenario, each))


def test_a_lost_object_reaches_nothing() -> None:
    scenario = short(plant=RigidBody(), duration=0.1)
    trace = run(scenario, controller="qp")
    held = np.ones((trace.ticks, 1))
    held[5:] = 0.0
    cause = Status.OBJECT_LOST
    lost = replace(
        trace,
        signals={**trace.signals, "held": held},
        status=(*trace.status[:5], *[cause.name] * (trace.ticks - 5)),
        failures=tuple(Failure(k, cause.value, "slips") for k in range(5, trace.ticks)),
    )
    found = assess(lost)
    assert (found.held, found.reached, found.lost_tick) == (False, False, 5)
    assert "hold" in found.broken
    told = [word for word in disagreements(scenario, lost) if "verdict, hold" not in word]
    assert not told  # whose metrics are those of a plant without hands that press


def test_an_error_that_is_no_number_is_none() -> None:
    scenario = short(duration=0.1)
    trace = run(scenario, controller="qp")
    trace.task_error[-1, 0] = np.nan
    assert not assess(trace).reached
    assert not list(disagreements(scenario, trace))


def test_motors_at_their_limit_are_told_by_all() -> None:
    scenario = short()
    trace = run(scenario, controller="qp")
    at_limit = np.zeros_like(trace.v)
    at_limit[::2, 3] = 1.0
    signals = {"tau": np.zeros_like(trace.v), "saturated": at_limit}
    weak = replace(trace, signals=signals, effort=np.ones_like(trace.effort))
    assert assess(weak).saturated == {trace.joints[3]: 0.5}
    assert not list(disagreements(scenario, weak))
    said, _, sentence = said_of(scenario, weak)
    words = f"the motor of {trace.joints[3]} in 50 % of the ticks"
    assert f"saturates {words}" in said
    assert f"saturates {words}" in sentence


def test_who_swings_for_ever_oscillates_to_the_end() -> None:
    scenario = short()
    trace = run(scenario, controller="qp")
    assert assess(trace).motion != "oscillating"
    q = trace.q.copy()
    q[:, 0] += 0.01 * np.sin(2.0 * np.pi * 25.0 * trace.t)
    swings = replace(trace, q=q)
    found = assess(swings)
    assert found.motion == "oscillating"
    assert found.oscillation
    assert found.oscillation.frequency == pytest.approx(25.0, rel=0.35)
    assert not list(disagreements(scenario, swings))
    assert f"{trace.joints[0]} oscillates to the end by" in said_of(scenario, swings)[0]


def test_a_phase_that_missed_is_missed_by_all(tmp_path: Path) -> None:
    scenario = phased(tmp_path)
    trace = run(scenario, controller="qp")
    assert not list(disagreements(scenario, trace, drawn_too=True))
    trace.task_error[60, 0] = 0.1
    assert [task.name for task in assess(trace).missed] == ["carry.reach"]
    assert not list(disagreements(scenario, trace))


def test_what_began_outside_and_came_back_breaks_nothing() -> None:
    scenario = short()
    trace = run(scenario, controller="qp")
    upper, q = trace.upper.copy(), trace.q.copy()
    upper[0] = q[0, 0] - 0.05
    q[1:, 0] = np.minimum(q[1:, 0], upper[0] - 0.01)
    outside = replace(trace, q=q, upper=upper)
    found = assess(outside)
    assert [overrun.name for overrun in found.joints] == [trace.joints[0]]
    assert found.succeeds
    assert not list(disagreements(scenario, outside))


@pytest.mark.parametrize("which", ["unfed", "open", "broken", "reached"])
def test_a_run_in_a_file_is_explained_as_the_same_in_memory(tmp_path: Path, which: str) -> None:
    open_loop = {"kappa": 0.0, "tasks": (PointOnPoint(name="reach", goal=(0.13, 0.05, 0.03)),)}
    scenario = {
        "unfed": steered(), "open": short(**open_loop, duration=2.5), "reached": short(),
        "broken": coopqp.load("point_on_point"),
    }[which]  # fmt: skip
    name = "pseudoinverse" if which == "broken" else "qp"
    trace = run(scenario, controller=name)
    path = tmp_path / "trace.csv"
    path.write_text(files.trace_csv(summarize(scenario, {name: trace})), encoding="utf-8")
    read = trace_from_file(path, scenario, name)
    memory, file = (explain_run(scenario, each) for each in (trace, read))
    assert (file.kind, file.sentence) == (memory.kind, memory.sentence)


def test_hands_that_move_along_a_held_object_keep_it_in_a_file_too(tmp_path: Path) -> None:
    """What tears an object off firm hands is no more than a slide of hands that press."""
    scenario = replace(coopqp.load("nao_presses"), duration=0.3)
    name = next(iter(scenario.controllers))
    trace = run(scenario, controller=name)
    slid = replace(trace, loop_position=trace.loop_position + 2e-3)
    path = tmp_path / "trace.csv"
    path.write_text(files.trace_csv(summarize(scenario, {name: slid})), encoding="utf-8")
    memory, file = (assess(each) for each in (slid, trace_from_file(path, scenario, name)))
    assert memory.held
    assert file.held
    assert [task.torn for task in file.tasks] == [task.torn for task in memory.tasks]
    assert not any(task.torn for task in file.tasks)


class Unaudited(Limit):
    """A limit that does not say what it left."""

    def rows(self, chain: coopqp.ClosedChain) -> tuple[()]:
        return ()

    def bind(self, chain: coopqp.ClosedChain, dt: float) -> Any:
        return lambda state, rows: None


def test_a_limit_that_says_nothing_of_itself_is_not_audited() -> None:
    like = short(duration=0.1)
    scenario = replace(like, limits=(*like.limits, Unaudited()))
    trace = run(scenario, controller="qp")
    assert trace.unaudited
    assert f"but {trace.unaudited[0]} is not audited" in said_of(scenario, trace)[0]


def test_the_demo_is_told_how_hard_it_accelerates() -> None:
    scenario = coopqp.load("point_on_point")
    trace = run(scenario, controller="qp", timed=False)
    worst = assess(trace).acceleration
    assert worst
    change = np.abs(np.diff(trace.v, axis=0, prepend=0.0)) / trace.dt
    assert worst.value == pytest.approx(change.max())
    assert f"accelerates {worst.joint} by {worst.value:.0f} rad/s2" in said_of(scenario, trace)[0]
    calm = run(scenario, controller="pseudoinverse", timed=False)
    assert not assess(calm).acceleration.exceeds  # type: ignore[union-attr]
    assert not list(disagreements(scenario, trace, drawn_too=True))
    assert not list(disagreements(scenario, calm, drawn_too=True))


@pytest.mark.parametrize("seed", SEEDS)
def test_random_rollouts_are_told_alike(seed: int) -> None:
    assert not list(of_stress(seed))


def test_the_page_prints_every_threshold() -> None:
    text = PAGE.read_text(encoding="utf-8")
    for name, threshold in TABLE.items():
        line = f"| `{name}` | {float(threshold):g} | {threshold.unit} | {threshold.reason} |"
        assert line in text, line
