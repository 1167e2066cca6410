"""Whether goals can be reached, by which way, and that a run follows it."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from command_line import typed
from numpy.typing import NDArray
from scenario_files import needs_robots
from side_by_side import needs_kernel

import coopqp
from coopqp.assessment import assess
from coopqp.base.errors import CoopqpError
from coopqp.base.spec import Array
from coopqp.limits import Obstacles
from coopqp.planning.closed_space import Budget, ClosedSpace, Verifier
from coopqp.planning.plan import CLOSE, OFF, Plan, Planner, plan, way_round
from coopqp.planning.reach import reach
from coopqp.planning.timing import TO_SPEED, finite_limits
from coopqp.report.planning import write_plan
from coopqp.scenario.loader import load, load_text
from coopqp.scenario.scenario import Phase, Scenario
from coopqp.study.explanation import RunExplanation, explain_run
from coopqp.study.explanation.goal import Goal, PositionLimits, placed
from coopqp.tasks import PlaneOnPlane, PointOnPlane, PointOnPoint, Twist

pytestmark = [needs_kernel, needs_robots]

AMPLE = Budget(seconds=60.0)


@pytest.fixture(scope="module")
def shelves() -> Scenario:
    return load("shelves")


@pytest.fixture(scope="module")
def way(shelves: Scenario) -> Plan:
    return plan(shelves, budget=AMPLE)


def test_reach_finds_configurations_that_meet_the_tasks_inside_all_limits(
    shelves: Scenario,
) -> None:
    found, problem = reach(shelves), shelves.problem()
    goal, bounds = Goal(problem.chain, problem.tasks, shelves.duration), PositionLimits(problem)
    assert found.solutions
    assert not found.proven
    for one in found.solutions:
        assert not goal.missed(one.q)
        assert goal.open < 1e-8
        assert bounds.violation(one.q) < 1e-6  # by coal, which rounds more
        assert one.joint_margin >= 0.0
        assert one.clearance > -1e-6
    assert sum(map(len, found.groups.values())) == len(found.solutions)


def test_equal_seeds_find_equal_configurations() -> None:
    scenario = load("planar_pair")
    first, second, other = (reach(scenario, seed=seed) for seed in (4, 4, 5))
    np.testing.assert_array_equal(first.solutions[0].q, second.solutions[0].q)
    assert not np.array_equal(first.solutions[0].q, other.solutions[0].q)
    assert len(first.groups) == 4  # both elbows, up and down


def test_what_is_beyond_the_arms_lengths_is_proven_unreachable() -> None:
    scenario = load("point_on_point")
    far = replace(scenario, tasks=(PointOnPoint(name="reach", goal=[1.2, 0.0, 0.0]),))
    found = reach(far)
    assert found.proven
    assert not found.solutions
    assert "m from the base of right, which is" in found.sentence


def test_what_no_search_finds_is_not_called_unreachable() -> None:
    found = reach(load("joint_limit_stress"))
    assert not found.proven
    assert not found.solutions
    assert "not found from 4096 starts: reach stops 29.9 mm short" in found.sentence
    assert "hold it back" in found.sentence


def test_tasks_that_exclude_each_other_are_told_how_near_the_search_came() -> None:
    """Two heights that are 30 mm apart: half of it each, not what both are off at the start."""
    heights = (("low", 0.03), ("high", 0.06))
    tasks = [PointOnPlane(name=name, normal=(0, 0, 1), through=(0, 0, z)) for name, z in heights]
    found = reach(replace(load("point_on_point"), tasks=tuple(tasks)))
    assert "low and high cannot hold together, on any robot; they end 15 mm off" in found.sentence


def test_a_scenario_that_asks_for_no_place_is_refused() -> None:
    scenario = load("passive_grasp_push")
    only = replace(scenario, tasks=tuple(x for x in load("nao_presses").tasks if x.of_forces))
    with pytest.raises(CoopqpError, match="no task asks for a place"):
        reach(only)


def test_a_plan_begins_at_the_start_and_ends_where_the_tasks_are_met(
    shelves: Scenario, way: Plan
) -> None:
    problem = shelves.problem()
    goal = Goal(problem.chain, problem.tasks, shelves.duration)
    assert way.success
    assert way.verification is not None
    assert way.verification.good
    np.testing.assert_allclose(way.q[0], problem.chain.q_start, atol=1e-6)
    assert not goal.missed(way.q[-1])
    assert np.linalg.norm(np.diff(way.q, axis=0), axis=1).max() <= CLOSE
    np.testing.assert_allclose(way.timed[-1], way.q[-1], atol=1e-9)


def test_a_plan_in_time_keeps_speeds_and_accelerations(shelves: Scenario, way: Plan) -> None:
    problem = shelves.problem()
    speed, push, _ = finite_limits(problem)
    v = np.diff(way.timed, axis=0, prepend=way.timed[:1], append=way.timed[-1:]) / shelves.dt
    assert (np.abs(v) <= speed).all()
    assert (np.abs(np.diff(v, axis=0)) / shelves.dt <= push * (1.0 + 1e-9)).all()
    np.testing.assert_allclose(push, speed / TO_SPEED)


def test_the_second_look_sees_what_is_wrong(shelves: Scenario, way: Plan) -> None:
    problem = shelves.problem()
    bounds, verifier = PositionLimits(problem), Verifier(ClosedSpace(problem))
    assert verifier.look(way.q, 0.01).good
    straight = np.linspace(way.q[0], way.q[-1], 500)
    found = verifier.look(straight, 0.01)
    assert found.open > 1e-3
    assert "a loop is open by" in found.message
    assert not verifier.look(way.q[::40], 0.01).good  # straight lines open the loops
    beyond = way.q.copy()
    beyond[7, 3] = bounds.upper[3] + 0.1
    assert "outside its limits" in verifier.look(beyond, 0.001).message


def test_the_second_look_sees_bodies_in_each_other(shelves: Scenario, way: Plan) -> None:
    """A ball where the bar has passed: the path of the old scene is not free in the new."""
    middle = way.object[len(way.object) // 2, :3].tolist()
    board = "        board:"
    ball = f"        ball: {{sphere: 0.05, position: {middle}}}\n{board}"
    text = shelves.source.replace(board, ball)
    other = load_text(Path("shelves_with_ball.yaml"), text, shelves.catalog)
    seen = Verifier(ClosedSpace(other.problem())).look(way.q, 0.01)
    assert seen.hits > 0
    assert "break a limit in space" in seen.message


def test_goals_off_the_limits_of_joints_come_before_nearer_ones() -> None:
    problem = load("tiago_torso").problem()
    bounds = PositionLimits(problem)
    end = plan(load("tiago_torso"), budget=AMPLE).q[-1]
    assert np.minimum(end - bounds.lower, bounds.upper - end).min() > OFF


def test_where_no_way_leads_to_the_nearest_goals_further_ones_are_tried(
    shelves: Scenario, monkeypatch: pytest.MonkeyPatch
) -> None:
    planner, counts = Planner(shelves.problem(), shelves.duration), list[int]()
    search = planner.space.way

    def none_to_few(starts: Array, goals: Array, *more: object) -> Array:
        counts.append(len(goals))
        return search(starts, goals, *more) if len(counts) > 1 else goals[:0]  # type: ignore[arg-type]

    monkeypatch.setattr(planner.space, "way", none_to_few)
    found = planner.plan(AMPLE)
    assert found.success
    assert counts[0] == 12 < counts[1]
    assert f"one of {counts[1]} goal configurations" in found.sentence
    assert found.sentence.endswith(f"it lasts {found.t[-1]:.3g} s")


def test_a_task_that_is_kept_is_met_all_along() -> None:
    scenario = load("baxter_tray")
    level, carry = scenario.tasks
    here = float(scenario.chain.start_position[2])
    assert isinstance(level, PlaneOnPlane)
    kept = replace(level, name="level", through=(0.0, 0.0, here))
    aside = replace(scenario, tasks=(kept, replace(carry, goal=[0.72, 0.12, here])))
    found = plan(aside, keep=["level"], budget=AMPLE)
    goal = Goal(aside.chain, placed((kept,), aside.chain), aside.duration)
    assert found.success
    for q in found.q[::10]:
        assert not goal.missed(q)


def test_what_is_not_met_at_the_start_cannot_be_kept() -> None:
    scenario = load("baxter_tray")
    with pytest.raises(CoopqpError, match=r"keep: level.position is 100 mm off at the start"):
        plan(scenario, keep=["level"])
    with pytest.raises(CoopqpError, match="did you mean 'level'"):
        plan(scenario, keep=["lvl"])


def test_goals_that_are_given_are_checked() -> None:
    scenario = load("planar_pair")
    with pytest.raises(CoopqpError, match=r"goals: found shape \(1, 2\)"):
        plan(scenario, goals=[0.0, 1.0])
    with pytest.raises(CoopqpError, match=r"goals\[0\]: is open"):
        plan(scenario, goals=scenario.chain.q_start + 0.1)
    assert plan(scenario, goals=scenario.chain.q_start, budget=AMPLE).success


def test_a_start_beyond_a_limit_or_in_something_is_refused(shelves: Scenario) -> None:
    problem = shelves.problem()
    q = problem.chain.q_start
    planner = Planner(problem, shelves.duration)
    planner.space.bounds.upper[3] = q[3] - 0.1
    with pytest.raises(CoopqpError, match=r"start: left/panda_joint4 is 0\.1 outside its limits"):
        planner._check_start(())
    (obstacles,) = (limit for limit in shelves.limits if isinstance(limit, Obstacles))
    farther = replace(obstacles, distance=0.09)
    with pytest.raises(CoopqpError, match=r"start: the distance of .* less than its limit keeps"):
        plan(replace(shelves, limits=(farther,)))


def test_a_seed_of_any_size_is_one(shelves: Scenario) -> None:
    goal = reach(shelves).solutions[0].q
    huge, small = (plan(shelves, goals=goal, budget=Budget(seed=s)) for s in (2**64 + 7, 7))
    np.testing.assert_array_equal(huge.q, small.q)


def test_without_time_it_says_that_this_proves_nothing(shelves: Scenario) -> None:
    found = plan(shelves, goals=reach(shelves).solutions[0].q, budget=Budget(seconds=1e-9))
    assert not found.success
    assert "that proves nothing" in found.sentence
    assert not len(found.q)


@pytest.mark.full
def test_the_timing_of_a_way_is_bounded_too(tmp_path: Path) -> None:
    """At such accelerations the way lasts hundreds of seconds, of a tick each 10 ms and less."""
    text = load("planar_pair").source
    slow = tmp_path / "slow.yaml"
    slow.write_text(f"{text}limits: [joint_position, {{joint_acceleration: {{max: 1.0e-6}}}}]\n")
    begun = time.perf_counter()
    result = typed("plan", slow, "--seconds", "1", "--out", tmp_path / "way")
    assert time.perf_counter() - begun < 20.0
    assert result.exit_code == 2
    assert "its ticks were not timed within 1 s, as it lasts" in result.output
    assert "allow more seconds, or let joints go faster" in result.output
    assert not (tmp_path / "way").exists()


def test_plan_and_reach_on_the_command_line(tmp_path: Path) -> None:
    result = typed("reach", "planar_pair")
    assert result.exit_code == 0
    assert "reachable:" in result.output
    assert "left left_2 -" in result.output
    data = json.loads(typed("reach", "planar_pair", "--json").stdout)
    assert data["reachable"]
    assert len(data["configurations"][0]["q"]) == 6
    out = tmp_path / "way"
    result = typed("plan", "planar_pair", "--out", out)
    assert result.exit_code == 0
    assert "points verified" in result.output
    assert sorted(path.name for path in out.iterdir()) == ["plan.csv", "planar_pair.yaml"]
    data = json.loads(typed("plan", "planar_pair", "--json").stdout)
    assert data["found"]


def test_what_cannot_be_planned_is_said_in_a_line_and_nothing_is_written(tmp_path: Path) -> None:
    out = tmp_path / "way"
    for words, says in (
        (("joint_limit_stress", "--seconds", "600"), "not found from 4096 starts"),
        (("planar_pair", "--keep", "nothing"), "unknown task with a place"),
        (("pr2_circle",), "error: tasks: round: its goal moves by a signal or an input; needs a"),
        (("planar_pair", "--seconds", "0"), "--seconds"),
        (("planar_pair", "--seconds", "nan"), "--seconds"),
    ):
        result = typed("plan", *words, "--out", out)
        assert result.exit_code == 2
        assert says in result.output
        assert not out.exists()


def test_a_run_follows_the_plan_and_reaches_what_no_law_does_alone(
    shelves: Scenario, way: Plan, tmp_path: Path
) -> None:
    compared = coopqp.compare(shelves, controllers=["qp"])
    alone = compared.traces["qp"]
    assert not assess(alone).reached
    assert "at the limit; 'coopqp explain' says why" in compared.verdicts["qp"]
    _check_way_round(shelves, explain_run(shelves, alone))
    _, path = write_plan(way, shelves, tmp_path)
    scenario = load(path)
    assert [phase.name for phase in scenario.schedule] == ["way", "goal"]
    found = assess(coopqp.compare(scenario, controllers=["qp"]).traces["qp"])
    assert found.reached
    assert found.succeeds


def _check_way_round(scenario: Scenario, blocked: RunExplanation) -> None:
    """The explanation of a blocked run says whether the planner got there in the time it had."""
    problem = scenario.problem()
    there = np.array(blocked.elsewhere)
    assert not Goal(problem.chain, problem.tasks, scenario.duration).missed(there)
    said = way_round(scenario, blocked, "FILE", seconds=60.0)
    assert said.way_round
    assert said.sentence.startswith(f"{blocked.sentence}; coopqp plan FILE: a way round was found")
    said = way_round(scenario, blocked, "FILE", seconds=1e-9)
    assert said.way_round is False
    assert "coopqp plan FILE: not found in" in said.sentence
    assert said.sentence.endswith("that proves nothing, more time may do")
    said = way_round(load("pr2_circle"), blocked, "FILE")
    assert said.way_round is None
    assert "coopqp plan FILE cannot help: tasks: round: its goal moves by a signal" in said.sentence
    assert way_round(load("regrasp"), blocked, "FILE", seconds=60.0).way_round  # phase by phase
    follows = replace(scenario, phases=(Phase(leads=True, duration=1.0, tasks=scenario.tasks),))
    assert way_round(follows, blocked, "FILE") is blocked


def test_a_damaged_plan_is_refused(shelves: Scenario, way: Plan, tmp_path: Path) -> None:
    middle, moved = len(way.t) // 2, np.array(way.object)
    moved[middle, 0] += 0.01
    hole = np.delete(np.arange(len(way.t)), slice(middle - 30, middle + 30))
    cut = replace(way, timed=way.timed[hole], object=way.object[hole], t=way.t[: len(hole)])
    for damaged, says in (
        (cut, r"plan.csv: \S+ jumps at"),
        (replace(way, object=moved), "the object is not where the joints hold it at"),
        (_rows(way, hole), "rows are missing between"),
        (_rows(way, np.arange(middle)), "it still moves where it ends at .* cut off"),
    ):
        with pytest.raises(CoopqpError, match=says):
            write_plan(damaged, shelves, tmp_path)


def _rows(way: Plan, kept: NDArray[np.int_]) -> Plan:
    """The plan with some of its rows, at their times."""
    return replace(way, t=way.t[kept], timed=way.timed[kept], object=way.object[kept])


def test_a_plan_beyond_limits_that_were_tightened_is_refused(
    shelves: Scenario, way: Plan, tmp_path: Path
) -> None:
    _, path = write_plan(way, shelves, tmp_path)
    text = path.read_text()
    path.write_text(text.replace("- joint_velocity", "- joint_velocity: {scale: 0.2}"))
    with pytest.raises(CoopqpError, match=r"velocity of \S+ \(\w+\) is broken by \S+ rad/s at"):
        load(path)
    path.write_text(text)
    assert load(path).schedule[0].leads


def test_hands_on_the_way_to_what_they_take_hold_of_may_near_it() -> None:
    """The way to a phase and the phase are one: the arms are not away from the object in it."""
    scenario = load("pick_and_place")
    follows = scenario.changed(phases=tuple(_doubled(scenario.phases)))
    for one in follows.schedule:
        away = follows.problem(one).chain.hold.away
        own = next(x for x in scenario.phases if x.name == one.name.removesuffix(" way"))
        assert away == scenario.problem(own).chain.hold.away


def _doubled(phases: Sequence[Phase]) -> Iterator[Phase]:
    for phase in phases:
        yield replace(phase, name=f"{phase.name} way", leads=True)
        yield phase


def test_the_number_of_threads_changes_no_answer(shelves: Scenario) -> None:
    one, three = (reach(shelves, threads=count) for count in (1, 3))
    assert one.sentence == three.sentence
    for a, b in zip(one.solutions, three.solutions, strict=True):
        np.testing.assert_array_equal(a.q, b.q)


def test_without_a_task_that_has_a_place_nothing_is_planned() -> None:
    scenario = load("planar_pair")
    drifting = scenario.changed(tasks=(Twist(name="drift", velocity={"x": 0.1}),))
    for ask in (plan, reach):
        with pytest.raises(CoopqpError, match="no task asks for a place"):
            ask(drifting)


def test_a_plan_shorter_than_a_second_is_read_back(tmp_path: Path) -> None:
    """A trial of its tasks at a tick, where the reference has a kink, refused all of these."""
    scenario = load("yeo_4_5")
    way = plan(scenario, budget=AMPLE)
    assert way.t[-1] < 1.0
    _, path = write_plan(way, scenario, tmp_path)
    np.testing.assert_allclose(load(path).schedule[0].duration, way.t[-1] + 2.0)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda text: text.replace("t,right_1", "t,right_9"), "has no column 'right_1'"),
        (lambda text: text.replace("\n0.01,", "\n0.5,"), "times need to rise"),
        (lambda text: text.replace("\n0.02,", "\nx,"), "found 'x', needs a number"),
        (lambda text: text.replace("\n0,-0.34", "\n0,-0.94"), "begins 0.6 from the start"),
        (lambda text: text.replace(",qw", ",w"), "has no column 'qw'"),
    ],
)
def test_a_broken_plan_is_refused_with_its_line(
    change: Callable[[str], str], says: str, tmp_path: Path
) -> None:
    scenario = load("planar_pair")
    file, path = write_plan(plan(scenario, budget=AMPLE), scenario, tmp_path)
    assert load(path).schedule[0].duration > 0.5
    file.write_text(change(file.read_text()))
    result = typed("validate", path)
    assert result.exit_code == 2
    assert says in result.output
    assert f"{path}:" in result.output
