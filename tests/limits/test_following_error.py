"""Commands do not run away from joints that are held up, and nothing else changes."""

from __future__ import annotations

import numpy as np
import pytest
from example_limits import empty_rows
from laws import DT, problem

from coopqp.base.spec import Array
from coopqp.controllers import QPController
from coopqp.grasps import Revolute
from coopqp.limit import Limit
from coopqp.limits import FollowingError, JointPosition, JointVelocity
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.grasp_configuration import HeldObject
from coopqp.model.profile import Profile
from coopqp.model.state import State
from coopqp.robot import RobotModel
from coopqp.tasks import PointOnPoint

MOST = 0.03  # rad
LIMITS = (JointPosition(), JointVelocity())
LEASH = (*LIMITS, FollowingError(max=MOST))
WAY = np.array([0.02, 0.0, 0.02])  # m
SLOW = Profile(duration=1.0)
HELD_UP, RELEASED, END = 20, 120, 500  # ticks


def bounds(chain: ClosedChain, state: State) -> tuple[Array, Array]:
    limit = FollowingError(max=MOST)
    rows = empty_rows(chain, limit)
    limit.bind(chain, DT)(state, rows)
    return rows.lb, rows.ub


def test_a_command_may_lead_by_the_limit_and_come_back(held_box: ClosedChain) -> None:
    state = State(held_box)
    state.q_measured = state.q.copy()
    state.q[0] += 0.01
    state.q[1] -= 0.05
    lb, ub = bounds(held_box, state)
    assert (lb[0], ub[0]) == pytest.approx((-(MOST + 0.01) / DT, (MOST - 0.01) / DT))
    assert (lb[1], ub[1]) == pytest.approx((0.0, 8.0))  # 8 rad/s was there before
    assert (lb[2:] == -MOST / DT).all()
    assert (ub[2:] == MOST / DT).all()


@pytest.mark.parametrize("measured", [None, np.zeros(3), np.full(10, np.nan)])
def test_what_is_not_measured_bounds_nothing(held_box: ClosedChain, measured: Array) -> None:
    state = State(held_box)
    state.q_measured = measured
    lb, ub = bounds(held_box, state)
    assert (lb == -8.0).all()
    assert (ub == 8.0).all()


def test_passive_joints_follow_the_others(nao: RobotModel, held_box: ClosedChain) -> None:
    hinged = ClosedChain.attach(
        nao, held_box.q_start, Revolute(point=(0.0, 0.0, -0.05)), HeldObject()
    )
    state = State(hinged)
    state.q_measured = state.q - 0.1
    lb, ub = bounds(hinged, state)
    assert (ub[hinged.passive] == 8.0).all()
    assert (lb[hinged.passive] == -8.0).all()
    assert (np.delete(ub, hinged.passive) == 0.0).all()


def held_up(chain: ClosedChain, limits: tuple[Limit, ...]) -> tuple[Array, Array, float]:
    """Commanded and measured joints of a motion during which the arms are held for a while."""
    goal = tuple((State(chain).p_WO + WAY).tolist())
    reach = PointOnPoint(goal=goal, gain=5.0, profile=SLOW)
    law = QPController().build(problem(chain, reach, limits=limits))
    state = law.start(q_measured=chain.q_start)
    commanded, measured = np.zeros((2, END, chain.n))
    for k in range(END):
        command = law.tick(state)
        assert command.status.usable
        state.advance(command.v, DT)
        state.q_measured = state.q.copy()
        if HELD_UP <= k < RELEASED:
            state.q_measured[:] = measured[HELD_UP - 1]
        commanded[k], measured[k] = state.q, state.q_measured
    return commanded, measured, float(np.linalg.norm(State(chain, state.q).p_WO - goal))


def test_arms_that_are_held_up_are_not_left_behind(held_box: ClosedChain) -> None:
    commanded, measured, error = held_up(held_box, LEASH)
    assert np.abs(commanded - measured).max() < MOST + 1e-12
    assert error < 1e-6
    for q in commanded[::40]:
        assert State(held_box, q).loop_position_error < 1e-4
    without, left, _ = held_up(held_box, LIMITS)
    assert np.abs(without - left).max() > 2.0 * MOST  # what the leash is there for


def test_a_leash_that_is_slack_changes_nothing(held_box: ClosedChain) -> None:
    goal = tuple((State(held_box).p_WO + WAY).tolist())
    found = []
    for limits in (LIMITS, LEASH):
        law = QPController().build(
            problem(held_box, PointOnPoint(goal=goal, gain=5.0, profile=SLOW), limits=limits)
        )
        state = law.start(q_measured=held_box.q_start)
        for _ in range(100):
            state.advance(law.tick(state).v, DT)
            state.q_measured = state.q.copy()
        found.append(state.q.copy())
    assert np.array_equal(*found)
