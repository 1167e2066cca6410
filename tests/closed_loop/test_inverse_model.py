"""Torques from accelerations: the least ones, the paper's equations, MuJoCo's."""

from __future__ import annotations

import math

import numpy as np
import pytest
import scipy.linalg
from chains import PAPER_SCHEME, Closed, closed_states
from dynamics_by_hand import SHARES, Oracle, accelerations
from mujoco_model import MujocoChain

from coopqp.base.errors import InvalidValueError, UnknownNameError
from coopqp.closed_loop.constraint_equations import constraint_equations
from coopqp.closed_loop.dynamics import ClosedLoopDynamics
from coopqp.model.closed_chain import ClosedChain


def test_inverse_model_undoes_the_direct_model_at_every_state(
    box_chain: ClosedChain, states: list[Closed]
) -> None:
    """Ten motors, four freedoms: not the same torques, but the same push along the free motions."""
    dynamics = ClosedLoopDynamics(box_chain)
    for (q, v), (tau, a) in zip(states, accelerations(dynamics, states), strict=True):
        dynamics.update(q, v)
        result = dynamics.inverse(a)
        N = scipy.linalg.null_space(box_chain.loop_jacobian(q))
        np.testing.assert_allclose(N.T @ result.tau, N.T @ tau, atol=1e-9)
        assert not result.singular


def test_redundant_torques_are_the_least_of_all_that_cause_the_motion(
    box_chain: ClosedChain, states: list[Closed]
) -> None:
    dynamics = ClosedLoopDynamics(box_chain)
    some = states[:50]
    for (q, v), (tau, a) in zip(some, accelerations(dynamics, some), strict=True):
        dynamics.update(q, v)
        found = dynamics.inverse(a).tau
        N = scipy.linalg.null_space(box_chain.loop_jacobian(q))
        np.testing.assert_allclose(found, np.linalg.pinv(N.T) @ (N.T @ tau), atol=1e-9)


@pytest.mark.parametrize("count", [5, 7])
def test_least_torques_of_some_motors(
    box_chain: ClosedChain, states: list[Closed], count: int, rng: np.random.Generator
) -> None:
    """Every other distribution over the same motors is the found one plus squeeze, and larger."""
    motors = list(rng.permutation(box_chain.n)[:count])
    names = [box_chain.joint_names[i] for i in motors]
    dynamics = ClosedLoopDynamics(box_chain, actuated=names)
    some = states[:20]
    for (q, v), (tau, a) in zip(some, accelerations(dynamics, some), strict=True):
        dynamics.update(q, v)
        found = dynamics.inverse(a).tau
        idle = np.setdiff1d(np.arange(box_chain.n), motors)
        np.testing.assert_array_equal(found[idle], 0)
        N = scipy.linalg.null_space(box_chain.loop_jacobian(q))
        np.testing.assert_allclose(N.T @ found, N.T @ tau, atol=1e-8)
        squeeze = scipy.linalg.null_space(N[motors].T)
        np.testing.assert_allclose(squeeze.T @ found[motors], 0, atol=1e-8)
        assert np.linalg.norm(found) <= np.linalg.norm(tau) + 1e-9


def test_redundant_actuation_follows_equation_27(
    box_chain: ClosedChain, states: list[Closed]
) -> None:
    names = [*PAPER_SCHEME, "RWristYaw", "LElbowYaw", "LWristYaw"]
    dynamics = ClosedLoopDynamics(box_chain, actuated=names)
    motors = [box_chain.joint_names.index(name) for name in names]
    for q, v in states[:50]:
        equations = constraint_equations(box_chain, q, v, actuated=PAPER_SCHEME)
        if equations.condition > 1e4:
            continue
        a = equations.motion @ [0.3, -2.0, 1.0, 0.7] + equations.drift
        dynamics.update(q, v)
        Gamma = dynamics.A @ a + dynamics.H
        tau_a = equations.motion.T @ Gamma
        spread = np.linalg.pinv(equations.motion[motors].T)  # [I, dq_r/dq_a']^+
        np.testing.assert_allclose(dynamics.inverse(a).tau[motors], spread @ tau_a, atol=1e-9)


def test_as_many_motors_as_freedoms_follow_equation_23(
    box_chain: ClosedChain, states: list[Closed]
) -> None:
    """The torques are [I G'] Gamma of the tree and no choice is left."""
    dynamics = ClosedLoopDynamics(box_chain, actuated=PAPER_SCHEME)
    oracle, regular = Oracle(box_chain), 0
    for q, v in states[:100]:
        equations = constraint_equations(box_chain, q, v, actuated=PAPER_SCHEME)
        if equations.condition > 1e4:
            continue
        regular += 1
        a = equations.motion @ [0.3, -2.0, 1.0, 0.7] + equations.drift
        oracle.update(q, v)
        Gamma = oracle.A @ a + oracle.H
        a_and_c = list(equations.actuated)
        tau = Gamma[a_and_c] + equations.G.T @ Gamma[list(equations.passive)]
        tau += equations.G_cut.T @ Gamma[list(equations.cut)]
        dynamics.update(q, v)
        result = dynamics.inverse(a)
        np.testing.assert_allclose(result.tau[a_and_c], tau, rtol=1e-8, atol=1e-8)
        assert not result.singular
    assert regular > 50


def test_papers_scheme_at_the_mirror_symmetric_start_is_called_singular(
    box_chain: ClosedChain, chain: ClosedChain
) -> None:
    """Its motors cannot make every motion there, and the answer says how much stays undone."""
    dynamics = ClosedLoopDynamics(box_chain, actuated=PAPER_SCHEME)
    still = np.zeros(10)
    dynamics.update(chain.q_start, still)
    N = scipy.linalg.null_space(box_chain.loop_jacobian(chain.q_start))
    result = dynamics.inverse(N @ np.array([3.0, -1.0, 2.0, 4.0]))
    assert result.singular
    assert result.residual > 1e-3
    everyone = ClosedLoopDynamics(box_chain)
    everyone.update(chain.q_start, still)
    assert not everyone.inverse(still).singular
    assert not everyone.direct(still).singular


def test_residual_of_a_singular_scheme_is_what_the_motors_leave_undone(
    box_chain: ClosedChain, chain: ClosedChain
) -> None:
    """The tree's equation with the found torques and wrench is off by the residual."""
    dynamics = ClosedLoopDynamics(box_chain, actuated=PAPER_SCHEME)
    dynamics.update(chain.q_start, np.zeros(10))
    N = scipy.linalg.null_space(box_chain.loop_jacobian(chain.q_start))
    a = N @ np.array([3.0, -1.0, 2.0, 4.0])
    result = dynamics.inverse(a)
    left = dynamics.A @ a + dynamics.H - result.tau - dynamics.J.T @ result.wrench
    assert np.abs(left).max() == pytest.approx(result.residual, rel=1e-9)


def test_regular_answer_leaves_no_residual(box_chain: ClosedChain, states: list[Closed]) -> None:
    dynamics = ClosedLoopDynamics(box_chain)
    for (q, v), (_, a) in zip(states[:20], accelerations(dynamics, states[:20]), strict=True):
        dynamics.update(q, v)
        result = dynamics.inverse(a)
        assert result.residual == 0.0
        left = dynamics.A @ a + dynamics.H - result.tau - dynamics.J.T @ result.wrench
        np.testing.assert_allclose(left, 0, atol=1e-9)


@pytest.mark.parametrize("shares", SHARES)
def test_inverse_model_with_hinges_leaves_them_without_torque(
    hinged_box: ClosedChain, hinged_states: list[Closed], shares: tuple[float, float]
) -> None:
    dynamics = ClosedLoopDynamics(hinged_box, shares=shares)
    found = accelerations(dynamics, hinged_states)
    for (q, v), (tau, a) in zip(hinged_states, found, strict=True):
        dynamics.update(q, v)
        result = dynamics.inverse(a)
        N = scipy.linalg.null_space(hinged_box.loop_jacobian(q))
        np.testing.assert_array_equal(result.tau[hinged_box.passive], 0)
        np.testing.assert_allclose(N.T @ result.tau, N.T @ tau, atol=1e-9)
        motors = dynamics.actuated
        least = np.linalg.pinv(N[motors].T) @ (N.T @ tau)
        np.testing.assert_allclose(result.tau[motors], least, atol=1e-8)


@pytest.fixture(scope="module", params=["rigid", "hinged"])
def held(
    request: pytest.FixtureRequest, box_chain: ClosedChain, hinged_box: ClosedChain
) -> tuple[ClosedChain, MujocoChain]:
    pytest.importorskip("mujoco")
    chain = box_chain if request.param == "rigid" else hinged_box
    return chain, MujocoChain(chain)


def test_holding_torques_are_those_of_mujoco(held: tuple[ClosedChain, MujocoChain]) -> None:
    """Least torques that do the virtual work of gravity along MuJoCo's own closed-loop motions."""
    chain, twin = held
    dynamics, still = ClosedLoopDynamics(chain), np.zeros(chain.n)
    for q in [chain.q_start, *(q for q, _ in closed_states(chain, 20))]:
        dynamics.update(q, still)
        tau = dynamics.inverse(still).tau
        work = twin.gravity_work(q)  # along the columns of motions
        np.testing.assert_allclose(work.motions.T @ tau, work.done, rtol=1e-6, atol=1e-7)
        motors = dynamics.actuated
        least = np.linalg.pinv(work.motions[motors].T) @ work.done
        np.testing.assert_allclose(tau[motors], least, rtol=1e-5, atol=1e-6)


def test_torques_for_a_motion_are_those_of_mujoco(
    held: tuple[ClosedChain, MujocoChain], rng: np.random.Generator
) -> None:
    """At speed too: MuJoCo's bias forces and inertia, along its own closed-loop motions."""
    chain, twin = held
    dynamics = ClosedLoopDynamics(chain)
    for q, v in closed_states(chain, 20):
        dynamics.update(q, v)
        N = dynamics.null_space()
        a = 5.0 * N @ (N.T @ rng.normal(size=len(N))) - np.linalg.pinv(dynamics.J) @ dynamics.drift
        tau = dynamics.inverse(a).tau
        work = twin.work(q, v, a)
        np.testing.assert_allclose(work.motions.T @ tau, work.done, rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("shares", [(0.5,), (0.5, 0.0), (1.5, -0.5), (math.nan, 1.0)])
def test_shares_that_are_none(chain: ClosedChain, shares: tuple[float, ...]) -> None:
    with pytest.raises(InvalidValueError, match="needs 2, one an arm, of at least 0 that sum to 1"):
        ClosedLoopDynamics(chain, shares=shares)


@pytest.mark.parametrize(
    ("actuated", "message"),
    [
        (["RShoulderPitch", "RElbowYaw", "LElbowYaw"], "3 joints cannot drive 4 degrees"),
        ([], "0 joints cannot drive 4 degrees"),
        (["RElbowYaw", "RElbowYaw", "LElbowYaw", "LWristYaw"], "RElbowYaw given more than once"),
    ],
)
def test_actuated_joints_that_are_no_choice(
    chain: ClosedChain, actuated: list[str], message: str
) -> None:
    with pytest.raises(InvalidValueError, match=message):
        ClosedLoopDynamics(chain, actuated=actuated)


def test_unknown_actuated_joint(chain: ClosedChain) -> None:
    with pytest.raises(UnknownNameError, match="did you mean 'RElbowYaw'"):
        ClosedLoopDynamics(chain, actuated=["RElbowYwa", "RElbowRoll", "LElbowYaw", "LWristYaw"])


def test_passive_joint_has_no_motor(hinged_box: ClosedChain) -> None:
    with pytest.raises(InvalidValueError, match=r"right\.hinge' is a passive joint"):
        ClosedLoopDynamics(hinged_box, actuated=[*hinged_box.joint_names[:5], "right.hinge"])
