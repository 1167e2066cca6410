"""Runs that limits hold back: by whom, and what would do.

What would do is tried with a robot that is made wider by hand.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from explained import advice, explained, gap, nao, of_case
from laws import LIMITS
from scipy.optimize import minimize

from coopqp.assessment import assess
from coopqp.base.qp import Row
from coopqp.base.spec import Array, spec
from coopqp.execution.controller_run import run
from coopqp.limit import Clearance, Limit, LimitRows, Tighten
from coopqp.limits import (
    JointAcceleration,
    SelfCollision,
    Workspace,
)
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.state import State
from coopqp.robot import Robot, RobotModel
from coopqp.scenario.loader import load
from coopqp.scenario.scenario import Scenario
from coopqp.study.explanation import RunExplanation
from coopqp.tasks import PointOnPoint


@dataclass(frozen=True)
class Wider(Robot):
    """A robot with other position limits."""

    model: RobotModel

    def build(self) -> RobotModel:
        return self.model


def given_more(scenario: Scenario, found: RunExplanation, share: float = 1.0) -> float:
    """The run's last error when the joints get a share of what is said, over its tolerance."""
    robot = scenario.robot_model
    model = robot.model.copy()
    for need in found.needed:
        joint, side = need.limit.removeprefix("limit.position[").split("].")
        i = model.idx_qs[model.getJointId(joint)]
        ends = model.upperPositionLimit if side == "upper" else model.lowerPositionLimit
        ends[i] += share * need.amount * (1 if side == "upper" else -1)
    other = replace(scenario, robot=Wider(replace(robot, model=model)))
    return float(assess(run(other, controller="qp")).errors[0] / scenario.tasks[0].tolerance)


@spec
class Wall(Limit):
    """The object's origin stays below a height; it cannot be relaxed."""

    height: float

    def rows(self, chain: ClosedChain) -> tuple[Row, ...]:
        return (Row(name="limit.wall", kind="limit", owner="wall", unit="m", of_place=True),)

    def bind(self, chain: ClosedChain, dt: float) -> Tighten:
        def tighten(state: State, rows: LimitRows) -> None:
            rows.G[0] = state.J_task[2]
            rows.h[0] = 5.0 * (self.height - state.p_WO[2])

        return tighten

    def clearance(self, chain: ClosedChain) -> Clearance:
        return lambda state: np.array([self.height - state.p_WO[2]])


def test_a_limit_that_cannot_be_relaxed_says_which_method_it_lacks() -> None:
    task = PointOnPoint(name="up", goal=(0.17, 0.0, 0.06))
    found = explained(nao(task, limits=(*LIMITS, Wall(height=0.045))))
    assert "limit 'wall' has no method relaxed(by)" in found.sentence
    assert found.tried is None


@pytest.fixture(scope="module")
def stress() -> tuple[Scenario, RunExplanation]:
    scenario = load("joint_limit_stress")
    return scenario, explained(scenario)


def test_limits_with_exactly_what_is_said_let_the_law_reach_its_goal(
    stress: tuple[Scenario, RunExplanation],
) -> None:
    """And eight tenths of it do not, so that the amount is that of the whole way."""
    scenario, found = stress
    assert (found.kind, found.tried) == ("limits", True)
    assert given_more(scenario, found) <= 1.0
    assert given_more(scenario, found, share=0.8) > 1.0
    assert "(tried: reached)" in found.sentence


def test_the_limits_that_hold_back_are_at_their_bounds_and_come_first(
    stress: tuple[Scenario, RunExplanation],
) -> None:
    scenario, found = stress
    margins = {row.name: m[-1] for row, m in run(scenario, controller="qp").margins.items()}
    assert len(found.held_back) == 3
    for held in found.held_back:
        assert margins[held.limit] < 1e-5
    assert sum(held.share for held in found.held_back) == pytest.approx(1.0, abs=0.03)
    order = [found.sentence.index(held.words.split(" (")[0]) for held in found.held_back]
    assert order == sorted(order)


def test_no_search_of_another_kind_finds_a_smaller_total(
    stress: tuple[Scenario, RunExplanation],
) -> None:
    """SLSQP on the sum of violations with the goal and the loops as equalities."""
    scenario, found = stress
    chain = scenario.chain
    goal = np.array(scenario.tasks[0].goal)  # type: ignore[attr-defined]
    n = chain.n

    def equal(x: Array) -> Array:
        p = chain.object_pose(x[:n]).translation - goal
        return np.concatenate([p, gap(chain, x[:n])])

    def inside(x: Array) -> Array:
        q, s = x[:n], x[n:]
        return np.concatenate([q - chain.lower + s, chain.upper - q + s, s])

    end = run(scenario, controller="qp").q[-1]
    answer = minimize(
        lambda x: x[n:].sum(),
        np.concatenate([end, np.full(n, 0.3)]),
        jac=lambda x: np.concatenate([np.zeros(n), np.ones(n)]),
        method="SLSQP",
        constraints=[{"type": "eq", "fun": equal}, {"type": "ineq", "fun": inside}],
        options={"maxiter": 300},
    )
    assert answer.success
    told = sum(need.amount for need in found.needed)
    assert answer.fun < told < 1.05 * answer.fun + 0.012  # 5 % and a little more, rounded up


@pytest.mark.parametrize("mode", ["hard", "scaled"])
def test_hard_and_scaled_tasks_are_held_back_by_the_same_limits(
    mode: str, stress: tuple[Scenario, RunExplanation]
) -> None:
    scenario, soft = stress
    tasks = (replace(scenario.tasks[0], mode=mode),)  # type: ignore[arg-type]
    found = explained(replace(scenario, tasks=tasks))
    assert (found.kind, found.tried) == ("limits", True)
    assert {h.limit for h in found.held_back} == {h.limit for h in soft.held_back}


def test_an_acceleration_limit_does_not_hide_the_position_limits(
    stress: tuple[Scenario, RunExplanation],
) -> None:
    scenario, soft = stress
    limits = (*scenario.limits, JointAcceleration(max=10.0))
    found = explained(replace(scenario, limits=limits))
    assert (found.kind, found.tried) == ("limits", True)
    assert {h.limit for h in found.held_back} == {h.limit for h in soft.held_back}


def test_a_wall_is_named_alone_in_millimetres_and_moved_as_a_whole() -> None:
    """The origin has to go 2 cm beyond a wall that lies in its way."""
    x, y, z = load("point_on_point").chain.start_position.tolist()
    task = PointOnPoint(name="forth", goal=(x - 0.02, y, z))
    wall = Workspace(
        name="wall", normal=(1, 0, 0), through=(x - 0.01, 0, 0), points=((0, 0, 0),), gain=20.0
    )
    scenario = nao(task, limits=(*LIMITS, wall), duration=3.0)
    found = explained(scenario)
    assert found.kind == "limits"
    assert [held.limit for held in found.held_back] == ["limit.wall.object[0]"]
    (need,) = found.needed
    assert need.unit == "m"
    assert 0.01 < need.amount < 0.0125  # 5 % and half a millimetre more, rounded up
    assert "the wall, point (0, 0, 0) of the object alone holds it back" in found.sentence
    assert "mm (tried: reached)" in found.sentence


def test_bodies_that_would_have_to_sink_into_each_other_are_not_called_curable() -> None:
    task = PointOnPoint(name="inside", goal=(0.08, 0.0, 0.0))
    found = explained(nao(task, limits=(*LIMITS, SelfCollision())))
    assert found.kind == "limits"
    assert found.held_back[0].words == "the distance of object and torso"
    assert found.tried is None
    assert "not tried" in found.sentence


def test_a_corner_has_a_name_that_a_person_can_find() -> None:
    """The corner that holds the table case back is the one that is lowest in the end."""
    scenario, found = advice("my4"), of_case("my4")
    table = next(k for k in scenario.limits if isinstance(k, Workspace))
    q = run(scenario, controller="qp").q[-1]
    X = scenario.chain.object_pose(q)
    half = 0.5 * np.array(scenario.held.size)
    held = found.held_back[0]
    assert held.words.startswith("the table, corner ")
    signs = [-1.0 if f"-{axis}" in held.words else 1.0 for axis in "xyz"]
    assert X.act(half * signs)[2] == pytest.approx(table.through[2], abs=1e-3)
