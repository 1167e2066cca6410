"""The baselines against their papers' formulas, each written down in another way."""

from __future__ import annotations

import numpy as np
import pytest
from chains import HANDS, PAPER_SCHEME, Walk
from laws import DT, LIMITS, NEAR, STEP, UNREACHABLE, answer, problem, run
from scipy.optimize import linprog

import coopqp
from coopqp.assessment import assess
from coopqp.base.errors import InvalidValueError
from coopqp.base.spec import Array
from coopqp.closed_loop.constraint_equations import constraint_equations
from coopqp.controller import Command, Controller, ControlProblem
from coopqp.controllers import (
    Pseudoinverse,
    QPController,
    SaturationNullSpace,
    TwoStep,
    WeightedLeastNorm,
)
from coopqp.controllers.saturation_null_space import Saturated, saturate
from coopqp.grasps import Revolute
from coopqp.limits import JointAcceleration, JointPosition, JointVelocity, Workspace
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.grasp_configuration import HeldObject
from coopqp.model.state import State
from coopqp.robots import NaoT14
from coopqp.solver import Status
from coopqp.tasks import PointOnPoint

REACH = PointOnPoint(goal=NEAR, profile=STEP)
FAR = PointOnPoint(goal=(0.10, -0.05, 0.04), profile=STEP)


def rows_of(state: State, goal: tuple[float, float, float], gain: float = 5.0) -> tuple:
    """J and what it should give, J_c and what it should give, of a point task with kappa = 1/dt."""
    return state.J_task[:3], -gain * (state.p_WO - goal), state.J_rel, -state.loop_error / DT


def tick(controller: Controller, given: ControlProblem, q: Array, v: Array) -> Command:
    """One tick from a configuration and a last velocity."""
    law = controller.build(given)
    state = law.start(q)
    state.v[:] = v
    return law.tick(state).copy()


# Weighted least norm.


def criterion(chain: ClosedChain, q: Array) -> float:
    """Chan and Dubey's H(q), eq. (12) there."""
    upper, lower = chain.upper, chain.lower
    return float(np.sum((upper - lower) ** 2 / (4.0 * (upper - q) * (q - lower))))


def slopes(chain: ClosedChain, q: Array) -> Array:
    """|dH/dq_i| by central differences."""
    h = 1e-6 * np.eye(chain.n)
    return np.array([abs(criterion(chain, q + d) - criterion(chain, q - d)) / 2e-6 for d in h])


def test_weighted_least_norm_is_the_closed_form(
    chain: ClosedChain, closed_loop_walk: Walk, rng: np.random.Generator
) -> None:
    """V = W^-1 A' (A W^-1 A')^-1 b, with W from H and from whether |dH/dq| has grown."""
    inside = [q for q in closed_loop_walk(chain, 40) if margin(chain, q) > 0.02][:6]
    assert len(inside) == 6
    seen = set()
    for q in inside:
        v = rng.normal(size=chain.n)
        grows = slopes(chain, q) >= slopes(chain, q - 1e-4 * v)
        W = np.diag(1.0 + np.where(grows, slopes(chain, q), 0.0))
        seen |= set(grows.tolist())
        J, wanted, J_c, closing = rows_of(State(chain, q), NEAR)
        A, b = np.vstack([J, J_c]), np.concatenate([wanted, closing])
        expected = np.linalg.solve(W, A.T) @ np.linalg.solve(A @ np.linalg.solve(W, A.T), b)
        found = tick(WeightedLeastNorm(), problem(chain, REACH), q, v).v
        np.testing.assert_allclose(found, expected, rtol=1e-5, atol=1e-7)
    assert seen == {True, False}


def margin(chain: ClosedChain, q: Array) -> float:
    """Distance of the joint nearest to its limit [rad]; negative outside."""
    return float(np.minimum(q - chain.lower, chain.upper - q).min())


def test_weighted_least_norm_spares_a_joint_at_its_limit_and_lets_it_back(
    chain: ClosedChain, closed_loop_walk: Walk
) -> None:
    """A joint at its limit, or a step beyond, hardly moves on; on its way back it is free."""
    q = next(q for q in closed_loop_walk(chain, 40) if margin(chain, q) > 0.02)
    plain = np.abs(answer(Pseudoinverse(), problem(chain, REACH, kappa=0.0), q))
    joint = int(np.argmax(plain))
    for beyond in (-1e-5, 1e-3):  # by so much the joint is beyond its upper limit
        tight = chain.moved(chain.q_start)
        tight.upper = chain.upper.copy()
        tight.upper[joint] = q[joint] - beyond
        given, out = problem(tight, REACH, kappa=0.0), np.eye(chain.n)[joint]
        assert abs(tick(WeightedLeastNorm(), given, q, out).v[joint]) < 0.01 * plain[joint]
        assert abs(tick(WeightedLeastNorm(), given, q, -out).v[joint]) > 0.1 * plain[joint]


def test_weighted_least_norm_solves_the_headline_inside_all_limits() -> None:
    """On point_on_point it is as good as the QP, and the documentation says so."""
    trace = coopqp.run(coopqp.load("point_on_point"), controller="weighted_least_norm")
    assert assess(trace).errors[0] < 1e-5
    assert (trace.lower <= trace.q).all()
    assert (trace.q <= trace.upper).all()


# Saturation in the null space.


def largest_scale(given: ControlProblem, state: State, goal: tuple) -> tuple[float, Array, Array]:
    """The largest s by a linear program in (v, s), and the bounds that it had."""
    chain = given.chain
    J, wanted, J_c, closing = rows_of(state, goal)
    lb = np.maximum(np.minimum((chain.lower - state.q) / DT, 0.0), -chain.velocity)
    ub = np.minimum(np.maximum((chain.upper - state.q) / DT, 0.0), chain.velocity)
    A = np.block([[J, -wanted[:, None]], [J_c, np.zeros((6, 1))]])
    b = np.concatenate([np.zeros(3), closing])
    bounds = [*zip(lb, ub, strict=True), (0.0, 1.0)]
    found = linprog(-np.eye(chain.n + 1)[-1], A_eq=A, b_eq=b, bounds=bounds)
    return (float(found.x[-1]) if found.status == 0 else -1.0), lb, ub


@pytest.fixture(scope="module")
def saturated() -> list[tuple[float, float, float, float, float]]:
    """SNS on its way to a goal beyond the limits: s, the LP's s, and what v breaks."""
    scenario = coopqp.load("joint_limit_stress")
    goal = (0.10, -0.05, 0.04)
    given = problem(scenario.chain, FAR, limits=LIMITS)
    law = SaturationNullSpace().build(given)
    state, found = law.start(), []
    for _ in range(150):
        command = law.tick(state)
        best, lb, ub = largest_scale(given, state, goal)
        J, wanted, J_c, closing = rows_of(state, goal)
        off = float(np.abs(J @ command.v - command.scale * wanted).max())
        gap = float(np.abs(J_c @ command.v - command.drift * closing).max())
        beyond = float(np.maximum(lb - command.v, command.v - ub).max())
        found.append((command.scale, best, off, gap, beyond))
        state.advance(command.v, DT)
    return found


def test_saturation_keeps_bounds_and_loops_exactly_and_the_tasks_direction(
    saturated: list[tuple[float, float, float, float, float]],
) -> None:
    for _, _, off, gap, beyond in saturated:
        assert off < 1e-7
        assert gap < 1e-7
        assert beyond <= 0.0


def test_saturation_scales_as_the_linear_program_does(
    saturated: list[tuple[float, float, float, float, float]],
) -> None:
    """Never above it; the algorithm does not promise the maximum, but finds it here."""
    scales = np.array([(s, best) for s, best, *_ in saturated if best >= 0.0])
    assert len(scales) > 140
    assert (scales[:, 0] <= scales[:, 1] + 1e-6).all()
    assert {bool(s < 1.0) for s, _ in scales} == {True, False}
    assert np.mean(scales[:, 0] >= scales[:, 1] - 1e-6) > 0.95


def test_saturation_is_the_pseudoinverse_where_no_bound_is_in_the_way(chain: ClosedChain) -> None:
    given = problem(chain, REACH, limits=LIMITS)
    found = answer(SaturationNullSpace(), given)
    np.testing.assert_allclose(found, answer(Pseudoinverse(), given), atol=1e-9)


def test_saturation_keeps_the_loops_at_singular_poses(chain: ClosedChain) -> None:
    """Where tasks and loops contradict each other the tasks give way."""
    stretched = coopqp.load("near_singular")
    given = problem(stretched.chain, PointOnPoint(goal=UNREACHABLE), limits=LIMITS)
    law = SaturationNullSpace().build(given)
    state = law.start()
    for _ in range(100):
        command = law.tick(state)
        closing = -command.drift * state.loop_error / DT
        np.testing.assert_allclose(state.J_rel @ command.v, closing, atol=1e-7)
        state.advance(command.v, DT)


def test_saturation_keeps_acceleration_limits_and_says_where_it_gave_them_up(
    chain: ClosedChain,
) -> None:
    limits = (*LIMITS, JointAcceleration(max=3.0))
    trace = run(SaturationNullSpace(), problem(chain, REACH, limits=limits), 150)
    change = np.abs(np.diff(trace.v, axis=0, prepend=np.zeros((1, chain.n)))) / DT
    kept = np.array(["ACCELERATION_GIVEN_UP" not in status for status in trace.status])
    assert kept.mean() > 0.5
    assert change[kept].max() <= 3.0 + 1e-6
    assert (chain.lower <= trace.q).all()
    assert (trace.q <= chain.upper).all()


def test_saturation_refuses_limits_in_space(chain: ClosedChain) -> None:
    wall = Workspace(normal=(0, 0, 1), through=(0, 0, 0))
    given = problem(chain, REACH, limits=(JointPosition(), JointVelocity(), wall))
    with pytest.raises(InvalidValueError, match=r"single joints alone, found .*workspace"):
        SaturationNullSpace().build(given)


def test_one_level_saturates_scales_or_says_that_it_cannot() -> None:
    """Two joints that add up to 1, worked out by hand."""
    J, wanted, nothing, zero = np.ones((1, 2)), np.ones(1), np.zeros((0, 2)), np.zeros(2)

    def level(lb: float, ub: tuple[float, float]) -> Saturated | None:
        return saturate(J, wanted, nothing, zero, np.full(2, lb), np.array(ub))

    free, one, both = (level(-1.0, ub) for ub in ((0.6, 0.6), (0.3, 2.0), (0.3, 0.4)))
    assert free
    assert one
    assert both
    np.testing.assert_allclose([*free.v, free.scale], [0.5, 0.5, 1.0], atol=1e-12)
    np.testing.assert_allclose([*one.v, one.scale], [0.3, 0.7, 1.0], atol=1e-12)
    np.testing.assert_allclose([*both.v, both.scale], [0.3, 0.4, 0.7], atol=1e-12)
    assert level(0.8, (2.0, 2.0)) is None


# The paper's two steps.


def test_two_steps_are_the_papers_equations(chain: ClosedChain, closed_loop_walk: Walk) -> None:
    """With q_a = [q1 q2 q3 q7] and no stabilisation: v_a = J_a^+ h_dot, v = motion v_a."""
    given = problem(chain, REACH, kappa=0.0)
    for q in closed_loop_walk(chain, 5):
        state = State(chain, q)
        wanted = -5.0 * (state.p_WO - NEAR)
        eqs = constraint_equations(chain, q, np.zeros(chain.n), actuated=PAPER_SCHEME)
        v_a = np.linalg.pinv(eqs.J_a[0][:3]) @ wanted  # eq. (17), from the right arm
        expected = np.zeros(chain.n)
        expected[list(eqs.actuated)] = v_a
        expected[list(eqs.passive)] = eqs.G @ v_a  # eq. (10)
        expected[list(eqs.cut)] = eqs.G_cut @ v_a  # eq. (12)
        found = answer(TwoStep(actuated=PAPER_SCHEME), given, q)
        np.testing.assert_allclose(found, expected, atol=1e-6 * max(1.0, np.abs(expected).max()))


def test_two_steps_correct_the_drift_and_meet_the_task(
    chain: ClosedChain, rng: np.random.Generator
) -> None:
    q = chain.q_start + 1e-4 * rng.normal(size=chain.n)
    J, wanted, J_c, closing = rows_of(State(chain, q), NEAR)
    v = answer(TwoStep(), problem(chain, REACH), q)
    np.testing.assert_allclose(J @ v, wanted, atol=1e-9)
    np.testing.assert_allclose(J_c @ v, closing, atol=1e-9)


def test_two_steps_stand_still_where_the_papers_scheme_is_singular(chain: ClosedChain) -> None:
    """NAO's start is mirror-symmetric, where [q1 q2 q3 q7] do not decide the other joints."""
    law = TwoStep(actuated=PAPER_SCHEME).build(problem(chain, REACH))
    command = law.tick(law.start())
    assert command.status is Status.SOLVER_ERROR
    assert not command.v.any()
    assert answer(TwoStep(), problem(chain, REACH)).any()


def test_two_steps_leave_passive_joints_to_the_loops() -> None:
    robot = NaoT14().build()
    hinged = ClosedChain.attach(robot, robot.configuration(HANDS), Revolute(), HeldObject())
    law = TwoStep().build(problem(hinged, REACH))
    assert not set(law._actuated) & set(hinged.passive.tolist())  # type: ignore[attr-defined]
    assert len(law._actuated) == 6  # type: ignore[attr-defined]
    asked = TwoStep(actuated=(*PAPER_SCHEME, "LElbowYaw", hinged.joint_names[hinged.passive[0]]))
    with pytest.raises(InvalidValueError, match="passive joint and has no motor"):
        asked.build(problem(hinged, REACH))


def test_without_limits_in_the_way_all_baselines_move_the_object_as_the_qp(
    chain: ClosedChain,
) -> None:
    J = State(chain).J_task[:3]
    given = problem(chain, REACH, limits=LIMITS)
    twist = J @ answer(QPController(damping=1e-9, error_damping=0.0), given)
    for controller in (WeightedLeastNorm(), SaturationNullSpace(), TwoStep()):
        np.testing.assert_allclose(J @ answer(controller, given), twist, atol=1e-6)
