"""Copies of states and memories are alive: their views belong to them, and not to the original."""

from __future__ import annotations

import copy
import pickle
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from laws import NEAR, problem

from coopqp.controllers import PassiveGraspPid, QPController, TorqueQp
from coopqp.limits import JointPosition, JointVelocity
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.state import State
from coopqp.scenario.loader import load
from coopqp.solver import Status
from coopqp.tasks import PointOnPoint

COPIES: dict[str, Callable[[Any], Any]] = {
    "deepcopy": copy.deepcopy,
    "pickle": lambda value: pickle.loads(pickle.dumps(value)),
}
LIMITS = (JointPosition(), JointVelocity())


@pytest.mark.parametrize("how", COPIES)
def test_a_copied_state_keeps_the_loops_closed_when_it_is_driven(
    chain: ClosedChain, how: str
) -> None:
    law = QPController().build(problem(chain, PointOnPoint(name="reach", goal=NEAR), limits=LIMITS))
    state = law.start()
    for _ in range(20):
        state.advance(law.tick(state).v, 0.01)
    other = COPIES[how](state)
    for _ in range(100):
        v = law.tick(state).v.copy()
        np.testing.assert_array_equal(law.tick(other).v, v)
        state.advance(v, 0.01)
        other.advance(v, 0.01)
    true = State(chain, other.q)
    assert true.loop_position_error < 1e-4
    assert other.loop_position_error == pytest.approx(true.loop_position_error, abs=1e-12)
    assert not np.shares_memory(other.q, state.q)


@pytest.mark.parametrize("how", COPIES)
def test_a_copied_memory_is_one_array(chain: ClosedChain, how: str) -> None:
    law = QPController().build(problem(chain, PointOnPoint(name="reach", goal=NEAR)))
    memory = COPIES[how](law.start().memory)
    memory["stopped"][0] = 5.0
    assert 5.0 in memory.numbers


def test_what_no_law_can_decide_from_is_a_status(chain: ClosedChain) -> None:
    """Numbers that are none, a state of other joints, a sensor that says nothing."""
    scenario = load("passive_grasp_pose")
    laws = [
        QPController().build(problem(chain, PointOnPoint(name="reach", goal=NEAR))),
        TorqueQp().build(scenario.held_by("torque_qp").problem()),
        PassiveGraspPid().build(scenario.held_by("passive_grasp_pid").problem()),
    ]
    for law in laws:
        for key in ("q", "v"):
            for value in (np.nan, np.inf):
                state = law.start()
                getattr(state, key)[0] = value
                assert law.tick(state).status is Status.NOT_FINITE
                assert np.isfinite(law.command.v).all()
                assert law.command.tau is None or np.isfinite(law.command.tau).all()
        assert law.tick(law.start()).status.usable  # it has learnt nothing wrong
        short = law.start()
        short.q = short.q[:-1]
        assert law.tick(short).status is Status.WRONG_STATE


def test_a_dead_or_a_mistaken_sensor_is_said(chain: ClosedChain) -> None:
    law = QPController().build(problem(chain, PointOnPoint(name="reach", goal=NEAR)))
    state = law.start(q_measured=chain.q_start)
    for wrong in (np.full(chain.n, np.nan), np.zeros(chain.n - 1)):
        state.q_measured = wrong
        assert law.tick(state).causes == (Status.NOT_MEASURED,)
    state.q_measured = state.q.copy()
    state.advance(law.tick(state).v, 0.01)
    assert law.tick(state).causes == (Status.OPTIMAL,)
    state.q[0] += 1e-3  # what one should not do
    assert Status.OVERWRITTEN in law.tick(state).causes
