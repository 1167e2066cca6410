"""Parts of the closed configurations that no motion connects."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from attitudes import MEET, Arm, is_cut_off, nearest
from chains import Parameters, robot_of, serial
from laws import problem
from linking import Line, writhe
from scenario_files import needs_robots
from side_by_side import needs_kernel

from coopqp.base.spec import Array
from coopqp.grasps import Rigid
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.grasp_configuration import HeldObject
from coopqp.planning.closed_space import Budget, ClosedSpace
from coopqp.planning.plan import Planner, plan
from coopqp.planning.reach import cut_off, parts, reach
from coopqp.scenario.loader import load
from coopqp.tasks import PointOnPoint

pytestmark = [needs_kernel, needs_robots]

NAMES = ("point_on_point", "baxter_tray", "two_pandas", "three_ur", "tiago_torso", "planar_pair")


def _closed(space: ClosedSpace, count: int = 60) -> Array:
    q = space.sample(np.random.default_rng(1), count)
    return np.asarray(q[space.project(q)])


def _turned(chain: ClosedChain, a: Array, b: Array) -> list[bool]:
    """Whether each arm turns its end once round against the first arm's on the line from a to b.

    By pinocchio: attitudes are followed in small steps, each lift the one near the one before.
    """
    data, lifts = chain.model.createData(), list[list[Array]]()
    for q in np.linspace(a, b, 400):
        pin.framesForwardKinematics(chain.model, data, q)
        now = [pin.Quaternion(data.oMf[f].rotation).coeffs() for f in chain.frames[: chain.holding]]
        if lifts:
            now = [x if x @ y > 0.0 else -x for x, y in zip(now, lifts[-1], strict=True)]
        lifts.append(now)
    sides = [[float(x @ lift[0]) > 0.0 for x in lift[1:]] for lift in (lifts[0], lifts[-1])]
    return [x != y for x, y in zip(*sides, strict=True)]


@pytest.mark.parametrize("name", NAMES)
def test_parts_differ_where_a_hand_turns_once_round_against_another(name: str) -> None:
    space = ClosedSpace(load(name).problem())
    q = _closed(space)
    found, start = parts(space.chain, q), parts(space.chain, space.chain.q_start[None])[0]
    for row, part in zip(q[:20], found, strict=False):
        assert _turned(space.chain, space.chain.q_start, row) == list(part != start)
    assert len(np.unique(found, axis=0)) > 1


@pytest.mark.few(2)
@pytest.mark.parametrize("name", NAMES)
def test_no_way_leaves_its_part(name: str) -> None:
    """Trees that know nothing of parts find ways to configurations of the start's alone."""
    space = ClosedSpace(load(name).problem())
    q = _closed(space)
    q = q[space.is_free(q)]
    start, away = space.chain.q_start[None], cut_off(space.chain, q)
    budget = Budget(seconds=60.0, shortcuts=0)
    assert not len(space.way(start, q[away], replace(budget, seconds=0.3)))
    assert len(space.way(start, q[~away], budget))


def test_a_goal_of_another_part_is_proven_unreachable_at_once() -> None:
    problem = load("two_pandas").problem()
    planner = Planner(problem, 4.0)
    q = _closed(planner.space)
    q = q[planner.space.is_free(q)]
    away = cut_off(problem.chain, q)
    found = planner.plan(Budget(seconds=60.0), q[away])
    assert not found.success
    assert found.sentence.startswith("proven unreachable: no motion leads there: from the start's")
    assert found.proven
    assert planner.plan(Budget(seconds=60.0), q).success


def test_plans_go_to_configurations_that_are_not_cut_off() -> None:
    scenario = load("two_pandas")
    found = reach(scenario)
    chain = scenario.problem().chain
    told = np.array([one.cut_off for one in found.solutions])
    goals = np.array([one.q for one in found.solutions])
    np.testing.assert_array_equal(told, cut_off(chain, goals))
    assert told.any()
    assert f"; {told.sum()} of them no motion leads to: from the start's" in found.sentence
    way = plan(scenario, budget=Budget(seconds=60.0))
    assert not cut_off(chain, way.q).any()


#: Goals of ``benchmarks/planning.py`` behind NAO's back, and one that is planned to.
BEHIND = [(-0.1533, -0.0148, 0.0693), (-0.1572, 0.0041, 0.0763), (-0.1508, 0.0109, 0.0667)]
AHEAD = np.array([0.13, 0.05, 0.03])


def test_attitudes_at_a_goal_are_pinocchios() -> None:
    chain = load("point_on_point").problem().chain
    goal, data = np.array(BEHIND[0]), chain.model.createData()
    for frame in chain.frames:
        arm = Arm(chain, frame)
        rows = arm.configurations(goal)[::50]
        assert len(rows) > 10
        for row, lift in zip(rows, arm.attitudes(rows), strict=True):
            q = chain.q_start.copy()
            q[arm.columns] = row
            pin.framesForwardKinematics(chain.model, data, q)
            np.testing.assert_allclose(data.oMf[frame].translation, goal, atol=1e-12)
            np.testing.assert_allclose(
                pin.Quaternion(lift).matrix(), data.oMf[frame].rotation, atol=1e-12
            )


@pytest.mark.few(1)
@pytest.mark.parametrize("goal", BEHIND)
def test_behind_naos_back_no_configuration_is_in_the_starts_part(goal: tuple[float, ...]) -> None:
    """By surfaces of attitudes, which know nothing of Newton steps, and by random starts."""
    scenario = load("point_on_point")
    chain = scenario.problem().chain
    assert is_cut_off(chain, np.array(goal))
    found = reach(replace(scenario, tasks=(PointOnPoint(name="reach", goal=list(goal)),)))
    assert found.solutions
    assert all(one.cut_off for one in found.solutions)


def test_in_front_of_nao_the_surfaces_meet_in_the_starts_part() -> None:
    assert nearest(load("point_on_point").problem().chain, AHEAD)[0] < MEET


#: Of joints after the first: the sign of the right angle to the one before, the link's length [m].
SHAPE = [(-1, 0.0), (1, 0.42), (1, 0.0), (-1, 0.4), (-1, 0.0), (1, 0.081)]


def straight_pair() -> ClosedChain:
    """Two arms of seven joints along and across them, as of the shelves, which hold one object."""
    bends = [Parameters(alpha=0.5 * np.pi * sign, r=r) for sign, r in SHAPE]
    arms = {
        "right": serial("r", [Parameters(r=0.36), *bends]),
        "left": serial("l", [Parameters(d=0.765, r=0.36), *bends]),
    }
    start = np.array([0.6, 0.9, -1.0, -1.2, 0.3, 1.0, 0.4, 1.1, 0.8, 0.7, 1.2, -0.5, 1.1, -0.3])
    robot = robot_of("straight", arms, (0.0, 0.0, 0.3))
    return ClosedChain.attach(robot, start, Rigid(), HeldObject())


def test_linking_numbers_are_whole_and_odd_or_even_as_half_angles_say() -> None:
    chain = straight_pair()
    q, line = _closed(ClosedSpace(problem(chain))), Line(chain)
    turns = np.array([line.number(row) for row in q]) - line.number(chain.q_start)
    np.testing.assert_allclose(turns, turns.round(), atol=1e-6)
    assert len(np.unique(turns.round())) > 3
    np.testing.assert_array_equal(turns.round() % 2 == 1, cut_off(chain, q))
    for row in q[:10]:  # and it goes on continuously with the joints, where the line is apart
        beside = row + 1e-4 * np.random.default_rng(0).normal(size=chain.n)
        assert line.nearest(row) > 1e-3
        assert line.number(beside) == pytest.approx(line.number(row), abs=0.01)


def test_a_line_with_one_crossing_has_a_writhe_of_one() -> None:
    eight = np.array([[1.0, 1, 1], [-1, -1, 1], [-1, 1, -1], [1, -1, -1]]) * (1.0, 1.0, 1e-3)
    assert abs(writhe(eight)) == pytest.approx(1.0, abs=0.01)
    assert writhe(eight * (1.0, 1.0, -1.0)) == pytest.approx(-writhe(eight))
    assert writhe(np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 2, 0], [-1, 1, 0]])) == 0.0
    with pytest.raises(ValueError, match="not two arms, straight at zero"):
        Line(load("two_pandas").chain)
