"""Arms that take positions squeeze a box in MuJoCo, between hands that yield."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from chains import BOX, HANDS
from laws import DT, problem
from scenario_files import HAS_ROBOTS

import coopqp
from coopqp.assessment import assess
from coopqp.base.errors import InvalidValueError
from coopqp.base.rank import null_space
from coopqp.base.spec import Array
from coopqp.closed_loop.admittance import Admittance
from coopqp.controller import Command
from coopqp.controllers import QPController
from coopqp.grasps import Rigid
from coopqp.metrics.loop_offset import LoopOffset
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.state import State
from coopqp.plant import Disturbance
from coopqp.plants import Mujoco, RigidBody
from coopqp.plants._dynamic import Servo
from coopqp.plants.mujoco import SpringHand
from coopqp.robot import RobotModel
from coopqp.scenario.scenario import Scenario
from coopqp.solver import Status
from coopqp.tasks import InternalWrench, PointOnPoint
from coopqp.trace import Trace

WANTED = 60.0  # [N]


@pytest.fixture(scope="module")
def scenario() -> Scenario:
    if not HAS_ROBOTS:
        pytest.skip("needs coopqp[robots]")
    return coopqp.load("position_pair")


def pressed(trace: Trace) -> Array:
    """Force of both hands along x, on which they face each other, shape (T,) [N]."""
    left, right = trace.signals["hand_wrench"].reshape(trace.ticks, 2, 6)[:, :, 0].T
    return np.asarray(0.5 * (left - right), float)


@pytest.fixture(scope="module")
def lifted(scenario: Scenario) -> Trace:
    """As shipped, but faster."""
    carry, press = scenario.tasks
    assert carry.way
    sooner = replace(carry, profile=replace(carry.way, delay=0.6, duration=0.8))
    return coopqp.run(replace(scenario, tasks=(sooner, press), duration=1.9), controller="qp")


def test_sixty_newtons_are_reached_without_overshoot(lifted: Trace) -> None:
    force = pressed(lifted)
    assert set(lifted.status) == {Status.OPTIMAL.name}
    assert force[:60].max() < WANTED  # before it moves
    assert force.max() < 1.003 * WANTED
    assert force[-10:] == pytest.approx(WANTED, abs=0.1)
    assert assess(lifted).errors[-1] < 0.1


def test_the_box_is_lifted_meanwhile(lifted: Trace) -> None:
    assert lifted.position[-1, 2] - lifted.position[0, 2] == pytest.approx(0.1, abs=1e-3)


def test_hands_have_approached_by_what_hands_and_servos_yield(lifted: Trace) -> None:
    """In series; the springs are 10 kN/m, the servos by their frequency some times that."""
    way = np.linalg.norm(lifted.loop_offset[-1, :3])
    assert 5e3 < WANTED / way < 1e4


def test_what_springs_yield_is_neither_an_open_loop_nor_the_models_error(lifted: Trace) -> None:
    assert lifted.loop_position.max() < 5e-4
    assert LoopOffset().measure(lifted)["position"] < 1e-3


def test_soft_hands_are_squeezed_alike(scenario: Scenario) -> None:
    """1 kN/m in series, ten times as soft, by the gain for what is so soft."""
    carry, _ = scenario.tasks
    assert isinstance(scenario.plant, Mujoco)
    soft = replace(
        scenario,
        tasks=(carry, InternalWrench(squeeze=20.0)),
        controllers={"qp": QPController(admittance=Admittance(stiffness=1e3, lag=0.01))},
        plant=replace(scenario.plant, spring_hands=SpringHand(stiffness=2042.0)),
        duration=0.9,
    )
    force = pressed(coopqp.run(soft, controller="qp"))
    assert force.max() < 20.0
    assert force[-1] == pytest.approx(20.0, rel=0.02)


def test_springs_that_steps_cannot_follow_are_refused(scenario: Scenario) -> None:
    stiff, damped = SpringHand(stiffness=1e6), SpringHand(stiffness=1e3, damping=1e4)
    for hand, word in ((stiff, "stiffness"), (damped, "damping")):
        plant = Mujoco(spring_hands=hand)
        with pytest.raises(InvalidValueError, match=f"spring_hands.{word}"):
            coopqp.run(replace(scenario, plant=plant), controller="qp")


def test_servos_with_a_frequency_follow_alike_whatever_they_move(nao: RobotModel) -> None:
    """A speed that sets in: the error is that of a critically damped oscillator, v t exp(-w t)."""
    w, ticks = 40.0, 5
    chain = ClosedChain.attach(nao, nao.configuration(HANDS), Rigid(), BOX)
    x, y, z = chain.start_position
    asked = problem(chain, PointOnPoint(goal=(x, y, z)))
    plant = RigidBody(servo=Servo(frequency=w)).build(asked, 0, Disturbance())
    state, command = State(chain), Command(chain.n)
    command.v[:] = 1e-2 * null_space(state.J_loop).sum(axis=1)
    for _ in range(ticks):
        plant.step(state, command)
    t = ticks * DT
    assert state.q_measured is not None
    moved = state.q_measured - chain.q_start
    assert moved == pytest.approx(command.v * t * (1.0 - np.exp(-w * t)), abs=5e-6)
