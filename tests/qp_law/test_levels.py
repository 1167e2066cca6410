"""Levels and weights against the lexicographic optimum, written out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import laws
import numpy as np
import pinocchio as pin
import pytest
import qpsolvers
import scipy.linalg
from chains import Walk
from laws import DT, LIMITS, NEAR, PLAIN, STEP, WIDE, answer, reach, run
from own_task import Own

from coopqp.base.spec import Array
from coopqp.controller import ControlProblem
from coopqp.limits import JointPosition, JointVelocity
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.state import State
from coopqp.qp_law.priorities import Order
from coopqp.scenario.loader import load
from coopqp.solver import Status
from coopqp.task import TaskRows
from coopqp.tasks import JointCentering, MinimumVelocity, PointOnPlane, PointOnPoint

Point = tuple[float, float, float]
GAIN, DAMPING = 5.0, PLAIN.damping
LOW: Point = (0.17, -0.01, 0.03)
ORIGIN: Point = (0.0, 0.0, 0.0)
FRONT: Point = (0.04, 0.0, -0.04)  # of the object [m]
problem = partial(laws.problem, budget=WIDE)
Rows = tuple[Array, Array, float]


def height(state: State, goal: Point, point: Point) -> Rows:
    """A point of the object goes to a height."""
    lever = state.R_WO @ point
    J = state.J_task[:3] - pin.skew(lever) @ state.J_task[3:]
    return J[2:], -GAIN * (state.p_WO + lever - goal)[2:], 1.0


def centre(state: State) -> Rows:
    chain = state.chain
    middle, span = 0.5 * (chain.lower + chain.upper), chain.upper - chain.lower
    return np.eye(chain.n), -GAIN * 2 * (state.q - middle) / span**2, 1.0


def stack_of(chain: ClosedChain, point: Point = ORIGIN, **settings: Any) -> ControlProblem:
    """Three levels; the first two disagree about the height if it is the origin's."""
    return problem(
        chain,
        PointOnPoint(name="reach", goal=NEAR, profile=STEP, priority=1),
        PointOnPlane(
            name="height", point=point, normal=(0, 0, 1), through=LOW, profile=STEP, priority=0
        ),
        secondary=[JointCentering(name="centre", gain=GAIN)],
        **settings,
    )


def levels_of(state: State, point: Point = ORIGIN) -> list[Rows]:
    return [height(state, LOW, point), (*reach(state, NEAR), 1.0), centre(state)]


def lexicographic_by_projection(state: State, levels: Sequence[Rows], damping: float) -> Array:
    """Each level by least squares in the null space of all before it; no limits."""
    A = state.J_rel
    v = np.linalg.lstsq(A, -state.loop_error / DT)[0]
    for J, wanted, weight in levels:
        N = scipy.linalg.null_space(A, rcond=1e-9)
        rows = np.vstack([np.sqrt(weight) * J @ N, np.sqrt(damping) * N])
        aims = np.concatenate([np.sqrt(weight) * (wanted - J @ v), -np.sqrt(damping) * v])
        v = v + N @ np.linalg.lstsq(rows, aims)[0]
        A = np.vstack([A, J])
    return v


def lexicographic_by_quadprog(
    state: State, levels: Sequence[Rows], damping: float, lb: Array, ub: Array
) -> Array:
    """The same with bounds: a QP a level, in coordinates z of what is still free, v = v_0 + N z.

    Bounds give way by 1e-9 a level: standing on them must not be infeasible by rounding.
    """
    A, v = state.J_rel, np.linalg.lstsq(state.J_rel, -state.loop_error / DT)[0]
    for J, wanted, weight in levels:
        lb, ub = lb - 1e-9, ub + 1e-9
        N = scipy.linalg.null_space(A, rcond=1e-9)
        P = N.T @ (weight * J.T @ J + damping * np.eye(len(v))) @ N
        q = N.T @ (weight * J.T @ (J @ v - wanted) + damping * v)
        G, h = np.vstack([N, -N]), np.concatenate([ub - v, v - lb])
        z = qpsolvers.solve_qp(P, q, G, h, solver="quadprog")
        assert z is not None
        v, A = v + N @ z, np.vstack([A, J])
    return v


def test_three_levels_are_the_chain_of_null_space_projections(
    chain: ClosedChain, closed_loop_walk: Walk
) -> None:
    given = stack_of(chain)
    for q in closed_loop_walk(chain, 6):
        state = State(chain, q)
        levels = levels_of(state)
        expected = lexicographic_by_projection(state, levels, DAMPING)
        v = answer(PLAIN, given, q)
        np.testing.assert_allclose(v, expected, atol=1e-7 * max(1.0, np.abs(v).max()))
        # The levels matter: the other order is another motion.
        other = lexicographic_by_projection(state, [levels[1], levels[0], levels[2]], DAMPING)
        assert np.abs(other - expected).max() > 1e-2


def test_symmetric_start_does_not_decide_what_later_levels_may_change(
    chain: ClosedChain, closed_loop_walk: Walk
) -> None:
    """Height of the front and reach leave nothing free: the secondary must not be seen."""
    given = stack_of(chain, FRONT)
    for q in closed_loop_walk(chain, 4):
        both, alone = answer(PLAIN, given, q), answer(PLAIN, replace(given, secondary=()), q)
        state = State(chain, q)
        np.testing.assert_allclose(state.J_rel @ both, state.J_rel @ alone, atol=1e-7)
        for J, _, _ in levels_of(state, FRONT)[:2]:
            np.testing.assert_allclose(J @ both, J @ alone, atol=1e-7)


@pytest.mark.parametrize("point", [ORIGIN, FRONT])
def test_there_is_no_level_after_all_joints_are_decided(
    chain: ClosedChain, closed_loop_walk: Walk, point: Point
) -> None:
    """At the symmetric start the front's height and the origin's place depend on each other."""
    order = Order(stack_of(chain, point))
    state = State(chain, closed_loop_walk(chain, 2)[-1])
    rows, found = state.J_rel, []
    for J, _, _ in levels_of(state, point)[:2]:
        rows = np.vstack([rows, J])
        found.append(int(np.linalg.matrix_rank(rows, rtol=1e-8)))
    assert len(order.groups) == (2 if found[-1] == chain.n else 3)


def test_nothing_is_left_after_a_wish_for_all_joints(chain: ClosedChain) -> None:
    given = stack_of(chain)
    more = replace(given, secondary=(*given.secondary, MinimumVelocity(priority=1)))
    assert len(Order(more).groups) == len(Order(given).groups)


@pytest.mark.parametrize("share", [0.02, 0.05, 0.2])
def test_three_levels_within_limits_are_a_chain_of_qps(
    share: float, chain: ClosedChain, closed_loop_walk: Walk
) -> None:
    """Against quadprog, level after level, with bounds written out here."""
    given = stack_of(chain, limits=(JointPosition(), JointVelocity(scale=share)))
    bounded = 0
    for q in closed_loop_walk(chain, 6):
        state = State(chain, q)
        lb = np.maximum((chain.lower - q) / DT, -share * chain.velocity)
        ub = np.minimum((chain.upper - q) / DT, share * chain.velocity)
        v = answer(PLAIN, given, q)
        expected = lexicographic_by_quadprog(state, levels_of(state), DAMPING, lb, ub)
        np.testing.assert_allclose(v, expected, atol=1e-6)
        bounded += int((np.minimum(v - lb, ub - v) < 1e-8).any())
    assert bounded >= (4 if share < 0.1 else 1)


def test_three_levels_at_position_limits_are_a_chain_of_qps(chain: ClosedChain) -> None:
    """Where joint_limit_stress ends: three joints rest at their position limits."""
    stress = load("joint_limit_stress").problem()
    q = run(PLAIN, stress, 300).q[-1]
    chain = stress.chain
    state = State(chain, q)
    lb = np.maximum((chain.lower - q) / DT, -chain.velocity)
    ub = np.minimum((chain.upper - q) / DT, chain.velocity)
    assert (np.minimum(-lb, ub) < 1e-6).sum() >= 3
    v = answer(PLAIN, stack_of(chain, limits=LIMITS), q)
    expected = lexicographic_by_quadprog(state, levels_of(state), DAMPING, lb, ub)
    np.testing.assert_allclose(v, expected, atol=1e-6)


def test_no_weight_of_a_later_level_disturbs_an_earlier_one(
    chain: ClosedChain, closed_loop_walk: Walk
) -> None:
    """A feather on level 0 against a ton on level 1."""
    first = PointOnPlane(name="height", normal=(0, 0, 1), through=LOW, profile=STEP, weight=1e-2)
    later = PointOnPoint(name="reach", goal=NEAR, profile=STEP, weight=1e3, priority=3)
    for q in closed_loop_walk(chain, 5):
        J = State(chain, q).J_task
        both, alone = (
            answer(PLAIN, problem(chain, *t, limits=LIMITS), q) for t in ((first, later), (first,))
        )
        assert np.abs(J @ (both - alone)).max() > 1e-3
        assert J[2] @ both == pytest.approx(J[2] @ alone, abs=1e-9)


def test_priorities_count_by_their_order_alone(chain: ClosedChain) -> None:
    """Levels 0 and 1 are levels 4 and 9, in whatever order the tasks are listed."""
    plane = PointOnPlane(name="height", normal=(0, 0, 1), through=LOW, profile=STEP)
    point = PointOnPoint(name="reach", goal=NEAR, profile=STEP)
    near = answer(PLAIN, problem(chain, plane, replace(point, priority=1)))
    far = answer(PLAIN, problem(chain, replace(point, priority=9), replace(plane, priority=4)))
    np.testing.assert_allclose(near, far, atol=1e-12)


@pytest.mark.parametrize("weights", [(1.0, 1.0), (1.0, 3.0), (10.0, 0.5)])
def test_tasks_of_one_level_share_by_weight(
    weights: tuple[float, float], chain: ClosedChain, closed_loop_walk: Walk
) -> None:
    """Two goals for one point are one goal at their weighted mean."""
    tasks = [
        PointOnPoint(name=str(i), goal=goal, profile=STEP, weight=w, priority=2)
        for i, (goal, w) in enumerate(zip((NEAR, LOW), weights, strict=True))
    ]
    mean = np.average([NEAR, LOW], axis=0, weights=weights)
    one = PointOnPoint(goal=tuple(mean.tolist()), profile=STEP, weight=sum(weights))
    for q in closed_loop_walk(chain, 3):
        np.testing.assert_allclose(
            answer(PLAIN, problem(chain, *tasks), q),
            answer(PLAIN, problem(chain, one), q),
            atol=1e-7,
        )


def test_later_level_that_is_not_a_number_spoils_nothing(chain: ClosedChain) -> None:
    """Level 1 breaks: level 0 goes on, nothing is raised."""

    def write(state: State, rows: TaskRows) -> None:
        rows.e[0], rows.J[0] = 0.0, state.J_task[2] if state.t == 0.0 else np.nan

    reach = PointOnPoint(name="reach", goal=NEAR, profile=STEP)
    given = problem(
        chain, reach, Own(name="b", write=write, priority=1), secondary=[JointCentering(name="c")]
    )
    law = PLAIN.build(given)
    state = law.start()
    assert law.tick(state).status is Status.OPTIMAL
    state.t = DT
    command = law.tick(state)
    assert np.isfinite(command.v).all()
    assert command.status is Status.INACCURATE
