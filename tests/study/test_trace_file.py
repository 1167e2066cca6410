"""Ticks of a written trace, done again."""

from __future__ import annotations

import csv
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from command_line import typed
from explained import traced
from kept_ticks import at, record
from laws import LIMITS
from scenario_files import HEAD, NO_DRIFT, PHASES

from coopqp.base.errors import CoopqpError, InvalidValueError
from coopqp.execution.comparison import Comparison, compare
from coopqp.limits import JointAcceleration
from coopqp.qp_law.law import QPLaw
from coopqp.recordings import read
from coopqp.scenario.loader import load
from coopqp.scenario.scenario import Scenario
from coopqp.study.tick_record import TickRecord
from coopqp.study.trace_file import blocked_tick, state_from_trace, trace_from_file


@pytest.mark.parametrize("tick", [0, 1, 57, 150, 299])
def test_tick_of_a_written_trace_is_done_again_bit_for_bit(
    tick: int, trace_csv: Path, compared: Comparison, scenario: Scenario
) -> None:
    """A new law, the state from the file: the command of the run."""
    law = scenario.controllers["qp"].build(scenario.problem())
    state = state_from_trace(read(trace_csv), "qp", tick, law)
    trace = compared.traces["qp"]
    assert state.t == trace.t[tick]
    np.testing.assert_array_equal(state.q, trace.q[tick])
    np.testing.assert_array_equal(state.v, trace.v[tick - 1] if tick else np.zeros(10))
    command = law.tick(state)
    np.testing.assert_array_equal(command.v, trace.v[tick])
    assert command.status.name == trace.status[tick]


def test_trace_with_acceleration_limits_and_shares_is_done_again(
    scenario: Scenario, tmp_path: Path
) -> None:
    """Acceleration limits look at the velocity of the tick before."""
    limits = (*LIMITS, JointAcceleration(max=20.0))
    tasks = (replace(scenario.tasks[0], mode="scaled"),)
    given = replace(scenario, limits=limits, tasks=tasks, duration=2.0, source="")
    done = compare(given, controllers=["qp"])
    written, trace = read(traced(done, tmp_path)), done.traces["qp"]
    for tick in (0, 30, 80):
        law = given.controllers["qp"].build(given.problem())
        command = law.tick(state_from_trace(written, "qp", tick, law))
        np.testing.assert_array_equal(command.v, trace.v[tick])
        assert command.scale == trace.scale[tick]


def test_explanation_from_the_file_is_that_of_the_run(
    trace_csv: Path, compared: Comparison, law: QPLaw
) -> None:
    from_file = record(law, state_from_trace(read(trace_csv), "qp", 250, law), 250)
    assert from_file == record(law, at(compared, law, 250), 250)


def test_trace_names_its_controllers(trace_csv: Path) -> None:
    assert read(trace_csv).controllers == ["qp", "pseudoinverse"]


def test_tick_worth_explaining_is_the_first_that_gave_something_up(
    trace_csv: Path, scenario: Scenario, tmp_path: Path
) -> None:
    """Else the last."""
    assert blocked_tick(read(trace_csv), "qp") == 299
    slow = replace(scenario, limits=(*LIMITS, JointAcceleration(max=10.0)), source="")
    done = compare(slow, controllers=["qp"])
    written = read(traced(done, tmp_path))
    fine = ("OPTIMAL", "INACCURATE")
    first = next(k for k, s in enumerate(done.traces["qp"].status) if s not in fine)
    assert blocked_tick(written, "qp") == first


@pytest.mark.parametrize("tick", [-1, 300, 100_000])
def test_tick_that_the_run_did_not_have_is_refused(tick: int, trace_csv: Path, law: QPLaw) -> None:
    with pytest.raises(InvalidValueError, match=f"has no tick {tick}; it has 0 to 299"):
        state_from_trace(read(trace_csv), "qp", tick, law)


def test_files_that_are_no_traces_are_refused(tmp_path: Path) -> None:
    other = tmp_path / "other.csv"
    other.write_text("a,b\n1,2\n", encoding="utf-8")
    with pytest.raises(CoopqpError, match=r"is not a trace\.csv"):
        read(other)
    with pytest.raises(CoopqpError, match="cannot be read: No such file"):
        read(tmp_path / "none.csv")


@pytest.mark.parametrize(
    ("old", "new", "line", "words"),
    [
        ("\nqp,7,", "\nqp,8,", 9, "tick: found 8, needs 7; the trace is damaged"),
        ("\nqp,7,", "\nqpp,7,", 9, "tick: found 7, needs 0; the trace is damaged"),
        ("\nqp,7,", "\nqp,7,0,", 9, r"found \d+ cells, but line 1 \d+; it is damaged"),
        ("q[RWristYaw]", "q[LWristYaw]", 1, r"two columns are called 'q\[LWristYaw\]'"),
        ("\nqp,300,", "\npqp,0,", 301, "'qp' has 299 ticks, its scenario 300; the file is"),
        ("q[RWristYaw]", "q[wrist]", 1, r"has no column 'q\[RWristYaw\]'"),
    ],
)
def test_a_damaged_trace_names_the_line(
    trace_csv: Path, scenario: Scenario, tmp_path: Path, old: str, new: str, line: int, words: str
) -> None:
    text = trace_csv.read_text(encoding="utf-8")
    assert old in text
    path = tmp_path / "trace.csv"
    path.write_text(text.replace(old, new, 1), encoding="utf-8")
    with pytest.raises(CoopqpError, match=rf"trace\.csv:{line}: {words}"):
        trace_from_file(path, scenario, "qp")


@pytest.mark.parametrize("value", ["", "1e300"])
@pytest.mark.parametrize("field", ["loop_position", "error[{}]"])
def test_a_column_that_says_nothing_is_damage(
    trace_csv: Path, scenario: Scenario, tmp_path: Path, field: str, value: str
) -> None:
    name = field.format(scenario.tasks[0].name)
    rows = list(csv.reader(trace_csv.read_text(encoding="utf-8").splitlines()))
    k = rows[0].index(name)
    with (tmp_path / "trace.csv").open("w", encoding="utf-8", newline="") as stream:
        csv.writer(stream).writerows([rows[0], *([*r[:k], value, *r[k + 1 :]] for r in rows[1:])])
    with pytest.raises(CoopqpError, match=rf"csv:2: {re.escape(name)}: .*; the trace is damaged"):
        trace_from_file(tmp_path / "trace.csv", scenario, "qp")


def test_a_tick_of_nobody_is_refused(trace_csv: Path) -> None:
    with pytest.raises(CoopqpError, match="unknown controller 'nobody'"):
        blocked_tick(read(trace_csv), "nobody")


def off_the_trace(folder: Path, text: str, tick: int) -> float:
    """How far the answer of an explained tick is from the one in its trace [rad/s]."""
    given, out, kept = folder / "in.yaml", folder / "out", folder / "tick.json"
    given.write_text(text, encoding="utf-8")
    for arguments in (
        ["compare", str(given), "--out", str(out)],
        ["explain", str(out), "--tick", str(tick), "--save", str(kept)],
    ):
        assert typed(*arguments).exit_code == 0
    with (out / "trace.csv").open(encoding="utf-8") as stream:
        row = list(csv.DictReader(stream))[tick]
    joints = load(out / "scenario.yaml").chain.joint_names
    recorded = np.array([float(row[f"v[{joint}]"]) for joint in joints])
    return float(np.abs(np.array(TickRecord.read(kept).answer) - recorded).max())


def test_a_tick_of_a_later_phase_is_explained_as_it_was_despite_noise(tmp_path: Path) -> None:
    noisy = "plant: rigid_body\ndisturbance: {noise_position: 0.001}\n"
    assert off_the_trace(tmp_path, HEAD + PHASES + NO_DRIFT + noisy, 90) < 1e-6


def test_a_tick_that_damps_by_what_it_missed_is_explained_as_it_was(tmp_path: Path) -> None:
    task = "duration: 1.0\ntasks:\n  - twist: {velocity: {x: 0.1, y: 0.15}}\n"
    assert off_the_trace(tmp_path, f"{HEAD}{task}{NO_DRIFT}plant: rigid_body\n", 40) < 1e-6


def test_a_run_in_which_an_arm_lets_go_and_moves_is_read(tmp_path: Path) -> None:
    """Its task is of one phase alone: there the arm moves by itself."""
    seed = Path(__file__).parents[1] / "fuzz" / "seeds" / "phases.yaml"
    scenario = load(seed)
    path = traced(compare(scenario), tmp_path)
    held = scenario.held_by("qp")
    assert len(trace_from_file(path, scenario, "qp").v) == held.ticks
