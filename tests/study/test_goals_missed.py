"""Unreachable goals, tasks that contradict each other, and tasks with too many rows.

Distances are those of scipy over pinocchio's kinematics.
"""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from explained import HIGH, LOW, REACH, advice, explained, nao, nearest, of_case
from laws import UNREACHABLE
from scenario_files import needs_robots

from coopqp.assessment import assess
from coopqp.base.spec import Pose as PoseValue
from coopqp.execution.controller_run import run
from coopqp.limits import JointPosition, JointVelocity
from coopqp.model.closed_chain import ClosedChain
from coopqp.scenario.loader import load
from coopqp.study.explanation.insufficient_time import _rests
from coopqp.tasks import Orientation, PointOnPlane, PointOnPoint, Pose, Twist


def test_the_table_case_is_told_apart_from_what_is_unreachable_anyway() -> None:
    """Without the table 4.2 mm are missing, by scipy; with it the run ends much farther off."""
    scenario, found = advice("my4"), of_case("my4")
    way = nearest(scenario.chain, (0.19, 0.0, 0.0))
    assert found.kind == "reach"
    assert found.distance == pytest.approx(float(np.linalg.norm(way)), abs=2e-4)
    end = assess(run(scenario, controller="qp")).errors[0]
    assert f"back by {1e3 * (end - found.distance):.2g}" in found.sentence
    assert found.sentence.startswith("the table, corner ")


@pytest.mark.parametrize("goal", [(0.28, 0.0, 0.05), (0.19, 0.0, 0.35)])
def test_unreachable_goals_are_told_by_distance_and_direction(
    goal: tuple[float, float, float],
) -> None:
    scenario = nao(PointOnPoint(name="reach", goal=goal))
    found, way = explained(scenario), nearest(scenario.chain, goal)
    assert found.kind == "reach"
    assert found.distance == pytest.approx(float(np.linalg.norm(way)), abs=5e-4)
    np.testing.assert_allclose(found.way, way / np.linalg.norm(way), atol=5e-3)
    assert "rad/s" not in found.sentence
    assert "unreachable by" in found.sentence


def test_a_twist_that_stretches_the_arms_is_unreachable_along_its_axis() -> None:
    """The loops' own Jacobian has all but lost that direction, whatever limits say."""
    scenario, found = advice("nod"), of_case("nod")
    assert found.kind == "reach"
    assert found.way[0] > 0.97
    assert "along +x" in found.sentence
    assert "rad/s" not in found.sentence
    chain, q = scenario.chain, run(scenario, controller="qp").q[-1]
    J = chain.object_jacobians(q)
    free = np.linalg.svd(J[1] - J[0])[2][6:]  # six loop rows, rank six
    stretched, across = (np.linalg.norm(free @ (way @ J[0][:3])) for way in (found.way, (0, 0, 1)))
    assert stretched < 0.01 * across


@needs_robots
def test_a_goal_half_a_metre_too_far_is_not_blamed_on_speeds_or_on_an_idle_wall() -> None:
    found = of_case("far")
    assert found.kind == "reach"
    assert found.tasks == ("carry",)
    assert found.distance is not None
    assert found.distance > 0.1
    assert "wall" not in found.sentence.split("; the rows of ")[0]  # which are Python's
    assert "velocity" not in found.sentence


# Tasks that contradict each other


def test_two_heights_at_once_are_named_and_not_the_loops() -> None:
    found = of_case("conflict")
    assert found.kind == "contradiction"
    assert set(found.tasks) == {"low", "high"}
    assert found.any_robot
    assert "low and high cannot hold together, on any robot; they end 15 mm off" in found.sentence


@pytest.mark.parametrize("modes", [("hard", "hard"), ("hard", "soft"), ("scaled", "hard")])
def test_hard_tasks_that_conflict_are_named(modes: tuple[str, str]) -> None:
    """A third that has no part in it is left out."""
    low, high = (replace(t, mode=m) for t, m in zip((LOW, HIGH), modes, strict=True))  # type: ignore[arg-type]
    beside = PointOnPlane(name="beside", normal=(0, 1, 0), through=(0, 0.01, 0))
    found = explained(nao(low, beside, high))
    assert found.kind == "contradiction"
    assert set(found.tasks) == {"low", "high"}


@pytest.mark.parametrize("mode", ["hard", "scaled"])
def test_a_task_that_is_not_met_in_full_is_named_and_not_one_beside_it(mode: str) -> None:
    """The soft one ends farther from its goal, as told by its tolerance."""
    far = replace(REACH, name="far", goal=UNREACHABLE, mode=mode)  # type: ignore[arg-type]
    scenario = nao(Orientation(name="turn", rpy_deg=(20, 0, 20), tolerance=1e-6), far)
    trace = run(scenario, controller="qp")
    found = explained(scenario)
    ticks = sum("TASKS_RELAXED" in status for status in trace.status)
    assert ticks > 50
    assert (found.kind, found.tasks) == ("reach", ("far",))
    assert [part.task for part in found.missed] == ["far", "turn"]
    assert [(task.task, task.mode, task.ticks) for task in found.relaxed] == [("far", mode, ticks)]
    assert 0.0 < found.relaxed[0].missing <= 1.0
    assert f"{mode} task 'far' is not met in full in {ticks} ticks and lacks " in found.sentence


def test_a_goal_that_is_reached_in_the_end_says_who_was_not_met_on_the_way() -> None:
    """At so little speed a hard task cannot follow its reference all the time."""
    slow = (JointPosition(), JointVelocity(scale=0.03))
    found = explained(nao(replace(REACH, mode="hard"), limits=slow, duration=12.0))
    assert found.kind == "reached"
    assert [(task.task, task.missing) for task in found.relaxed] == [("reach", 0.0)]
    count = found.relaxed[0].ticks
    assert f", but hard task 'reach' is not met in full in {count} tick" in found.sentence
    assert found.sentence.endswith("and is met at the end; --tick says why")


def test_of_tasks_with_priorities_it_is_said_who_comes_first() -> None:
    found = explained(nao(LOW, replace(HIGH, priority=1)))
    assert set(found.tasks) == {"low", "high"}
    assert "low comes first, high stays 30 mm off" in found.sentence


def test_tasks_that_only_this_robot_cannot_join_are_said_to_be_so() -> None:
    """A free object could be there and turned so; two arms of five joints cannot."""
    chain = load("point_on_point").chain
    turned = PoseValue(position=(0.18, 0.0, 0.05), rpy_deg=(0, 0, 20))
    there = PointOnPoint(name="there", goal=turned.position)
    found = explained(nao(there, Orientation(name="turned", rpy_deg=(20, 0, 20))))
    assert len(chain.joint_names) == 10
    assert found.kind == "contradiction"
    assert set(found.tasks) == {"there", "turned"}
    assert not found.any_robot


@pytest.mark.parametrize("mode", ["soft", "hard"])
def test_a_twist_against_a_plane_is_a_contradiction(mode: Any) -> None:
    """A hard one is met, and the plane alone is missed."""
    plane = PointOnPlane(name="stay", normal=(1, 0, 0), through=(0.18, 0, 0))
    found = explained(nao(Twist(name="go", velocity={"x": -0.02}, mode=mode), plane))
    assert found.kind == "contradiction"
    assert set(found.tasks) == {"go", "stay"}


def test_redundant_tasks_that_agree_are_no_contradiction() -> None:
    found = explained(nao(REACH, replace(REACH, name="again")))
    assert found.kind == "reached"


def test_a_pose_asks_for_more_than_firm_hands_leave() -> None:
    """Six rows; the loops of two arms of five joints leave ten less six motions."""
    pose = Pose(name="carry", goal=PoseValue(position=(0.175, 0.008, 0.02), rpy_deg=(-9, 12, 0)))
    found = explained(nao(pose))
    assert found.kind == "freedom"
    assert "carry needs 6 degrees of freedom, the loops leave 4" in found.sentence


@pytest.mark.parametrize(("speed", "said"), [(0.2, "it keeps moving"), (1e-6, "it rests")])
def test_arms_that_go_on_are_not_said_to_rest(speed: float, said: str, chain: ClosedChain) -> None:
    """As after a reference that goes round for ever."""
    problem: Any = SimpleNamespace(chain=chain, limits=(JointPosition(),))
    phase: Any = SimpleNamespace(problem=problem, v=np.array([chain.q_start * 0.0 + speed]))
    place: Any = SimpleNamespace(q=chain.q_start)
    assert _rests(phase, place, ()).startswith(f"{said} although this is inside the limits: ")
