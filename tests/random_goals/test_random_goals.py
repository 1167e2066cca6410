"""The statistics of the laws: intervals, classes, what counts, and a small share of the runs."""

from __future__ import annotations

import json
import os
import sqlite3
from contextlib import closing
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner, Result
from rich.console import Console

import coopqp
from coopqp.controllers import QPController
from coopqp.execution.rollout import rollout
from coopqp.limits import JointPosition, JointVelocity
from coopqp.model.profile import Profile
from coopqp.model.state import State
from coopqp.plant import Disturbance
from coopqp.plants import Kinematic
from coopqp.report import strict_json
from coopqp.study.sweep.results import records
from coopqp.study.sweep.summary import wilson
from coopqp.tasks import PointOnPoint
from random_goals import __main__ as command
from random_goals import trial
from random_goals.draw import NEAR, OWN, draw, least_margin
from random_goals.reach import holds_inside
from random_goals.summary import Line, summarize
from random_goals.table import tables
from random_goals.trial import LAWS, GoalRun, LawRun, one_goal

SMALL = {"nao_t14": OWN["nao_t14"], "planar_pair": OWN["planar_pair"]}


@pytest.fixture(scope="module")
def small() -> list[GoalRun]:
    return [one_goal(robot, seed) for robot in SMALL for seed in range(2)]


def asked(*words: str) -> Result:
    """What ``python -m tests.random_goals WORDS`` prints, and its exit code."""
    return CliRunner().invoke(command.main, list(words), catch_exceptions=False)


# A small share of it.


def test_the_qp_keeps_limits_and_loops_on_every_goal(small: list[GoalRun]) -> None:
    for goal in small:
        runs = {run.law: run for run in goal.runs}
        assert list(runs) == list(LAWS)
        assert runs["qp"].safe
        assert runs["saturation_null_space"].inside
        if goal.goal == "beyond":
            assert not any(run.reached and run.safe for run in goal.runs)


def test_the_command_draws_the_same_from_the_same_seed(
    small: list[GoalRun], monkeypatch: pytest.MonkeyPatch
) -> None:
    planar = {"planar_pair": OWN["planar_pair"]}
    monkeypatch.setattr("random_goals.__main__.arenas", lambda: planar)
    monkeypatch.setattr("random_goals.trial.arenas", lambda: planar)
    result = asked("--goals", "1", "--seed", "1", "--jobs", "1", "--json")
    assert result.exit_code == 0
    printed = json.loads(result.stdout)
    assert printed["goals"] == json.loads(strict_json.text([asdict(small[3])]))
    assert {x["robot"] for x in printed["lines"]} == {"all", "planar_pair"}


def test_the_command_goes_on_from_what_it_has_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    planar = {"planar_pair": OWN["planar_pair"]}
    monkeypatch.setattr("random_goals.__main__.arenas", lambda: planar)
    monkeypatch.setattr("random_goals.trial.arenas", lambda: planar)
    out = tmp_path / "goals.sqlite3"

    def printed(goals: int) -> Any:
        words = ("--goals", str(goals), "--jobs", "1", "--json", "--out", str(out))
        result = asked(*words)
        assert result.exit_code == 0, result.output
        return json.loads(result.stdout)

    first = printed(1)
    assert len(list(records(out))) == 1
    run = []
    one = trial.one_goal
    monkeypatch.setattr(trial, "one_goal", lambda *goal: [run.append(goal), one(*goal)][1])
    both = printed(2)
    assert run == [("planar_pair", 1)]
    assert both["goals"][0] == first["goals"][0]
    with closing(sqlite3.connect(out)) as database, database:  # not as it was written
        database.execute("UPDATE records SET said = '{' WHERE id = 1")
    assert printed(2) == both
    assert run == [("planar_pair", 1)] * 2
    out.write_text("{}\n", encoding="utf-8")
    assert asked("--goals", "1", "--out", str(out)).exit_code == 2


def test_laws_are_compared_on_the_same_goals() -> None:
    goals = [made_up("inside", a=GOOD, b=OUTSIDE) for _ in range(8)]
    found = line(goals, "b").against
    assert (found.only_reference, found.difference.value) == (8, -1.0)
    assert found.difference.p == pytest.approx(2.0 * 0.5**8)
    assert line(goals, "a").against.difference.p == 1.0


def test_what_is_counted_is_what_the_trace_says(small: list[GoalRun]) -> None:
    """The QP's run of the first goal, made again and judged with numpy alone."""
    problem = draw("nao_t14", 0, 0).problem
    law = QPController().build(problem)
    plant = Kinematic().build(problem, 0, Disturbance())
    trace = rollout(law, plant, 550, controller="qp", solver=None)
    goal, own = small[0], small[0].runs[0]
    assert own.error == pytest.approx(float(trace.task_error[-1, 0]), rel=1e-9)
    assert own.speed == pytest.approx(float(np.max(np.abs(trace.v) / trace.velocity)))
    assert own.inside == bool(
        (trace.q >= trace.lower - 1e-6).all() and (trace.q <= trace.upper + 1e-6).all()
    )
    assert goal.tolerance == pytest.approx(problem.tasks[0].tolerance)


def test_starts_are_of_both_kinds_and_closed(small: list[GoalRun]) -> None:
    for seed in range(8):
        drawn = draw("nao_t14", seed, 0)
        chain = drawn.problem.chain
        assert (least_margin(chain, chain.q_start) < NEAR) == (drawn.start == "near")
        assert drawn.start == ("near" if seed % 2 else "away")
        assert State(chain).loop_position_error < 1e-6
        assert chain.starts_inside


# Inverse kinematics.


def test_a_goal_on_a_walk_inside_the_limits_is_found_and_an_unreachable_one_is_not() -> None:
    drawn = draw("nao_t14", 0, 3)
    problem = drawn.problem
    chain, at_once = problem.chain, Profile(kind="step")

    def held(goal: tuple[float, float, float]) -> bool:
        task = PointOnPoint(goal=goal, profile=at_once)
        return holds_inside(replace(problem, tasks=(task,)), (chain.q_start,))

    for q in drawn.elsewhere:
        x, y, z = chain.object_pose(q).translation.tolist()
        assert held((x, y, z))
    assert not held((0.6, 0.0, 0.1))


def test_the_stress_goal_is_beyond_the_limits_and_the_headline_goal_is_inside() -> None:
    for name, inside in (("joint_limit_stress", False), ("point_on_point", True)):
        scenario = coopqp.load(name)
        assert scenario.limits == (JointPosition(), JointVelocity())
        end = coopqp.run(scenario, controller="qp").q[-1]
        assert holds_inside(scenario.problem(), (scenario.chain.q_start, end)) == inside


# Counting.


@pytest.mark.parametrize(("count", "of"), [(0, 10), (10, 10), (3, 7), (97, 200), (199, 200)])
def test_interval_is_that_of_scipy(count: int, of: int) -> None:
    import scipy.stats  # half a second that no other test needs

    expected = scipy.stats.binomtest(count, of).proportion_ci(0.95, method="wilson")
    found = wilson(count, of)
    assert (found.low, found.high) == pytest.approx((expected.low, expected.high), abs=1e-12)


def test_interval_of_nothing_is_everything() -> None:
    assert (wilson(0, 0).low, wilson(0, 0).high) == (0.0, 1.0)


def made_up(goal: str, **runs: LawRun) -> GoalRun:
    named = tuple(replace(run, law=name) for name, run in runs.items())
    return GoalRun("nao_t14", 0, "away", goal, witness=False, tolerance=5e-4, runs=named)


GOOD = LawRun("", True, True, True, 0.0, 0.0, 0.5, 1e-6)
OUTSIDE = replace(GOOD, inside=False, violation=0.2)
OPEN = replace(GOOD, loop=False, loop_error=0.1)
SHORT = replace(GOOD, reached=False, error=0.03)


def line(goals: list[GoalRun], law: str) -> Line:
    return next(
        x
        for x in summarize(goals)
        if (x.robot, x.start, x.goal, x.law) == ("all", "all", goals[0].goal, law)
    )


def test_all_three_must_hold_in_one_run() -> None:
    goals = [made_up("inside", a=GOOD), made_up("inside", a=OUTSIDE), made_up("inside", a=OPEN)]
    found = line(goals, "a")
    counts = (found.reached, found.inside, found.loop, found.whole)
    assert [share.count for share in counts] == [3, 2, 2, 1]
    assert {share.of for share in counts} == {3}


def test_nearest_is_told_among_those_who_keep_limits_and_loops() -> None:
    """Who gets there through a limit is not nearer; as near as five per cent is nearest too."""
    nearly, far = replace(SHORT, error=0.031), replace(SHORT, error=0.04)
    goals = [made_up("beyond", a=SHORT, b=nearly, c=far, d=OUTSIDE, e=OPEN)]
    nearest = {law: line(goals, law).nearest.count for law in "abcde"}
    assert nearest == {"a": 1, "b": 1, "c": 0, "d": 0, "e": 0}


def test_numbers_that_are_none_have_reached_nothing() -> None:
    lost = replace(OUTSIDE, reached=False, error=float("nan"))
    goals = [made_up("beyond", a=SHORT, b=lost)]
    assert line(goals, "b").nearest.count == 0
    assert line(goals, "a").nearest.count == 1


def test_tables_can_be_read_at_80_columns() -> None:
    """With five robots, every law, and the widest numbers there are."""
    robots = ("nao_t14", "planar_pair", "two_pandas", "baxter", "tiago")
    goals = [
        replace(made_up(kind, **dict.fromkeys(LAWS, GOOD)), robot=robot, start=start)
        for robot in robots
        for kind in ("inside", "beyond")
        for start in ("near", "away")
        for _ in range(100)
    ]
    with open(os.devnull, "w") as nowhere:
        console = Console(width=80, record=True, file=nowhere)
        for table in tables(summarize(goals)):
            console.print(table, "")
    text = console.export_text()
    assert "…" not in text
    assert max(len(words.rstrip()) for words in text.splitlines()) <= 80
    for words in (*LAWS, *robots, "100 99-100", "nearest", "all three"):
        assert words in text
