"""Verdict, metrics, table, study, random goals, explanation and page say the same of every run.

``python -m tests.assessment`` asks the same of all shipped scenarios and of many random rollouts.
"""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scenario_files import phased

import coopqp
from coopqp.assessment import assess
from coopqp.assessment.thresholds import TABLE
from coopqp.base.qp import Row
from coopqp.base.spec import Array
from coopqp.execution.comparison import summarize
from coopqp.execution.controller_run import run
from coopqp.limit import Limit
from coopqp.model.profile import Profile
from coopqp.plants import RigidBody
from coopqp.report import files
from coopqp.report.cells import NBSP, cells
from coopqp.scenario.input import InputSettings
from coopqp.scenario.scenario import Scenario
from coopqp.signals import Input
from coopqp.solver import Status
from coopqp.study.explanation import explain_run, words
from coopqp.study.trace_file import trace_from_file
from coopqp.tasks import PointOnPoint
from coopqp.trace import Failure, Trace

from .contract import disagreements, of_stress

PAGE = Path(__file__).parents[2] / "docs" / "assessment.md"
SEEDS = (*range(10), 337, 414)  # the last two stand still where they have arrived


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


def again(folder: Path, scenario: Scenario, trace: Trace) -> Trace:
    """The same, written and read."""
    path = folder / "trace.csv"
    comparison = summarize(scenario, {trace.controller: trace})
    path.write_text(files.trace_csv(comparison), encoding="utf-8")
    return trace_from_file(path, scenario, trace.controller)


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
    assert "no usable value arrives at the input target" in said
    assert kind == "input"
    assert "no usable value arrives at the input target" in sentence


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
    assert "kappa: 0, no Baumgarte stabilisation" in sentence


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


def test_an_error_that_is_no_number_is_none(tmp_path: Path) -> None:
    """Nor one that is infinite, which no file can hold."""
    scenario = short(duration=0.1)
    trace = run(scenario, controller="qp")
    for error in (np.nan, np.inf):
        trace.task_error[-1, 0] = error
        assert not assess(trace).reached
        assert not list(disagreements(scenario, trace))
        said = said_of(scenario, trace)
        assert "loses 'reach': its error is no number" in said[0].lower()
        assert said[1:] == ("failed", "the error of reach is no number")
        assert said_of(scenario, again(tmp_path, scenario, trace))[1:] == said[1:]


def test_motors_at_their_limit_are_told_by_all(tmp_path: Path) -> None:
    """Also where it is the law that heeds it, so that the plant has nothing to cut off."""
    scenario = short()
    trace = run(scenario, controller="qp")
    tau = np.zeros_like(trace.v)
    tau[::2, 3] = trace.effort[3]
    weak = replace(trace, signals={"tau": tau, "saturated": np.zeros_like(tau)})
    assert assess(weak).saturated == {trace.joints[3]: 0.5}
    assert assess(again(tmp_path, scenario, weak)).saturated == assess(weak).saturated
    assert not list(disagreements(scenario, weak))
    said, _, sentence = said_of(scenario, weak)
    words = f"the motor of {trace.joints[3]} in 50 % of the ticks"
    assert f"saturates {words}" in said
    assert f"saturates {words}" in sentence


def test_who_never_rests_oscillates_to_the_end() -> None:
    scenario = short()
    trace = run(scenario, controller="qp")
    assert assess(trace).motion != "oscillating"
    q = trace.q.copy()
    q[:, 0] += 0.01 * np.sin(2.0 * np.pi * 25.0 * trace.t)
    restless = replace(trace, q=q)
    found = assess(restless)
    assert found.motion == "oscillating"
    assert found.oscillation
    assert found.oscillation.frequency == pytest.approx(25.0, rel=0.35)
    assert not list(disagreements(scenario, restless))
    assert f"{trace.joints[0]} oscillates to the end by" in said_of(scenario, restless)[0]


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
    assert [violation.name for violation in found.joints] == [trace.joints[0]]
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
    read = again(tmp_path, scenario, trace)
    memory, file = (explain_run(scenario, each) for each in (trace, read))
    assert (file.kind, file.sentence) == (memory.kind, memory.sentence)
    assert assess(read).motion == assess(trace).motion
    np.testing.assert_array_equal(read.rate, trace.rate)


def test_hands_that_move_along_a_held_object_keep_it_in_a_file_too(tmp_path: Path) -> None:
    """What tears an object off firm hands is no more than a slide of hands that press."""
    scenario = replace(coopqp.load("nao_presses"), duration=0.3)
    name = next(iter(scenario.controllers))
    trace = run(scenario, controller=name)
    slid = replace(trace, loop_position=trace.loop_position + 2e-3)
    memory, file = (assess(each) for each in (slid, again(tmp_path, scenario, slid)))
    assert memory.held
    assert file.held
    assert [task.torn for task in file.tasks] == [task.torn for task in memory.tasks]
    assert not any(task.torn for task in file.tasks)


class Unaudited(Limit):
    """A limit that does not say what it left."""

    def bind(self, chain: coopqp.ClosedChain, dt: float) -> Any:
        return lambda state, rows: None


def test_a_limit_that_says_nothing_of_itself_is_not_audited() -> None:
    like = short(duration=0.1)
    scenario = replace(like, limits=(*like.limits, Unaudited()))
    trace = run(scenario, controller="qp")
    assert trace.unaudited
    assert f"but {trace.unaudited[0]} is not audited" in said_of(scenario, trace)[0]


class Says(Unaudited):
    """A limit that says something of itself."""

    def __init__(self, said: Any) -> None:
        self.said = said

    def margins(self, chain: coopqp.ClosedChain, q: Array, v: Array, dt: float) -> dict[Row, Array]:
        found: dict[Row, Array] = self.said(len(v))
        return found


OWN = Row(name="limit.own", kind="limit", owner="own", unit="N", label="own limit")


@pytest.mark.parametrize(
    ("said", "why"),
    [
        (lambda ticks: 1 / 0, "raises ZeroDivisionError"),
        (lambda ticks: None, "raises AttributeError"),
        (lambda ticks: {OWN: "much"}, "raises ValueError"),
        (lambda ticks: {"own": np.ones(ticks)}, "has the key 'own', needs a Row"),
        (lambda ticks: {OWN: np.ones(ticks + 1)}, "gives the shape"),
        (lambda ticks: {OWN: np.full(ticks, np.nan)}, "gives nan for 'limit.own'"),
        (lambda ticks: {OWN: np.full(ticks, -np.inf)}, "gives -inf for 'limit.own'"),
        (lambda ticks: {replace(OWN, owner="position"): np.ones(ticks)}, "owner 'position'"),
    ],
)
def test_a_limit_that_says_nonsense_of_itself_is_not_audited(
    tmp_path: Path, said: Any, why: str
) -> None:
    like = short(duration=0.1)
    scenario = replace(like, limits=(*like.limits, Says(said)))
    trace = run(scenario, controller="qp")
    for each in (trace, again(tmp_path, scenario, trace)):
        told = said_of(scenario, each)[0]
        assert re.search(rf"but \w+ \(.*{why}.*\) is not audited", told), told
        assert assess(each).broken == ()


def test_the_table_has_what_was_broken_whatever_its_unit() -> None:
    like = short(duration=0.1)
    sinks = Says(lambda ticks: {OWN: np.linspace(1.0, -2.0, ticks)})
    scenario = replace(like, limits=(*like.limits, sinks))
    trace = run(scenario, controller="qp")
    assert not list(disagreements(scenario, trace))
    cell = cells(trace, summarize(scenario, {"qp": trace}).metrics["qp"])["limit"]
    assert (cell.lines, cell.bad) == ((f"own: 2{NBSP}N",), True)


def test_who_is_beyond_a_limit_is_not_at_it_and_by_one_amount() -> None:
    scenario = coopqp.load("joint_limit_stress")
    trace = run(scenario, controller="pseudoinverse")
    q = trace.q.copy()
    i, row = next((i, row) for row, i in zip(*np.nonzero(q > trace.upper), strict=True))
    start = float(trace.upper[i]) + 0.01
    q[0, i], q[row, i] = start, start + 0.02
    outside = replace(trace, q=q)
    found = assess(outside)
    (worst,) = (violation for violation in found.joints if violation.name == trace.joints[i])
    assert not {o.name for o in found.joints} & set(found.at_limits(0))
    assert f"{worst.by:.3g} rad" in words.broken(found)


@pytest.mark.parametrize(("error", "said"), [(4e-6, "0.004 mm"), (0.0123, "12.3 mm")])
def test_what_is_missed_has_digits_enough(error: float, said: str) -> None:
    scenario = short(duration=0.1)
    trace = run(scenario, controller="qp")
    trace.task_error[-1, 0] = error
    strict = replace(trace, tasks=(replace(trace.tasks[0], tolerance=1e-9),))
    found = summarize(scenario, {"qp": strict}).verdicts["qp"]
    assert found.startswith(f"Ends {said} off the goal of 'reach'")


def test_a_task_without_weight_is_told_so() -> None:
    goal = PointOnPoint(name="reach", goal=(0.19, 0.0, 0.05), weight=0.0, gain=20.0)
    scenario = short(tasks=(goal,))
    _, kind, sentence = said_of(scenario, run(scenario, controller="qp"))
    assert kind == "weight"
    assert "reach has weight: 0" in sentence


def test_an_acceleration_hardly_above_what_is_allowed_is_no_multiple() -> None:
    scenario = short()
    trace = run(scenario, controller="qp")
    worst = assess(trace).acceleration
    assert worst
    v = trace.v * (1.004 * worst.allowed / worst.value)
    said = summarize(scenario, {"qp": replace(trace, v=v)}).verdicts["qp"]
    assert "0.4 % more than what the loop for robots allows" in said
    rounded = replace(trace, v=trace.v * (worst.allowed * (1.0 + 1e-14) / worst.value))
    assert not assess(rounded).acceleration.exceeds  # type: ignore[union-attr]
    assert "accelerates" not in summarize(scenario, {"qp": rounded}).verdicts["qp"]


def test_the_demo_is_told_how_hard_it_accelerates() -> None:
    scenario = coopqp.load("point_on_point")
    trace = run(scenario, controller="qp", timed=False)
    worst = assess(trace).acceleration
    assert worst
    change = np.abs(np.diff(trace.v, axis=0, prepend=0.0)) / trace.dt
    assert worst.value == pytest.approx(change.max())
    assert f"accelerates {worst.joint} at {worst.value:.0f} rad/s2" in said_of(scenario, trace)[0]
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
