"""Ways of chains that planners elsewhere refuse, and what is said where there is none."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from unittest.mock import patch

import numpy as np
import pytest
from command_line import typed
from scenario_files import needs_robots
from side_by_side import needs_kernel
from stress import arrangements

from coopqp.base.errors import CoopqpError
from coopqp.model.closed_chain import ClosedChain
from coopqp.planning.closed_space import Budget, along
from coopqp.planning.plan import Plan, Planner, plan
from coopqp.planning.reach import cut_off, reach
from coopqp.report.planning import write_plan
from coopqp.scenario.loader import load, load_text
from coopqp.scenario.scenario import Scenario
from coopqp.tasks import PointOnPoint

pytestmark = [needs_kernel, needs_robots]

AMPLE = Budget(seconds=60.0)


def _check(found: Plan, chain: ClosedChain, end: np.ndarray) -> None:
    """By pinocchio: closed on the straight lines, inside the limits, from the start to the end."""
    points = along(found.q, 0.004)
    assert max(np.abs(chain.loop_error(q)).max() for q in points) < 1e-5
    assert (points >= chain.lower - 1e-9).all()
    assert (points <= chain.upper + 1e-9).all()
    np.testing.assert_allclose(found.q[0], chain.q_start, atol=1e-6)
    np.testing.assert_allclose(found.q[-1], end, atol=1e-6)


@pytest.mark.few(2)
@pytest.mark.parametrize(
    "name", ["passive_grasp_pose", "tiago_torso", "three_ur", "two_so101", "planar_pair"]
)
def test_passive_joints_shared_torso_three_arms_and_few_joints(name: str) -> None:
    problem = load(name).problem()
    planner = Planner(problem, 0.0)
    q = planner.space.sample(np.random.default_rng(2), 300)
    q = q[planner.space.project(q)]
    q = q[planner.space.is_free(q) & ~cut_off(problem.chain, q)]
    end = q[np.linalg.norm(q - problem.chain.q_start, axis=1).argmin()]
    found = planner.plan(AMPLE, end)
    assert found.success, found.sentence
    _check(found, problem.chain, end)


@pytest.mark.parametrize("name", arrangements.names())
def test_loops_with_more_rows_than_are_independent(name: str) -> None:
    """Planar and Bennett linkages among them: a walk along the loops ends at the goal."""
    chain = arrangements.chain(name, arrangements.grasps_of(name)[-1])
    walk = list(chain.closed_walk(5)) if chain.loops.closed else []
    base = load("planar_pair").problem()
    bare = type(base)(**{**vars(base), "chain": chain, "tasks": (), "limits": ()})
    planner = Planner(bare, 0.0)
    end = np.array(walk[-1:] or [chain.q_start])
    assert planner.space.project(end)[0]
    found = planner.path(AMPLE, end)
    assert found.success, found.sentence
    if chain.loops.closed:
        assert max(np.abs(chain.loop_error(q)).max() for q in along(found.q, 0.004)) < 1e-5


def test_a_goal_at_which_loops_cannot_be_closed_is_not_found() -> None:
    scenario = load("two_pandas")
    far = replace(scenario, tasks=(PointOnPoint(name="far", goal=[0.05, 0.0, 0.35]),))
    found = reach(far)
    assert not found.solutions
    assert not found.proven
    assert found.sentence.startswith("not found from 4096 starts: left/panda_joint6")
    assert "beyond that it stays off by 108 mm along -x" in found.sentence
    assert "unreachable" not in found.sentence
    assert not plan(far, budget=AMPLE).success


def _pressed(mass: float) -> Scenario:
    scenario = load("nao_presses")
    text = scenario.source.replace("mass: 0.2", f"mass: {mass}")
    return load_text(Path("heavier.yaml"), text, scenario.catalog)


@pytest.mark.full
def test_hands_have_to_hold_the_object_where_it_is_to_go() -> None:
    assert reach(_pressed(0.2)).solutions
    with patch(
        "coopqp.planning.reach.MAX_TRIES", 512
    ):  # all of its starts take a quarter of a minute
        found = reach(_pressed(0.8))
    assert not found.solutions
    assert not found.proven
    assert "found, but hands hold at most" in found.sentence
    assert "of the object's weight there, as motor" in found.sentence


def test_ctrl_c_leaves_nothing_behind(tmp_path: Path) -> None:
    kept = tmp_path / "kept"
    kept.mkdir()
    with patch("coopqp.planning.closed_space.ClosedSpace.way", side_effect=KeyboardInterrupt):
        for out in (tmp_path / "new" / "way", kept):
            assert typed("plan", "planar_pair", "--out", out).exit_code != 0
    assert not (tmp_path / "new" / "way").exists()
    assert not [path for path in kept.iterdir() if not path.name.startswith(".")]


def test_a_way_that_was_made_shorter_is_a_way() -> None:
    problem = load("shelves").problem()
    planner = Planner(problem, 4.0)
    end = reach(load("shelves")).solutions[0].q
    lengths = {}
    for shortcuts in (0, 150):
        found = planner.path(replace(AMPLE, shortcuts=shortcuts), end)
        assert found.verification is not None
        assert found.verification.good
        _check(found, problem.chain, found.q[-1])
        lengths[shortcuts] = found.length
    assert lengths[150] < 0.9 * lengths[0]


def test_a_start_at_the_goal_is_a_plan_that_is_read_back(tmp_path: Path) -> None:
    scenario = load("planar_pair")
    found = plan(scenario, goals=scenario.chain.q_start, budget=AMPLE)
    assert found.length < 1e-6
    _, path = write_plan(found, scenario, tmp_path)
    assert [phase.name for phase in load(path).schedule] == ["way", "goal"]


@pytest.mark.parametrize("signs", [(1, 1), (-1, -1), (-1, 1)])
def test_elbows_go_through_stretched_arms_to_the_other_side(signs: tuple[int, int]) -> None:
    """The same place with other elbows: they begin at (1, -1), and an arm at 0 is singular."""
    scenario = load("planar_pair")
    chain = scenario.chain
    place = PointOnPoint(name="place", goal=chain.object_pose(chain.q_start).translation.tolist())
    here = replace(scenario, tasks=(place,))
    elbows = [chain.joint_names.index(name) for name in ("right_2", "left_2")]
    assert tuple(np.sign(chain.q_start[elbows])) == (1, -1)
    end = next(one.q for one in reach(here).solutions if tuple(np.sign(one.q[elbows])) == signs)
    found = plan(here, goals=end, budget=AMPLE)
    assert found.success, found.sentence
    _check(found, chain, end)


#: A second board, 90 mm before the first one; the bar with its distances needs 80 mm.
FRONT = "front: {box: [0.30, 0.20, 0.02], position: [0.26, 0.45, 0.40]}"
#: The first one as a mesh, in mm, in a file beside the scenario.
MESH = "board: {mesh: board.stl, scale: [0.001, 0.001, 0.001], position: [0.65, 0.45, 0.40]}"


@pytest.mark.full
def test_past_a_mesh_and_a_second_board(tmp_path: Path) -> None:
    trimesh = pytest.importorskip("trimesh")
    trimesh.creation.box((300.0, 500.0, 20.0)).export(tmp_path / "board.stl")
    text = load("shelves").source
    begin, end = text.index("board: {"), text.index("back: {")
    text = f"{text[:begin]}{MESH}\n        {FRONT}\n        {text[end:]}"
    scenario = load_text(tmp_path / "gap.yaml", text, load("shelves").catalog)
    found = plan(scenario, budget=AMPLE)
    assert found.success, found.sentence
    _check(found, scenario.chain, found.q[-1])
    assert found.verification is not None
    assert found.verification.good


def test_a_goal_in_something_is_refused() -> None:
    problem = load("shelves").problem()
    planner = Planner(problem, 4.0)
    q = planner.space.sample(np.random.default_rng(0), 400)
    q = q[planner.space.project(q)]
    hit = q[~planner.space.is_free(q)][0]
    with pytest.raises(CoopqpError, match=r"goals\[0\]: is open, outside a limit, or in something"):
        planner.plan(AMPLE, hit)


@pytest.mark.parametrize(
    "limits", [["joint_velocity"], [{"joint_velocity": {"scale": 0.1}}], ["self_collision"]]
)
def test_ranges_that_no_limit_names_are_kept(limits: list[object]) -> None:
    """Verdicts look at them in any case; the way moves at the speeds that the limits allow."""
    scenario = _nao(limits)
    way, chain = plan(scenario, budget=Budget(seconds=60.0)), scenario.chain
    assert way.success, way.sentence
    _check(way, chain, way.q[-1])
    np.testing.assert_allclose(way.timed[-1], way.q[-1], atol=1e-6)
    share = 0.1 if "scale" in str(limits) else 1.0
    assert (np.abs(np.diff(way.timed, axis=0)) / scenario.dt <= share * chain.velocity).all()
    ends = np.array([one.q for one in reach(scenario).solutions])
    assert len(ends)
    assert (np.clip(ends, chain.lower, chain.upper) == ends).all()


@pytest.mark.full
def test_ways_that_last_too_long_to_be_kept_are_refused() -> None:
    with pytest.raises(CoopqpError, match="s, more ticks than are kept"):
        plan(_nao([{"joint_acceleration": {"max": 1e-9}}]), budget=Budget(seconds=60.0))


def _nao(limits: list[object]) -> Scenario:
    text = f"""
        robot: nao_t14
        grasp: rigid
        start: {{right: [0.7, -0.2, 1.2, 0.9, 0.1], left: [0.7, 0.2, -1.2, -0.9, -0.1]}}
        tasks: [point_on_point: {{goal: [0.15, 0.03, 0.05]}}]
        limits: {json.dumps(limits)}
        controllers: [qp]
        dt: 0.01
        duration: 2.0
    """
    return load_text(Path("nao.yaml"), text, load("point_on_point").catalog)
