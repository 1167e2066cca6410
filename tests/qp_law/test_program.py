"""The program that the QP states: its cost and its names."""

from __future__ import annotations

import numpy as np
import pytest
from chains import Walk
from laws import NEAR, STEP, problem

from coopqp.base.qp import names_of
from coopqp.base.spec import Array
from coopqp.controller import ControlProblem
from coopqp.controllers import QPController
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.state import State
from coopqp.tasks import PointOnPoint


def test_qp_minimises_what_its_docstring_says(
    chain: ClosedChain, closed_loop_walk: Walk, rng: np.random.Generator
) -> None:
    """The first level's cost is half the sum of the weighted squares, up to a constant."""
    reach = PointOnPoint(goal=NEAR, weight=3.0, gain=4.0, profile=STEP)
    law = QPController(damping=0.01, error_damping=0.0).plain(problem(chain, reach))

    def task_cost(state: State, v: Array) -> float:
        missed = state.J_task[:3] @ v + 4.0 * (state.p_WO - NEAR)
        return float(3.0 * missed @ missed + 0.01 * v @ v)

    for q in closed_loop_walk(chain, 3):
        state = State(chain, q)
        law.tick(state)
        qp, zero = law.first.qp, task_cost(state, np.zeros(chain.n))
        for v in rng.normal(size=(5, chain.n)):
            stated = 0.5 * v @ qp.P @ v + qp.q @ v
            assert 2 * stated == pytest.approx(task_cost(state, v) - zero)
        np.testing.assert_allclose(qp.P, qp.P.T, atol=1e-16)


def test_qp_names_its_variables_and_rows(reach_too_far: ControlProblem, chain: ClosedChain) -> None:
    law = QPController().plain(reach_too_far)
    assert names_of(law.first.qp.rows.variables) == chain.joint_names
    assert law.first.qp.rows.equalities == chain.loops.rows
    assert law.first.qp.rows.inequalities == ()
