"""Loops that open and close on the way: grasp, release and regrasp as phases."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from command_line import typed
from scenario_files import HEAD, PHASES, TAIL, needs_robots, phased, write

from coopqp.assessment import assess
from coopqp.base.errors import ScenarioError, UnknownNameError
from coopqp.base.spec import Array
from coopqp.execution.comparison import compare, summarize
from coopqp.execution.controller_run import run
from coopqp.report import files
from coopqp.report.mobility import study
from coopqp.scenario.loader import load
from coopqp.scenario.scenario import Scenario
from coopqp.study.tick_record import TickRecord
from coopqp.trace import Trace

ALONE, AGAIN = 60, 120  # first ticks of the later phases


@pytest.fixture(scope="module")
def regrasped(tmp_path_factory: pytest.TempPathFactory) -> tuple[Scenario, Trace]:
    """The scenario above and its run."""
    made = phased(tmp_path_factory.mktemp("phases"))
    return made, run(made, controller="qp")


def in_the_hand(made: Scenario, trace: Trace, arm: str, rows: slice) -> Array:
    """The object's pose in a hand, from the robot's own model, shape (rows, 12)."""
    robot = made.robot_model
    model, data = robot.model, robot.model.createData()
    tip = model.getFrameId(next(a.tip for a in robot.arms if a.name == arm))
    found = []
    for q, p, R in zip(trace.q[rows], trace.position[rows], trace.rotation[rows], strict=True):
        pin.framesForwardKinematics(model, data, q[: model.nq])
        found.append(data.oMf[tip].actInv(pin.SE3(R, p)).homogeneous[:3].ravel())
    return np.array(found)


def test_the_object_keeps_its_place_in_the_hands_that_hold_it(
    regrasped: tuple[Scenario, Trace],
) -> None:
    made, trace = regrasped
    whole = in_the_hand(made, trace, "right", slice(None))
    np.testing.assert_allclose(whole, np.tile(whole[0], (len(whole), 1)), atol=2e-4)
    first = in_the_hand(made, trace, "left", slice(0, ALONE + 1))
    np.testing.assert_allclose(first, np.tile(first[0], (len(first), 1)), atol=2e-4)
    last = in_the_hand(made, trace, "left", slice(AGAIN, None))
    np.testing.assert_allclose(last, np.tile(last[0], (len(last), 1)), atol=2e-4)
    assert np.abs(first[0] - last[0]).max() > 0.05, "it has taken hold elsewhere"


def test_a_run_goes_on_without_a_jump_and_inside_its_limits(
    regrasped: tuple[Scenario, Trace],
) -> None:
    made, trace = regrasped
    assert trace.ticks == made.ticks == 170
    np.testing.assert_allclose(trace.t, 0.01 * np.arange(171), atol=1e-12)
    np.testing.assert_allclose(np.diff(trace.q, axis=0), 0.01 * trace.v, atol=1e-15)
    assert np.abs(np.diff(trace.position, axis=0)).max() < 2e-3
    assert ((trace.lower <= trace.q) & (trace.q <= trace.upper)).all()
    assert (np.abs(trace.v) <= trace.velocity + 1e-12).all()
    assert trace.loop_position.max() < 1e-4
    assert not trace.loop_position[ALONE + 1 : AGAIN + 1].any()


def test_each_phase_answers_for_its_own_tasks(regrasped: tuple[Scenario, Trace]) -> None:
    _, trace = regrasped
    names = [task.name for task in trace.tasks]
    assert names == ["carry.reach", "alone.stay", "alone.away", "again.up"]
    known = np.isfinite(trace.task_error)
    assert [np.flatnonzero(column)[[0, -1]].tolist() for column in known.T] == [
        [0, ALONE], [ALONE, AGAIN], [ALONE, AGAIN], [AGAIN, 170],
    ]  # fmt: skip
    reached = assess(trace).errors <= [task.tolerance for task in trace.tasks]
    assert reached.all(), assess(trace).errors
    metrics = summarize(*_as_comparison(regrasped)).metrics["qp"]
    assert metrics["reached"]
    assert set(metrics["task_error"]) == set(names)


def _as_comparison(regrasped: tuple[Scenario, Trace]) -> tuple[Scenario, Mapping[str, Trace]]:
    made, trace = regrasped
    return made, {"qp": trace}


def test_a_posture_of_one_arm_leaves_the_other_to_the_object(tmp_path: Path) -> None:
    """Both count alike; the joints of the arm that holds the object are not asked to rest."""
    stay, lifted = "0.01, 0.06], gain: 5, profile: {duration: 0.1}", "-0.01, 0.07], gain: 5"
    lift = PHASES.replace(stay, lifted + ", profile: {duration: 0.3}")
    assert lift != PHASES
    text = HEAD + lift.replace("    duration: 0.6\n    released", "    duration: 1.5\n    released")
    trace = run(phased(tmp_path, text + TAIL), controller="qp")
    reached = dict(zip([t.name for t in trace.tasks], assess(trace).errors, strict=True))
    assert reached["alone.stay"] < 5e-4
    assert reached["alone.away"] < 0.01


def test_one_phase_is_the_same_as_none(tmp_path: Path) -> None:
    tasks = "- point_on_point: {name: reach, goal: [0.17, 0.01, 0.06], gain: 5}\n"
    plain = phased(tmp_path, f"{HEAD}duration: 1.0\ntasks:\n  {tasks}{TAIL}")
    in_phases = phased(
        tmp_path, f"{HEAD}phases:\n  - name: all\n    duration: 1.0\n    tasks:\n    {tasks}{TAIL}"
    )
    one, other = run(plain, controller="qp"), run(in_phases, controller="qp")
    np.testing.assert_array_equal(one.q, other.q)
    np.testing.assert_array_equal(one.task_error, other.task_error)


def test_a_phase_that_changes_nothing_changes_nothing(tmp_path: Path) -> None:
    """Cut where the reference rests; the grasp is kept, so only rounding may differ."""
    goal = "- point_on_point: {goal: [0.17, 0.01, 0.06], gain: 5, profile: {duration: 0.5}}"
    rest = goal.replace("{duration: 0.5}", "{kind: step}")
    text = f"phases:\n  - name: a\n    duration: 0.8\n    tasks:\n    {goal}\n"
    text += f"  - name: b\n    duration: 0.4\n    tasks:\n    {rest}\n"
    cut = run(phased(tmp_path, HEAD + text + TAIL), controller="qp")
    whole = f"duration: 1.2\ntasks:\n  {goal}\n"
    np.testing.assert_allclose(
        cut.q, run(phased(tmp_path, HEAD + whole + TAIL), controller="qp").q, atol=1e-9
    )


def test_every_law_runs_through_the_phases(tmp_path: Path) -> None:
    laws = "[qp, pseudoinverse, pseudoinverse_null_space]"
    made = phased(tmp_path, (HEAD + PHASES + TAIL).replace("[qp]", laws))
    comparison = compare(made)
    for name, trace in comparison.traces.items():
        assert np.isfinite(trace.q).all(), name
        assert comparison.metrics[name]["reached"], name


def test_mobility_is_that_of_the_phase(tmp_path: Path) -> None:
    made = phased(tmp_path)
    found = {name: study(made, phase=name).mobility for name in ("carry", "alone", "again")}
    assert [(m.rank, m.freedom) for m in found.values()] == [(6, 4), (0, 10), (6, 4)]
    # NAO's arm of five joints leaves the object five motions when it holds it alone.
    assert [m.object_freedom for m in found.values()] == [4, 5, 4]
    assert [m.tasks_rank for m in found.values()] == [3, 3, 3]
    with pytest.raises(UnknownNameError, match="unknown phase 'aloan'; did you mean 'alone'"):
        study(made, phase="aloan")


# Files


def test_the_trace_names_the_phase_and_leaves_other_phases_errors_empty(
    regrasped: tuple[Scenario, Trace],
) -> None:
    text = files.trace_csv(summarize(*_as_comparison(regrasped)))
    rows = list(csv.DictReader(io.StringIO(text)))
    assert [rows[k]["phase"] for k in (0, ALONE - 1, ALONE, AGAIN, 170)] == [
        "carry", "carry", "alone", "again", "again",
    ]  # fmt: skip
    assert rows[0]["error[alone.away]"] == rows[AGAIN + 1]["error[alone.away]"] == ""
    assert float(rows[ALONE]["error[alone.away]"]) >= 0.0


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a report."""
    folder = tmp_path_factory.mktemp("phases")
    path = write(folder, HEAD + PHASES + TAIL)
    assert typed("compare", path, "--out", folder / "out").exit_code == 0
    return folder / "out"


@pytest.mark.parametrize("tick", [10, ALONE, 90, AGAIN, 150])
def test_a_tick_of_any_phase_can_be_kept_and_solved_again(
    written: Path, tmp_path: Path, tick: int
) -> None:
    out, kept = written, tmp_path / "tick.json"
    assert typed("explain", out, "--tick", tick, "--save", kept).exit_code == 0
    record = TickRecord.read(kept)
    with (out / "trace.csv").open(encoding="utf-8") as stream:
        row = list(csv.DictReader(stream))[tick]
    recorded = [float(row[f"v[{name}]"]) for name in load(out / "scenario.yaml").chain.joint_names]
    np.testing.assert_allclose(record.answer, recorded, atol=1e-6)
    loops = [row for row in record.equality_rows if row.kind == "loop"]
    assert len(loops) == (0 if ALONE <= tick < AGAIN else 6)


FAULTS = [
    ("released: [left]", "released: [lefft]", "phases[1].released: unknown arm 'lefft'; did you"),
    ("released: [left]", "released: [left, right]", "tasks[0]: 'stay' asks nothing of the hands"),
    ("released: [left]", "relaesed: [left]", "phases[1].relaesed: unknown key 'relaesed'"),
    ("name: alone", "name: carry", "phases[1].name: the name 'carry' is taken"),
    ("name: away,", "name: stay,", "phases[1].tasks[1]: the name 'stay' is taken"),
    ("    duration: 0.5\n", "", "phases[2].duration: is missing"),
    ("duration: 0.4", "duration: 4", "phases[0].tasks[0]: the reference of 'reach' arrives at 4 s"),
    ("goal: {left:", "goal: {leftt:", "phases[1].tasks[1]: "),
    ("controllers", "duration: 3\ncontrollers", "duration: belongs into each phase"),
    ("phases:", "tasks: []\nphases:", "tasks: belongs into each phase"),
    (PHASES, "phases:\n", "phases: needs at least one phase"),
    ("phases:", "phasen:", "unknown key 'phasen'; did you mean 'phases'"),
]  # fmt: skip


@pytest.mark.parametrize(("old", "new", "message"), FAULTS)
def test_a_fault_is_answered_with_its_place(
    tmp_path: Path, old: str, new: str, message: str
) -> None:
    text = HEAD + PHASES + TAIL
    assert old in text
    with pytest.raises(ScenarioError) as error:
        phased(tmp_path, text.replace(old, new, 1))
    assert message in str(error.value)


# The shipped scenario


@needs_robots
def test_pandas_regrasp_a_box_with_a_quarter_turn() -> None:
    made = load("regrasp")
    trace = run(made, controller="qp")
    assert (assess(trace).errors <= [task.tolerance for task in trace.tasks]).all()
    assert ((trace.lower <= trace.q) & (trace.q <= trace.upper)).all()
    lift = made.first_ticks[3]
    before = in_the_hand(made, trace, "right/arm", slice(0, 1)).reshape(3, 4)[:, :3]
    after = in_the_hand(made, trace, "right/arm", slice(lift, lift + 1)).reshape(3, 4)[:, :3]
    assert np.linalg.norm(pin.log3(before @ after.T)) == pytest.approx(np.pi / 2, abs=1e-3)
    classical = run(made, controller="pseudoinverse")
    beyond = np.maximum(classical.lower - classical.q, classical.q - classical.upper).max()
    assert beyond > 0.1, "which the pseudoinverse does beyond its limits"
