"""What only the QP can hold, and how the loops stay closed."""

from __future__ import annotations

import numpy as np
import pytest
from example_controllers import each_controller
from laws import DT, LIMITS, STEP, UNREACHABLE, answer, distances, problem, run

from coopqp.base.spec import Array
from coopqp.controller import Controller, ControlProblem
from coopqp.controllers import (
    DampedPseudoinverse,
    Pseudoinverse,
    PseudoinverseNullSpace,
    QPController,
)
from coopqp.limits import JointPosition, JointVelocity
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.state import State
from coopqp.tasks import PointOnPoint

BEHIND = (0.1, 0.05, -0.05)  # reachable, 13 cm away


def violation(chain: ClosedChain, q: Array) -> float:
    """How far outside the position limits [rad]; negative inside."""
    return float(np.max([chain.lower - q, q - chain.upper]))


def test_qp_stays_within_all_limits_on_the_way_to_an_unreachable_goal(
    reach_too_far: ControlProblem, chain: ClosedChain
) -> None:
    result = run(QPController(), reach_too_far, 200)
    assert not result.failures
    assert violation(chain, result.q) <= 1e-9
    assert (np.abs(result.v) <= chain.velocity + 1e-9).all()
    distance = distances(result, UNREACHABLE)
    # The limits were needed, and the object has come nearer and stopped.
    assert violation(chain, result.q) > -1e-6
    assert distance[-1] < 0.3 * distance[0]
    assert np.abs(np.diff(distance[-20:])).max() < 1e-3


def test_exact_answers_at_the_limits_count_as_optimal(reach_too_far: ControlProblem) -> None:
    """DAQP's answers lie within 3e-10 of the optimum of its active set in every such tick."""
    trace = run(QPController(), reach_too_far, 200)
    assert set(trace.status) <= {"OPTIMAL", "STEP_SHORTENED"}


@pytest.mark.parametrize("controller", [Pseudoinverse(), PseudoinverseNullSpace()], ids=str)
def test_classical_laws_leave_the_limits_on_the_same_way(
    controller: Controller, reach_too_far: ControlProblem, chain: ClosedChain
) -> None:
    result = run(controller, reach_too_far, 200)
    assert violation(chain, result.q) > 0.3
    assert (np.abs(result.v) - chain.velocity).max() > 1.0


def test_position_margin_and_velocity_share_are_kept(chain: ClosedChain) -> None:
    limits = (JointPosition(margin=0.05), JointVelocity(scale=0.1))
    given = problem(chain, PointOnPoint(goal=UNREACHABLE), limits=limits, kappa=1 / DT)
    result = run(QPController(), given, 200)
    assert violation(chain, result.q) <= -0.05 + 1e-9
    assert np.abs(result.v / chain.velocity).max() == pytest.approx(0.1, abs=1e-9)


@each_controller
def test_baumgarte_stabilisation_keeps_the_loop_closed(
    controller: Controller, chain: ClosedChain
) -> None:
    """Within 0.1 mm, over 13 cm of object motion; the damped law pays with its loop."""
    given = problem(chain, PointOnPoint(goal=BEHIND), limits=LIMITS, kappa=1 / DT)
    gap = run(controller, given, 200).loop_position.max()
    assert gap < (1e-3 if isinstance(controller, DampedPseudoinverse) else 1e-4)


def test_without_baumgarte_stabilisation_the_loop_opens_further(chain: ClosedChain) -> None:
    task = PointOnPoint(goal=BEHIND)
    gaps = [
        run(QPController(), problem(chain, task, kappa=k), 200).loop_position.max()
        for k in (0.0, 0.1 / DT, 1.0 / DT)
    ]
    assert gaps[0] > 2 * gaps[1] > 4 * gaps[2]


def test_drift_of_a_step_shrinks_with_its_square(chain: ClosedChain) -> None:
    """What kappa = 1/dt leaves is one step's linearisation error."""
    task = PointOnPoint(goal=BEHIND)
    coarse, fine = (
        run(QPController(), problem(chain, task, dt=dt, kappa=1 / dt), round(2 / dt))
        for dt in (0.02, 0.01)
    )
    assert coarse.loop_position.max() / fine.loop_position.max() == pytest.approx(4.0, rel=0.2)


@pytest.mark.parametrize("controller", [QPController(), Pseudoinverse()], ids=str)
@pytest.mark.parametrize("share", [0.0, 0.5, 1.0])
def test_open_loop_closes_by_kappa_dt_a_tick(
    controller: Controller, share: float, chain: ClosedChain, rng: np.random.Generator
) -> None:
    """Set out from a loop that gapes by a tenth of a millimetre."""
    q = chain.q_start + 1e-4 * rng.normal(size=chain.n)
    here = tuple(State(chain, q).p_WO.tolist())
    given = problem(chain, PointOnPoint(goal=here, profile=STEP), kappa=share / DT)
    before = State(chain, q).loop_error
    after = State(chain, q + DT * answer(controller, given, q)).loop_error
    assert np.abs(before).max() > 1e-5
    np.testing.assert_allclose(after, (1 - share) * before, atol=1e-6)


def test_qp_holds_the_loop_exactly_also_at_its_limits(
    reach_too_far: ControlProblem, chain: ClosedChain
) -> None:
    """J_c v = -kappa e is a hard row: tasks give way, the grasp does not."""
    result = run(QPController(), reach_too_far, 200)
    for q, v in zip(result.q[:-1:10], result.v[::10], strict=True):
        state = State(chain, q)
        np.testing.assert_allclose(state.J_rel @ v, -state.loop_error / DT, atol=1e-7)
