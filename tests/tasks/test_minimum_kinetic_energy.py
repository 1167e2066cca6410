"""Rows whose squares are the kinetic energy."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from chains import Hinge, Walk
from example_tasks import rows

from coopqp.model.closed_chain import ClosedChain
from coopqp.model.grasp_configuration import HeldObject
from coopqp.model.state import State
from coopqp.robot import RobotModel
from coopqp.tasks import MinimumKineticEnergy


def test_least_energy_rows_measure_the_kinetic_energy(
    chain: ClosedChain, closed_loop_walk: Walk, rng: np.random.Generator
) -> None:
    """Against the sum over the links and the object."""
    model, data = chain.model, chain.model.createData()
    for q in closed_loop_walk(chain, 3):
        state, v = State(chain, q), rng.normal(size=chain.n)
        v -= np.linalg.pinv(state.J_rel) @ (state.J_rel @ v)
        energy = pin.computeKineticEnergy(model, data, q, v)
        body, V = chain.held.body(), state.J_task @ v
        V_O = np.concatenate([state.R_WO.T @ V[:3], state.R_WO.T @ V[3:]])
        energy += body.vtiv(pin.Motion(V_O)) / 2
        J = rows(MinimumKineticEnergy(), state).J
        assert np.sum((J @ v) ** 2) == pytest.approx(2.0 * energy, rel=1e-6)


def test_least_energy_is_finite_with_joints_that_move_no_mass(
    nao: RobotModel, chain: ClosedChain
) -> None:
    hinged = ClosedChain.attach(nao, chain.q_start, Hinge(), HeldObject())
    J = rows(MinimumKineticEnergy(), State(hinged)).J
    assert np.isfinite(J).all()
    assert np.linalg.matrix_rank(J) >= hinged.n - 1
