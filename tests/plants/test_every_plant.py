"""What every plant keeps: it rests when told to, moves as told, and goes on from phase to phase."""

from __future__ import annotations

import numpy as np
import pytest
from example_plants import EXAMPLES
from laws import DT, problem

from coopqp.base.rank import null_space
from coopqp.controller import Command
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.state import State
from coopqp.plant import Disturbance, Plant, PlantModel
from coopqp.plants import Mujoco

each_plant = pytest.mark.parametrize("plant", EXAMPLES.values(), ids=EXAMPLES.keys())


def build(plant: Plant, chain: ClosedChain) -> PlantModel:
    if isinstance(plant, Mujoco):
        pytest.importorskip("mujoco")
    return plant.build(problem(chain), 0, Disturbance())


def along_the_loops(chain: ClosedChain, speed: float) -> Command:
    """A velocity that firm hands allow."""
    command = Command(chain.n)
    basis = null_space(State(chain).J_rel)
    free = basis @ basis.sum(axis=0)  # the nearest to all joints alike
    command.v[:] = speed * free / np.abs(free).max()
    return command


@each_plant
def test_a_plant_told_to_stand_still_stands_still(plant: Plant, chain: ClosedChain) -> None:
    model, state = build(plant, chain), State(chain)
    for k in range(20):
        model.step(state, Command(chain.n))
        assert state.t == pytest.approx((k + 1) * DT, abs=1e-12)
    true = model.truth(state)
    np.testing.assert_array_equal(state.q, chain.q_start)  # as commanded
    np.testing.assert_allclose(true.q, chain.q_start, atol=1e-3)
    np.testing.assert_allclose(true.v, 0.0, atol=1e-2)


@each_plant
def test_a_plant_goes_where_it_is_told(plant: Plant, chain: ClosedChain) -> None:
    model, state = build(plant, chain), State(chain)
    command = along_the_loops(chain, 0.2)
    told = command.v.copy()
    for _ in range(20):
        model.step(state, command)
    np.testing.assert_array_equal(command.v, told)
    np.testing.assert_allclose(state.q, chain.q_start + 20 * DT * told, atol=1e-12)
    true = model.truth(state)
    assert (true.q - chain.q_start) @ told > 0.5 * 20 * DT * told @ told
    true.update()
    assert np.abs(true.loop_error).max() < 2e-3


@each_plant
def test_a_plant_goes_on_from_where_the_one_before_it_stopped(
    plant: Plant, chain: ClosedChain
) -> None:
    """Two of them, ten periods each, do what one does in twenty, but for what servos lagged by.

    Servos begin anew at the angle that they measure, as the controllers do.
    """
    whole, first, second = (build(plant, chain) for _ in range(3))
    one, two = State(chain), State(chain)
    command = along_the_loops(chain, 0.2)
    for _ in range(20):
        whole.step(one, command)
    for _ in range(10):
        first.step(two, command)
    was = first.truth(two).q.copy()
    lag = np.linalg.norm(was - two.q)  # the loops share it out over all joints
    second.resume(first)
    np.testing.assert_allclose(second.truth(two).q, was, atol=1e-9)
    for _ in range(10):
        second.step(two, command)
    np.testing.assert_allclose(second.truth(two).q, whole.truth(one).q, atol=1e-5 + lag)
    np.testing.assert_allclose(second.truth(two).v, whole.truth(one).v, atol=1e-2)
    for name, signal in whole.signals.items():
        assert second.signals[name].shape == signal.shape
        assert np.isfinite(second.signals[name]).all()
