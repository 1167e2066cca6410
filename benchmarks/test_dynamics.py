"""The closed-loop models side by side with pinocchio's own constrained dynamics, in one run."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from coopqp.closed_loop.dynamics import ClosedLoopDynamics
from coopqp.scenario.scenario import Scenario

CALLS = 200


@pytest.fixture(scope="module")
def dynamics(scenario: Scenario) -> ClosedLoopDynamics:
    """NAO with the box."""
    return ClosedLoopDynamics(scenario.chain)


@pytest.fixture(scope="module")
def motion(dynamics: ClosedLoopDynamics) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """q, v, tau of a state with the loops closed."""
    rng = np.random.default_rng(0)
    q = dynamics.chain.q_start
    dynamics.update(q, np.zeros_like(q))
    basis = dynamics.null_space()
    return q, basis @ rng.normal(size=basis.shape[1]), rng.normal(size=len(q))


@pytest.mark.benchmark(group="dynamics")
def test_pinocchio_constraint_dynamics(
    benchmark: BenchmarkFixture, dynamics: ClosedLoopDynamics, motion: tuple[np.ndarray, ...]
) -> None:
    """Accelerations from torques by pinocchio."""
    model, chain = dynamics.model, dynamics.chain
    right, left = (model.frames[frame] for frame in chain.frames)
    loop = pin.RigidConstraintModel(
        pin.ContactType.CONTACT_6D, model, left.parentJoint, left.placement,
        right.parentJoint, right.placement, pin.LOCAL,
    )  # fmt: skip
    models = pin.StdVec_RigidConstraintModel([loop])
    datas = pin.StdVec_RigidConstraintData([loop.createData()])
    data, settings = model.createData(), pin.ProximalSettings(1e-12, 0.0, 10)
    pin.initConstraintDynamics(model, data, models, datas)

    def calls() -> None:
        for _ in range(CALLS):
            pin.constraintDynamics(model, data, *motion, models, datas, settings)

    benchmark(calls)


@pytest.mark.benchmark(group="dynamics")
def test_direct_model(
    benchmark: BenchmarkFixture, dynamics: ClosedLoopDynamics, motion: tuple[np.ndarray, ...]
) -> None:
    """Accelerations from torques, all terms computed anew."""
    q, v, tau = motion

    def calls() -> None:
        for _ in range(CALLS):
            dynamics.update(q, v)
            dynamics.direct(tau)

    benchmark(calls)


@pytest.mark.benchmark(group="dynamics")
def test_inverse_model(
    benchmark: BenchmarkFixture, dynamics: ClosedLoopDynamics, motion: tuple[np.ndarray, ...]
) -> None:
    """Torques from accelerations, all terms computed anew."""
    q, v, tau = motion
    dynamics.update(q, v)
    a = dynamics.direct(tau).a.copy()

    def calls() -> None:
        for _ in range(CALLS):
            dynamics.update(q, v)
            dynamics.inverse(a)

    benchmark(calls)
