"""Accelerations from torques, against projection, multipliers and pinocchio."""

from __future__ import annotations

import itertools
from collections.abc import Callable

import numpy as np
import pinocchio as pin
import pytest
import scipy.linalg
from chains import BOX, Closed, closed_states, heavy, planar_pair, ring, spherical_pair, three_arms
from dynamics_by_hand import SHARES, Oracle, PinocchioOracle, accelerations, relative

from coopqp.base.spec import Array
from coopqp.closed_loop.dynamics import ClosedLoopDynamics, Friction
from coopqp.model.closed_chain import ClosedChain

H = 1e-4  # step of central differences in time [s]


def test_random_states_are_closed(box_chain: ClosedChain, states: list[Closed]) -> None:
    data = box_chain.model.createData()
    for q, v in states:
        pin.framesForwardKinematics(box_chain.model, data, q)
        right, left = (data.oMf[frame] for frame in box_chain.frames)
        assert right.isApprox(left, 1e-12)
        np.testing.assert_allclose(box_chain.loop_jacobian(q) @ v, 0, atol=1e-12)


@pytest.mark.parametrize("by", [Oracle.by_kkt, Oracle.by_projection])
def test_direct_model_is_the_kkt_system_and_the_projection_on_the_free_motions(
    by: Callable[[Oracle, Array], Array], box_chain: ClosedChain, states: list[Closed]
) -> None:
    oracle, worst = Oracle(box_chain), 0.0
    found = accelerations(ClosedLoopDynamics(box_chain), states)
    for (q, v), (tau, a) in zip(states, found, strict=True):
        oracle.update(q, v)
        worst = max(worst, relative(a, by(oracle, tau)))
    assert worst <= 1e-9


def test_direct_model_agrees_with_pinocchios_constraint_dynamics(
    box_chain: ClosedChain, states: list[Closed]
) -> None:
    oracle, worst = PinocchioOracle(box_chain), 0.0
    found = accelerations(ClosedLoopDynamics(box_chain), states)
    for (q, v), (tau, a) in zip(states, found, strict=True):
        worst = max(worst, relative(a, oracle.acceleration(q, v, tau)))
    assert worst <= 1e-9


def test_terms_do_not_depend_on_what_was_computed_before(
    box_chain: ClosedChain, states: list[Closed]
) -> None:
    """Reused arrays keep nothing of another state."""
    used = ClosedLoopDynamics(box_chain)
    accelerations(used, states[:5])
    q, v = states[7]
    fresh = ClosedLoopDynamics(box_chain)
    tau = np.linspace(-1, 1, 10)
    for dynamics in (used, fresh):
        dynamics.update(q, v)
    np.testing.assert_array_equal(used.direct(tau).a, fresh.direct(tau).a)
    np.testing.assert_array_equal(used.inverse(tau).tau, fresh.inverse(tau).tau)


def test_accelerations_do_not_depend_on_which_hand_carries_the_mass(
    hinged_box: ClosedChain, hinged_states: list[Closed]
) -> None:
    """A link without mass behind a passive joint makes the tree's inertia singular, no more."""
    results = []
    for shares in SHARES:
        dynamics = ClosedLoopDynamics(hinged_box, shares=shares)
        results.append([a for _, a in accelerations(dynamics, hinged_states)])
    for one, other in itertools.combinations(results, 2):
        for a, b in zip(one, other, strict=True):
            assert relative(a, b) < 1e-9
    dynamics = ClosedLoopDynamics(hinged_box)
    dynamics.update(*hinged_states[0])
    singular = np.linalg.eigvalsh(dynamics.A)[0] / np.linalg.eigvalsh(dynamics.A)[-1]
    assert abs(singular) < 1e-12


def test_a_massless_link_agrees_with_the_projection(
    hinged_box: ClosedChain, hinged_states: list[Closed]
) -> None:
    found = accelerations(ClosedLoopDynamics(hinged_box), hinged_states)
    for arm in (0, 1):
        oracle = Oracle(hinged_box, arm)
        for (q, v), (tau, a) in zip(hinged_states, found, strict=True):
            oracle.update(q, v)
            assert relative(a, oracle.by_projection(tau)) < 1e-9


def test_redundant_loop_rows_do_no_harm(rng: np.random.Generator) -> None:
    """In the plane three of six loop rows follow from the others."""
    chain = heavy(planar_pair())
    dynamics, oracle = ClosedLoopDynamics(chain), Oracle(chain)
    some = closed_states(chain, 20)
    for (q, v), (tau, a) in zip(some, accelerations(dynamics, some), strict=True):
        oracle.update(q, v)
        assert relative(a, oracle.by_projection(tau)) < 1e-9
        dynamics.update(q, v)
        direct, inverse = dynamics.direct(tau), dynamics.inverse(a)
        assert not direct.singular
        assert not inverse.singular
        N = scipy.linalg.null_space(oracle.J, rcond=1e-8)
        np.testing.assert_allclose(inverse.tau, np.linalg.pinv(N.T) @ N.T @ tau, atol=1e-9)


def test_loop_rows_whose_dependence_varies_do_no_harm() -> None:
    """The multipliers are not unique, the accelerations are."""
    chain = heavy(spherical_pair())
    assert chain.loops.varying
    dynamics, oracle = ClosedLoopDynamics(chain), Oracle(chain)
    some = closed_states(chain, 10)
    for (q, v), (tau, a) in zip(some, accelerations(dynamics, some), strict=True):
        oracle.update(q, v)
        assert relative(a, oracle.by_projection(tau)) < 1e-8
        dynamics.update(q, v)
        N = scipy.linalg.null_space(oracle.J, rcond=1e-8)
        result = dynamics.inverse(a)
        np.testing.assert_allclose(result.tau, np.linalg.pinv(N.T) @ N.T @ tau, atol=1e-8)
        assert result.residual < 1e-9


def test_regular_state_of_varying_loop_rows_is_not_called_singular() -> None:
    chain = heavy(spherical_pair())
    dynamics, (q, v) = ClosedLoopDynamics(chain), closed_states(chain, 1)[0]
    dynamics.update(q, v)
    direct = dynamics.direct(np.ones(6))
    assert not direct.singular
    assert not dynamics.inverse(direct.a.copy()).singular


@pytest.mark.parametrize("build", [lambda: ring(3, 6), lambda: ring(4, 7), three_arms])
def test_three_and_four_arms(build: Callable[[], ClosedChain]) -> None:
    chain = build()
    chain = ClosedChain.attach(chain.robot, chain.q_start, chain.grasps, BOX)
    shares = np.full(len(chain.arms), 1 / len(chain.arms))
    first, even = ClosedLoopDynamics(chain), ClosedLoopDynamics(chain, shares=shares)
    oracle, some = Oracle(chain, arm=2), closed_states(chain, 8)
    for (q, v), (tau, a) in zip(some, accelerations(first, some), strict=True):
        oracle.update(q, v)
        assert relative(a, oracle.by_projection(tau)) < 1e-9
        first.update(q, v)
        even.update(q, v)
        assert relative(even.direct(tau).a, a) < 1e-9
        N = scipy.linalg.null_space(oracle.J)
        least = np.linalg.pinv(N.T) @ (N.T @ tau)
        np.testing.assert_allclose(first.inverse(a).tau, least, atol=1e-8)
        np.testing.assert_allclose(even.inverse(a).tau, least, atol=1e-8)


@pytest.mark.parametrize("friction", [Friction(viscous=0.3), Friction(coulomb=0.2, smoothing=0.05)])
def test_friction_takes_power_and_never_gives_it(
    box_chain: ClosedChain, states: list[Closed], friction: Friction
) -> None:
    smooth, rough = ClosedLoopDynamics(box_chain), ClosedLoopDynamics(box_chain, friction=friction)
    for q, v in states[:100]:
        smooth.update(q, v)
        rough.update(q, v)
        force = rough.H - smooth.H
        assert np.all(force * v >= 0)
        assert force @ v > 0
        tau = np.zeros(10)
        slower, faster = rough.direct(tau).a.copy(), smooth.direct(tau).a.copy()
        # The change of kinetic energy, v' A a, is less by the power of friction.
        assert v @ smooth.A @ (slower - faster) == pytest.approx(-force @ v, rel=1e-8)


def test_friction_is_viscous_plus_coulomb(box_chain: ClosedChain, states: list[Closed]) -> None:
    q, v = states[3]
    friction = Friction(viscous=0.3, coulomb=0.2, smoothing=0.05)
    rough, smooth = ClosedLoopDynamics(box_chain, friction=friction), ClosedLoopDynamics(box_chain)
    for dynamics in (rough, smooth):
        dynamics.update(q, v)
    expected = 0.3 * v + 0.2 * np.tanh(v / 0.05)
    np.testing.assert_allclose(rough.H - smooth.H, expected, atol=1e-12)
    for dynamics in (rough, smooth):
        dynamics.update(q, 0 * v)
    np.testing.assert_array_equal(rough.H, smooth.H)  # nothing slides


def test_power_of_the_motors_and_of_gravity_becomes_kinetic_energy(
    box_chain: ClosedChain, states: list[Closed]
) -> None:
    """d/dt of both energies, by differences along the motion, is the power of the torques."""
    dynamics = ClosedLoopDynamics(box_chain)
    some = states[:30]
    for (q, v), (tau, a) in zip(some, accelerations(dynamics, some), strict=True):
        energy = [
            dynamics.kinetic_energy(q + h * v + 0.5 * h * h * a, v + h * a)
            + dynamics.potential_energy(q + h * v + 0.5 * h * h * a)
            for h in (-0.1 * H, 0.1 * H)
        ]
        assert (energy[1] - energy[0]) / (0.2 * H) == pytest.approx(tau @ v, rel=1e-4, abs=1e-5)
