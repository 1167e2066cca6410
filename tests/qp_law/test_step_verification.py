"""The look at the loops after a step: its bound must never promise what kinematics do not keep."""

from __future__ import annotations

import numpy as np
import pytest

import coopqp
from coopqp.base.rank import null_space
from coopqp.model.state import State
from coopqp.qp_law.safety import StepVerification
from coopqp.solver import Budget


@pytest.mark.parametrize("name", ["point_on_point", "passive_grasp_pose", "planar_pair"])
def test_a_step_that_passes_leaves_the_loops_within_the_budget(
    name: str, rng: np.random.Generator
) -> None:
    scenario = coopqp.load(name)
    problem, budget = scenario.problem(), Budget()
    probe, state = StepVerification(problem), State(scenario.chain)
    after = State(scenario.chain)
    passed = refused = 0
    for _ in range(600):
        basis = null_space(state.J_loop)
        v = basis @ (basis.T @ rng.normal(size=len(basis))) * 10.0 ** rng.uniform(-1.0, 2.0)
        after.q[:] = state.q + problem.dt * v
        after.update()
        found = scenario.chain.loop_error(after.q)
        np.testing.assert_allclose(found, after.loop_error[: len(found)], rtol=0.0, atol=1e-14)
        if probe.within(state, v):
            passed += 1
            assert after.loop_position_error <= budget.loop_position
            assert after.loop_orientation_error <= budget.loop_orientation
        else:
            refused += 1
        state.q += 0.003 * v / max(float(np.linalg.norm(v)), 1e-9)
        state.update()
        state.close_loops(2)
    assert passed > 100
    assert refused > 10


def test_a_step_is_not_refused_for_a_loop_that_it_closes(rng: np.random.Generator) -> None:
    scenario = coopqp.load("point_on_point")
    problem = scenario.problem()
    state = State(scenario.chain)
    state.q += 0.02 * rng.normal(size=scenario.chain.n)
    state.update()
    assert state.loop_position_error > Budget().loop_position
    closing = -np.linalg.pinv(state.J_loop) @ state.e_loop / problem.dt
    assert StepVerification(problem).within(state, 0.5 * closing)
    assert not StepVerification(problem).within(state, -0.5 * closing)
