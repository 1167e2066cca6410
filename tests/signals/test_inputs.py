"""Values that arrive from outside: followed, stale, refused, recorded and repeated."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from coopqp.base.errors import CoopqpError, ScenarioError
from coopqp.execution.comparison import compare
from coopqp.execution.controller_run import run
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.state import State
from coopqp.recordings import read
from coopqp.report.files import write
from coopqp.scenario.input import Inputs, InputSettings
from coopqp.scenario.loader import load
from coopqp.scenario.scenario import Scenario
from coopqp.signals import Circle, Input, Line, Waypoints
from coopqp.solver import Status
from coopqp.study.trace_file import recorded_tick, state_from_trace
from coopqp.task import Task
from coopqp.tasks import Distance, Orientation, PointOnPoint, Twist

DT = 0.01
CENTER = (0.17, 0.0, 0.06)


def open_inputs(chain: ClosedChain, task: Task, **settings: Any) -> tuple[Inputs, State]:
    start = State(chain)
    return Inputs({"target": InputSettings(**settings)}, [task], start, DT), start


REACH = PointOnPoint(goal=Input(name="target"))


def tick(inputs: Inputs, state: State, *arrivals: tuple[str, Any, float]) -> None:
    inputs.step(state, arrivals)
    state.t += DT


def test_an_input_begins_where_nothing_has_to_move(chain: ClosedChain) -> None:
    inputs, state = open_inputs(chain, replace(REACH, point=(0.01, 0.02, 0.03)))
    np.testing.assert_array_equal(
        inputs.channels["target"].value, state.point(np.array([0.01, 0.02, 0.03]))
    )
    tick(inputs, state)
    assert state.inputs.stale == ("target",), "nothing has arrived"
    assert not state.inputs["target"].rate.any()


def test_a_value_is_followed_and_goes_stale(chain: ClosedChain) -> None:
    for when, rests in (("brake", True), ("hold", False)):
        inputs, state = open_inputs(chain, REACH, stale_after=0.2, when_stale=when)
        goal = state.p_WO + np.array([0.2, 0.0, 0.0])
        for k in range(30):
            tick(inputs, state, *([("target", goal, state.t)] if k < 10 else []))
        assert state.inputs.stale == (() if state.t - 0.09 <= 0.2 else ("target",))
        for _ in range(400):
            tick(inputs, state)
        assert state.inputs.stale == ("target",)
        left = np.linalg.norm(state.inputs["target"].value - goal)
        assert (left > 0.05) == rests
        assert np.abs(state.inputs["target"].rate).max() < 1e-9


@pytest.mark.parametrize(
    ("value", "sent", "words"),
    [
        ([1, 2], 0.0, "target: found shape (2,), needs 3 numbers: x, y, z"),
        ([1, 2, math.nan], 0.0, "target: has NaN or infinite values"),
        ([1, 2, math.inf], 0.0, "target: has NaN or infinite values"),
        ("here", 0.0, "target: found 'here', needs 3 numbers"),
        (None, 0.0, "target: found None, needs 3 numbers"),
        ([0, 0, 1e9], 0.0, "target: found 1e+09, which is nowhere"),
        ([0, 0, 0], 1.0, "target: is from the future"),
        ([0, 0, 0], math.nan, "target: is from the future"),
        ([0, 0, 0], -1.0, "target: is older than the last"),
    ],
)
def test_what_cannot_be_used_is_refused_in_words(
    value: Any, sent: float, words: str, chain: ClosedChain
) -> None:
    inputs, state = open_inputs(chain, REACH)
    tick(inputs, state, ("target", state.p_WO, 0.0))
    before = inputs.channels["target"].target.copy()
    tick(inputs, state, ("target", value, sent))
    assert words in state.inputs.refused[0]
    np.testing.assert_array_equal(inputs.channels["target"].target, before)
    tick(inputs, state, ("trget", state.p_WO, 0.0))
    assert state.inputs.refused == ("trget: no such input",)


def test_a_value_that_cannot_even_be_looked_at_is_refused(chain: ClosedChain) -> None:
    class Odd:
        def __array__(self, *_: object, **__: object) -> None:
            raise ZeroDivisionError

    inputs, state = open_inputs(chain, REACH)
    tick(inputs, state, ("target", Odd(), 0.0))
    assert "target: found" in state.inputs.refused[0]
    assert "needs 3 numbers" in state.inputs.refused[0]


def test_a_value_beyond_its_bounds_is_taken_as_the_bound(chain: ClosedChain) -> None:
    inputs, state = open_inputs(chain, REACH, lower=[0, 0, 0], upper=[0.2, 0.01, 0.1])
    tick(inputs, state, ("target", [9, -9, 0.05], 0.0))
    np.testing.assert_array_equal(inputs.channels["target"].target, [0.2, 0, 0.05])


def sending(signal: Any, **settings: Any) -> Scenario:
    scenario = load("point_on_point")
    settings = {"feed": signal, "velocity": 0.1, **settings}
    task = replace(scenario.tasks[0], goal=Input(name="target"))
    return replace(
        scenario, tasks=(task,), inputs={"target": InputSettings(**settings)}, duration=2.0
    )


WAY = Line(start=[0.16, -0.02, 0.05], end=[0.16, 0.02, 0.08], period=1.5)


def test_a_run_says_when_an_input_is_stale_or_refused() -> None:
    trace = run(sending(WAY), controller="qp")
    assert set(trace.status) == {"OPTIMAL"}
    silent = run(sending(None), controller="qp")
    assert set(silent.status) == {"INPUT_STALE"}
    assert np.abs(silent.v).max() < 0.2, "joint centring alone"
    assert not silent.failures


def test_a_goal_that_was_never_heard_of_is_not_reached(tmp_path: Path) -> None:
    """Values from the future are refused, and nothing comes: the arms are where they began."""
    path = tmp_path / "ahead.csv"
    path.write_text("t,sent,x,y,z\n0,9,0.16,0,0.06\n1,9,0.16,0,0.06\n", encoding="utf-8")
    fed = compare(sending(None, feed_file=path), controllers=["qp"])
    silent = compare(sending(None), controllers=["qp"])
    for found, refused_in in ((fed, 2), (silent, 0)):
        metrics, verdict = found.metrics["qp"], found.verdicts["qp"]
        assert not metrics["reached"]
        assert verdict.startswith("Reaches no goal: no usable value arrives at the input")
        assert metrics["input_ticks"]["refused"] == refused_in
        assert metrics["input_ticks"]["stale"] == metrics["ticks"] == 200
        assert "has an input stale in 200 of 200 ticks" in verdict
    assert "has an input refused in 2 of 200 ticks" in fed.verdicts["qp"]


def test_a_goal_that_is_refused_to_the_end_is_not_reached() -> None:
    """What the limiter finds no way to; its bounds are put past what reading a scenario takes."""
    scenario = sending(WAY)
    object.__setattr__(scenario.inputs["target"], "velocity", 1e19)
    object.__setattr__(scenario.inputs["target"], "acceleration", 1e19)
    object.__setattr__(scenario.inputs["target"], "jerk", 1e19)
    found = compare(scenario, controllers=["qp"])
    assert found.metrics["qp"]["input_ticks"]["refused"] == 199
    assert not found.metrics["qp"]["reached"]
    assert "Reaches no goal: the last values at an input are refused" in found.verdicts["qp"]


def test_inputs_that_are_followed_are_none_of_a_verdicts_business() -> None:
    found = compare(sending(WAY), controllers=["qp"])
    metrics = found.metrics["qp"]["input_ticks"]
    assert (metrics["refused"], metrics["stale"], metrics["nothing_at"]) == (0, 0, [])
    assert "input" not in found.verdicts["qp"]


def test_tasks_follow_the_limited_value() -> None:
    trace = run(sending(WAY), controller="qp")
    kept = trace.inputs["target"]
    speed = np.linalg.norm(kept.rate, axis=1)
    assert 0.05 < speed.max() <= 0.1 + 1e-9
    assert trace.task_error[:, 0].max() < 1e-3
    assert np.linalg.norm(kept.arrived[0] - kept.value[0]) > 0.02, "it jumped"


def test_what_was_sent_gives_the_same_joints_bit_for_bit(tmp_path: Path) -> None:
    """A session, its values as a file, and the same scenario fed by the file."""
    first = run(sending(WAY), controller="qp")
    kept = first.inputs["target"]
    path = tmp_path / "target.csv"
    lines = ["t,sent,x,y,z"]
    rows = zip(first.t.tolist(), kept.sent.tolist(), kept.arrived.tolist(), strict=False)
    lines += [",".join(map(repr, (t, sent, *value))) for t, sent, value in rows]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    scenario = sending(None, feed_file=path)
    for controller in scenario.controllers:
        one, two = (run(s, controller=controller) for s in (sending(WAY), scenario))
        np.testing.assert_array_equal(one.q, two.q)
        np.testing.assert_array_equal(one.inputs["target"].value, two.inputs["target"].value)


@pytest.mark.few(1)
@pytest.mark.parametrize("k", [0, 37, 150])
def test_every_tick_can_be_repeated_from_the_trace(k: int, tmp_path: Path) -> None:
    text = scenario_text(tmp_path)
    scenario = load(text)
    comparison = compare(scenario, controllers=["qp"])
    write(comparison, tmp_path / "out")
    path, v = tmp_path / "out" / "trace.csv", comparison.traces["qp"].v[k]
    law = scenario.controllers["qp"].build(scenario.problem())
    np.testing.assert_array_equal(law.tick(state_from_trace(read(path), "qp", k, law)).v, v)
    record = recorded_tick(path, load(text), "qp", k)  # in Python, whichever engine it was
    np.testing.assert_allclose(record.answer, v, rtol=0.0, atol=1e-12)


INPUTS = """inputs:
  target:
    velocity: 0.1
    feed: {line: {start: [0.16, -0.02, 0.05], end: [0.16, 0.02, 0.08], period: 1.5}}
"""


def scenario_text(folder: Path, **changed: str) -> Path:
    path = Path(__file__).parents[2] / "scenarios" / "point_on_point.yaml"
    text = path.read_text(encoding="utf-8").replace("[0.13, 0.05, 0.03]", "{input: target}")
    text = text.replace("duration: 3.0", "duration: 2.0")
    text = text.replace("tasks:", changed.get("inputs", INPUTS) + "tasks:", 1)
    for old, new in changed.items():
        if old != "inputs":
            assert old in text
            text = text.replace(old, new)
    written = folder / "scenario.yaml"
    written.write_text(text, encoding="utf-8")
    return written


def refused(path: Path) -> Sequence[str]:
    with pytest.raises(ScenarioError) as caught:
        load(path)
    return str(caught.value).replace(f"{path}:", "").splitlines()


TASK = "17: tasks[0].point_on_point.goal"
FEED = "line: {start: [0.16, -0.02, 0.05], end: [0.16, 0.02, 0.08]"
FAULTS = [
    ({"input: target": "input: trget"}, f"{TASK}: unknown input 'trget'; did you mean 'target'?"),
    ({"input: target": "inptu: target"}, "unknown signal 'inptu'; did you mean 'input'?"),
    ({"velocity: 0.1": "velocty: 0.1"}, "unknown key 'velocty'; did you mean 'velocity' or"),
    ({"velocity: 0.1": "velocity: 1.0e-6"}, "found 1e-06, needs 0.001 to 100 m/s"),
    ({"velocity: 0.1": "jerk: 1.0e+9"}, "jerk: found 1e+09, needs 0.001 to 1e+06 m/s3"),
    ({f"{FEED}, period: 1.5}}": "input: target"}, "feed: input: an input cannot feed another"),
    ({"velocity: 0.1": "lower: [1, 2]"}, "lower: found 2 numbers, needs 3 for a point"),
    ({"start: [0.16, -0.02, 0.05]": "start: [0.16]"}, "start has 1 numbers, end 3"),
    ({FEED: "line: {start: [0], end: [1]"}, "line.start: found shape (1,), needs 3 numbers"),
    (
        {"{input: target}": "{circle: {center: [0, 0, 0], radius: 0.1}}"},
        f"{TASK}.circle.period: is missing",
    ),
    (
        {"{input: target}": "{waypoints: {times: [0, 1, 2], values: [0.15, 0, 0.06]}}"},
        "waypoints.values: found [0.15, 0, 0.06]; needs a list of numbers, or a pose, for each",
    ),
    ({"{input: target}": "{waypoints: {file: no.csv}}"}, "no.csv: cannot be read"),
]


@pytest.mark.parametrize(("changed", "line"), FAULTS)
def test_faults_of_signals_have_their_line(
    changed: dict[str, str], line: str, tmp_path: Path
) -> None:
    lines = refused(scenario_text(tmp_path, **changed))
    assert len(lines) == 1
    assert line in lines[0]


def test_files_with_faults_are_refused_with_what_is_there(tmp_path: Path) -> None:
    path = tmp_path / "way.csv"
    place = {"{input: target}": "{waypoints: {file: way.csv}}"}
    for text, words in (
        ("t,x,y,Z\n0,1,2,3\n1,1,2,3\n", "has no column 'z'; its columns are t, x, y, Z"),
        ("t,x,y,z\n0,1,2,3\n0,1,2,3\n", "way.csv:3: t: found 0 s after 0 s"),
        ("t,x,y,z\n0,1,2,3\n1,1,2,a\n", "way.csv:3: z: found 'a', needs a number"),
        ("t,x,y,z\n0,1,2,3\n1,1,2\n", "way.csv:3: found 3 cells, needs 4"),
        ("t;x;y;z\n0;1;2;3\n", "way.csv:1: its columns are separated by ';', needs commas"),
        ("t;x;y;z\n0,5;1;2;3\n", "way.csv:1: its columns are separated by ';', needs commas"),
        ("t,x,y,z\n0,1,2,3\n\n1,1,2,3\n", "way.csv:3: is a blank line; leave it out"),
        ("t,x,y,z\n", "has no rows"),
        ("t,x,y,z\n0,1,2,3\n", "needs at least 2 rows"),
        ("t,x,y,z\n0,1,2,\n1,1,2,3\n", "way.csv:2: z: needs a finite number"),
    ):  # fmt: skip
        path.write_text(text, encoding="utf-8")
        (line,) = refused(scenario_text(tmp_path, inputs="", **place))
        assert words in line


def test_where_nothing_says_where_an_input_begins_it_has_to_be_said(chain: ClosedChain) -> None:
    task = Distance(to=Input(name="target"), length=0.1)
    with pytest.raises(CoopqpError, match=r"where is the point before anything arrives\?"):
        open_inputs(chain, task)
    inputs, _ = open_inputs(chain, replace(task, to=Input(name="target", start=[1, 2, 3])))
    np.testing.assert_array_equal(inputs.channels["target"].value, [1, 2, 3])


def test_a_velocity_is_not_held_when_it_is_stale(chain: ClosedChain) -> None:
    task = Twist(velocity=Input(name="target"), components=("x", "y", "z"))
    with pytest.raises(CoopqpError, match="would go on for ever"):
        open_inputs(chain, task, when_stale="hold")
    inputs, state = open_inputs(chain, task, stale_after=0.05)
    for k in range(200):
        tick(inputs, state, *([("target", [0.1, 0, 0], state.t)] if k < 30 else []))
    assert not inputs.channels["target"].value.any()


def test_one_input_is_of_one_kind(chain: ClosedChain) -> None:
    tasks = [REACH, Orientation(goal=Input(name="target"))]
    with pytest.raises(CoopqpError, match="is wanted as a point and as a rotation"):
        Inputs({"target": InputSettings()}, tasks, State(chain), DT)


def test_phases_follow_an_input_one_after_the_other() -> None:
    scenario = load("regrasp")
    first = scenario.phases[0]
    there = State(scenario.chain).p_WO
    task = PointOnPoint(name="follow", goal=Input(name="target"))
    phases = (replace(first, tasks=(task,)), replace(first, name="again", tasks=(task,)))
    feed = Circle(center=tuple((there - [0.01, 0, 0]).tolist()), radius=0.01, period=2.0)  # type: ignore[arg-type]
    made = replace(scenario, phases=phases, inputs={"target": InputSettings(feed=feed)})
    trace = run(made, controller="qp")
    assert trace.inputs["target"].value.shape == (trace.ticks, 3)
    assert np.isfinite(trace.inputs["target"].value).all()


def test_the_status_has_words() -> None:
    assert "in time" in Status.INPUT_STALE.value
    assert Status.INPUT_STALE.usable
    assert Status.INPUT_REFUSED.usable
    assert Waypoints(times=[0, 1], values=[[0], [1]]).rest == 1.0


def test_a_value_of_a_file_arrives_in_the_tick_of_its_time(tmp_path: Path) -> None:
    """The loop's time is summed up: ten ticks of 0.01 s are a little less than 0.1 s."""
    path = tmp_path / "target.csv"
    rows = [f"{k / 100:.2f},{0.16 + k * 1e-5},0,0.06" for k in range(0, 150, 10)]
    path.write_text("\n".join(["t,x,y,z", *rows]) + "\n", encoding="utf-8")
    trace = run(sending(None, feed_file=path), controller="qp")
    arrived = np.flatnonzero(np.isfinite(trace.inputs["target"].sent))
    np.testing.assert_array_equal(arrived, range(0, 150, 10))
    assert not any("INPUT_REFUSED" in word for word in trace.status)
