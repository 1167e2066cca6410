"""Runs that are late, in phases, of other laws, or in files that are damaged."""

from __future__ import annotations

import itertools
import json
import re
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from command_line import refused_in_one_line, typed
from explained import ADVICE, REACH, advice, explained, gap, nao, nearest, of_case
from laws import LIMITS, STEP
from own_task import Own
from ruamel.yaml import YAML
from scenario_files import HEAD, PHASES, TAIL, phased

from coopqp.assessment import assess
from coopqp.base.qp import Row
from coopqp.execution.controller_run import begin_phase, run
from coopqp.kernel import compiled
from coopqp.limits import (
    JointAcceleration,
    JointPosition,
    JointVelocity,
    Obstacle,
    Obstacles,
)
from coopqp.model.state import State
from coopqp.scenario.loader import load
from coopqp.solver import Budget
from coopqp.study.explanation import explain_run, insufficient_time, words
from coopqp.study.explanation.explained_phase import explained_phases, widen
from coopqp.study.explanation.goal import PositionLimits, Share
from coopqp.task import TaskRows
from coopqp.tasks import Twist

# Speed, time, budget


@pytest.mark.parametrize(
    ("limits", "word"),
    [
        ((JointPosition(), JointVelocity(scale=0.02)), "velocity of "),
        ((*LIMITS, JointAcceleration(max=0.05)), "acceleration of "),
    ],
)
def test_speeds_that_hold_up_are_named_with_the_time_that_would_do(
    limits: tuple[Any, ...], word: str
) -> None:
    """A run of the time that is said reaches the goal, one of nine tenths of it does not."""
    scenario = replace(load("point_on_point"), limits=limits, dt=0.005)
    found = explained(scenario)
    assert (found.kind, found.tried) == ("speed", True)
    assert found.held_back[0].words.startswith(word)
    (time,) = map(float, re.findall(r"a duration of ([\d.]+) s", found.sentence))
    assert time == found.time
    ends = [
        assess(run(replace(scenario, duration=share * time), controller="qp")).errors[0]
        for share in (1.0, 0.9)
    ]
    assert ends[0] <= scenario.tasks[0].tolerance < ends[1]


def test_a_loop_budget_that_is_used_up_is_what_is_blamed() -> None:
    """A thousandth of a millimetre: nearly every step is cut for it."""
    budget = Budget(loop_position=1e-6, loop_orientation=1e-5)
    scenario = replace(load("point_on_point"), kappa=0.0, budget=budget)
    cut = [s for s in run(scenario, controller="qp").status[-20:] if s != "OPTIMAL"]
    found = explained(scenario)
    assert len(cut) > 5
    assert (found.kind, found.tried, found.held_back) == ("budget", False, ())
    assert "the loops' budget is used up (kappa 0)" in found.sentence


def test_a_run_that_is_too_short_blames_nobody() -> None:
    task = replace(REACH, gain=2.0, profile=STEP)
    found = explained(nao(task, duration=1.0))
    assert (found.kind, found.tried, found.held_back) == ("short", True, ())
    assert "no limit is active; the run is too short" in found.sentence


def test_a_twist_that_is_too_fast_is_told_by_how_much() -> None:
    scenario = nao(Twist(name="tele", velocity={"z": 2.0}), duration=0.3)
    found = explained(scenario)
    assert found.kind == "speed"
    assert "times the available speed" in found.sentence
    assert all(held.words.startswith("velocity of ") for held in found.held_back)


# Phases, other laws, damaged runs


def test_the_phase_that_missed_is_explained_and_not_the_last(tmp_path: Path) -> None:
    far = "goal: [0.37, 0.01, 0.06], gain: 5, profile: {duration: 0.4}"
    text = (HEAD + PHASES + TAIL).replace(
        "goal: [0.17, 0.01, 0.06], gain: 5, profile: {duration: 0.4}", far, 1
    )
    scenario = phased(tmp_path, text)
    found = explained(scenario)
    assert (found.phase, found.kind, found.tick) == ("carry", "reach", 59)
    way = nearest(scenario.chain, (0.37, 0.01, 0.06))
    assert found.distance == pytest.approx(float(np.linalg.norm(way)), abs=5e-4)


def test_a_later_phase_is_explained_with_its_own_chain(tmp_path: Path) -> None:
    """The open left arm is asked beyond its elbow's limit; the law reaches what it then may."""
    text = (HEAD + PHASES + TAIL).replace("left: [0.5, 0.5, -1.0, -0.7, 0.1]", "LElbowRoll: 0.3")
    scenario = phased(tmp_path, text)
    found = explained(scenario)
    chain = scenario.chain
    i = chain.joint_names.index("LElbowRoll")
    assert (found.phase, found.kind, found.tried) == ("alone", "limits", True)
    assert [held.limit for held in found.held_back] == ["limit.position[LElbowRoll].upper"]
    (need,) = found.needed
    assert need.amount >= 0.3 - chain.upper[i] - 0.01  # the task's own tolerance


def test_a_law_that_knows_no_limits_is_not_blamed_on_them_but_told_to_break_them() -> None:
    scenario = load("joint_limit_stress")
    found = explained(scenario, "pseudoinverse")
    assert found.kind == "broken"
    trace, limit = run(scenario, controller="pseudoinverse"), 2.0 * np.pi
    worst = min(trace.margins, key=lambda row: trace.margins[row].min() if row.unit == "rad" else 0)
    by = -trace.margins[worst].min()
    assert 0.1 < by < limit
    assert found.sentence.startswith("the goals are reached, but beyond limits: ")
    assert f"{worst.label} by {by:.3g} rad" in found.sentence
    assert explained(nao(REACH)).sentence == "every goal is reached"


def test_bodies_that_hold_a_run_are_named_with_their_distance() -> None:
    """Also where it is a corner of them that holds, whose row belongs to no pair."""
    like = load("point_on_point")
    x, y, z = (like.chain.start_position + np.array([0.0, 0.0, 0.11])).tolist()
    slab = Obstacle(box=(0.4, 0.4, 0.05), position=(x, y, z))
    limits = (*like.limits, Obstacles(shapes={"slab": slab}, bodies=("object",)))
    phase = next(explained_phases(replace(like, limits=limits), run(like, controller="qp")))
    bounds = PositionLimits(phase.problem)
    corner = next(row for row in limits[-1].rows(like.chain) if "corner" in row.name)
    told = insufficient_time._with_nearest_pair(Share(corner, 1.0), bounds, like.chain.q_start)
    pose, half = State(like.chain), 0.5 * np.array(like.held.size)
    d = z - 0.025 - pose.p_WO[2] - np.abs(pose.R_WO[2]) @ half  # the slab is level
    assert told.row.bodies == ("object", "slab")
    assert told.row.label == f"the distance of object and slab ({1e3 * d:.1f} mm)"
    joint = Share(next(iter(bounds.sides.values())), 1.0)
    assert insufficient_time._with_nearest_pair(joint, bounds, like.chain.q_start) is joint


def test_joint_values_that_are_told_close_the_loops() -> None:
    """To two digits the hands were 13 mm apart."""
    scenario = load("point_on_point")
    phase = next(explained_phases(scenario, run(scenario, controller="qp")))
    said = words.start(phase.q[-1], phase.problem.chain)
    arms = dict(part.split(" ", 1) for part in said.split("; "))
    values = {arm: [float(x) for x in text.strip("[]").split(",")] for arm, text in arms.items()}
    q = scenario.robot_model.configuration(values)
    assert np.abs(gap(scenario.chain, q)).max() < 2e-5


def test_no_goal_counts_as_reached_where_the_loop_came_open() -> None:
    """The pseudoinverse follows the stretching twist by pulling the hands apart."""
    scenario = advice("nod")
    found = explained(scenario, "pseudoinverse")
    far = run(scenario, controller="pseudoinverse").loop_position.max()
    assert far > 0.1
    assert found.kind == "open"
    assert f"opened by {1e3 * far:.3g} mm" in found.sentence


def test_limits_are_as_wide_in_later_phases_as_in_the_first() -> None:
    """Each phase takes over the chain of the one before, and once widened it again."""
    like = load("regrasp")
    joint = like.chain.joint_names[0]
    row = Row(name="wide", kind="limit", joint=joint, side="upper")
    wider = replace(like)
    widen(wider, {row: 0.1})
    begun = None
    for _ in like.schedule:
        begun = begin_phase(wider, wider.controllers["qp"], begun, timed=False)
        more = begun.problem.chain.upper - like.chain.upper
        assert more[0] == pytest.approx(0.1)
        assert not more[1:].any()


def test_a_run_of_nans_says_its_status() -> None:
    scenario = nao(REACH, duration=0.2)
    trace = run(scenario, controller="qp")
    trace.q[-1, 0] = trace.task_error[-1] = np.nan
    status = (*trace.status[:-1], "NOT_FINITE")
    found = explain_run(scenario, replace(trace, status=status))
    assert found.kind == "failed"
    assert "the state or the answer has NaN or infinite values" in found.sentence


# From files


def test_a_robot_beside_its_scenario_is_found_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Written elsewhere, and explained from another folder; the rail's limit is in metres."""
    for file in ("gantry.yaml", "gantry.urdf"):
        shutil.copy(ADVICE / file, tmp_path / file)
    text = (tmp_path / "gantry.yaml").read_text(encoding="utf-8")
    far = tmp_path / "far.yaml"
    far.write_text(text.replace("[0.75, 0.1, 0]", "[1.25, 0.1, 0]"), encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    out = tmp_path / "out"
    assert typed("compare", "far.yaml", "--controllers", "qp", "--out", out).exit_code == 0
    monkeypatch.chdir("/")
    said = typed("explain", out)
    assert said.exit_code == 0
    assert "rail (upper)" in said.output
    assert "mm (tried: reached)" in said.output
    assert of_case("gantry").kind == "reached"


@pytest.mark.parametrize(
    "written",
    [
        lambda text: f"folder: .\n{text}",
        lambda text: f"---\n{text}...\n",
        lambda text: json.dumps(YAML(typ="safe").load(text)),
    ],
    ids=["own folder", "document", "JSON"],
)
def test_a_copied_scenario_finds_its_robot_however_it_is_written(
    written: Callable[[str], str], tmp_path: Path
) -> None:
    shutil.copy(ADVICE / "gantry.urdf", tmp_path / "gantry.urdf")
    given, copied = tmp_path / "given.yaml", tmp_path / "out" / "copied.yaml"
    given.write_text(written((ADVICE / "gantry.yaml").read_text(encoding="utf-8")), "utf-8")
    copied.parent.mkdir()
    copied.write_text(load(given).portable, encoding="utf-8")
    assert load(copied).robot_model.joint_names == load(given).robot_model.joint_names
    assert load(copied).portable == load(given).portable


DAMAGES = {
    "columns": lambda text: "\n".join(line[: line.rfind(",", 0, 200)] for line in text.split("\n")),
    "rows": lambda text: "\n".join(text.split("\n")[:6]) + "\n",
    "text": lambda text: text.replace("0.7", "zero", 1),
    "status": lambda text: text.replace("OPTIMAL", "FINE"),
    "binary": lambda text: text[:300] + "\x00\x01" + text[300:],
    "far away": lambda text: cell(text, 3, "q[RShoulderPitch]", "1e300"),
    "elsewhere": lambda text: cell(text, 3, "q[RShoulderPitch]", "40"),
    "another start": lambda text: cell(text, 0, "q[RShoulderPitch]", "0.71"),
    "twice": lambda text: cell(text, 4, "tick", "3"),
    "time": lambda text: cell(text, 4, "t", "abc"),
    "time back": lambda text: cell(text, 4, "t", "0.01"),
    "other dt": lambda text: cell(text, 4, "t", "0.035"),
    "no task": lambda text: text.replace("error[reach]", "error[other]"),
}


def cell(text: str, row: int, column: str, value: str) -> str:
    """A trace with one cell changed."""
    lines = [line.split(",") for line in text.strip().split("\n")]
    lines[1 + row][lines[0].index(column)] = value
    return "\n".join(",".join(line) for line in lines) + "\n"


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a short run."""
    folder = tmp_path_factory.mktemp("written")
    short = folder / "short.yaml"
    text = load("point_on_point").source.replace("duration: 3.0", "duration: 0.1")
    short.write_text(text.replace("duration: 2.0", "duration: 0.1"), encoding="utf-8")
    out = folder / "out"
    assert typed("compare", short, "--controllers", "qp", "--out", out).exit_code == 0
    return out


@pytest.mark.parametrize("damage", DAMAGES)
def test_damaged_traces_are_refused_in_one_line(damage: str, written: Path, tmp_path: Path) -> None:
    out, trace = tmp_path, tmp_path / "trace.csv"
    shutil.copy(written / "scenario.yaml", out / "scenario.yaml")
    text = (written / "trace.csv").read_text(encoding="utf-8")
    trace.write_text(DAMAGES[damage](text), encoding="utf-8")
    said = refused_in_one_line("explain", out)
    assert str(trace) in said
    assert "damaged" in said or "is not a trace.csv" in said


def test_rows_that_python_fills_are_named_with_what_they_take(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """As the law for robots says of the same problem, by a clock that goes on by 7 us a look."""
    clock = SimpleNamespace(perf_counter_ns=itertools.count(step=7000).__next__)
    monkeypatch.setattr(compiled, "time", clock)

    def write(state: State, rows: TaskRows) -> None:
        rows.e[0], rows.J[0] = state.p_WO[2] - 0.05, state.J_task[2]

    scenario = replace(load("point_on_point"), limits=LIMITS)
    assert "Python" not in explained(scenario).sentence
    mine = Own(name="mine", write=write, priority=1)
    said = "the rows of mine are computed in Python, 7 us of a tick"
    assert said in explained(replace(scenario, tasks=(*scenario.tasks, mine))).sentence
