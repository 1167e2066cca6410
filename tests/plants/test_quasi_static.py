"""Sagging servos and yielding grips against closed forms, and plants with masses at rest."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from coopqp.closed_loop.grasp_matrix import moved
from coopqp.closed_loop.hands import points
from coopqp.controller import Command, ControlProblem
from coopqp.grasps import Rigid
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.grasp_configuration import HeldObject
from coopqp.model.state import State
from coopqp.plant import Disturbance, Plant, PlantModel
from coopqp.plants import Mujoco, QuasiStatic, RigidBody
from coopqp.plants._dynamic import Servo
from coopqp.robot import RobotModel
from coopqp.solvers import Daqp

DT = 0.01  # s
BOX = HeldObject(size=(0.08, 0.19, 0.08), mass=0.2)
FEATHER = replace(BOX, mass=0.0)
SOFT = QuasiStatic(stiffness=50.0, grip=2e3, object_compensated=0.0)


def built(plant: Plant, chain: ClosedChain, off: Disturbance | None = None) -> PlantModel:
    problem = ControlProblem(chain=chain, tasks=(), solver=Daqp(), dt=DT)
    return plant.build(problem, 0, off or Disturbance())


def driven(model: PlantModel, chain: ClosedChain, way: np.ndarray, ticks: int) -> State:
    """Setpoints move by ``way`` in the first tick, and stay."""
    state = State(chain)
    state.update()
    command = Command(chain.n)
    command.v[:] = way / DT
    model.step(state, command)
    for _ in range(ticks - 1):
        model.step(state, Command(chain.n))
    return state


@pytest.fixture(scope="module")
def box(nao: RobotModel, chain: ClosedChain) -> ClosedChain:
    return ClosedChain.attach(nao, chain.q_start, Rigid(), BOX)


@pytest.fixture(scope="module")
def feather(nao: RobotModel, chain: ClosedChain) -> ClosedChain:
    return ClosedChain.attach(nao, chain.q_start, Rigid(), FEATHER)


def compliance(chain: ClosedChain, plant: QuasiStatic) -> np.ndarray:
    """S + C at the object's origin, for two arms that hold it at rest at the start."""
    state, k = State(chain), plant.grip
    state.update()
    model = built(plant, chain)
    hands, p = model.hand_signals.hands, state.p_WO  # type: ignore[attr-defined]
    found = state.J_rel @ state.J_rel.T / plant.stiffness
    each = np.diag([*[1.0 / k] * 3, *[1.0 / (k * 0.03**2)] * 3])
    for at in points(hands, p, state.R_WO):
        T = np.array([moved(row, p, at) for row in np.eye(6)]).T
        found = found + T.T @ each @ T
    return np.asarray(found)


def test_hands_pull_as_far_as_servos_and_grips_yield(feather: ClosedChain) -> None:
    """Of (S + C)^-1 e_c for commands that open the loop by e_c."""
    state = State(feather)
    state.update()
    way = np.linalg.pinv(state.J_rel) @ np.array([2e-4, -1e-4, 1e-4, 1e-3, 0.0, -1e-3])
    model = built(SOFT, feather)
    driven(model, feather, way, 300)
    internal = model.signals["internal_wrench"].reshape(2, 6)[1]
    expected = np.linalg.solve(compliance(feather, SOFT), state.J_rel @ way)
    np.testing.assert_allclose(internal, expected, atol=0.01 * np.abs(expected).max())
    np.testing.assert_allclose(
        model.signals["hand_wrench"].reshape(2, 6)[:, :3].sum(0), 0, atol=1e-9
    )


def test_the_lag_is_of_first_order(feather: ClosedChain) -> None:
    """Where the loops are not held, a joint's step arrives by (T/(T + dt))^k."""
    free = feather.handed_over(feather.q_start, ["left"])
    way, model = np.full(feather.n, 1e-3), built(SOFT, free)
    driven(model, free, way, 5)
    left = (0.03 / (0.03 + DT)) ** 5
    np.testing.assert_allclose(model.measured - free.q_start, (1.0 - left) * way, rtol=1e-9)


def test_a_grip_creeps_until_no_force_is_left(feather: ClosedChain) -> None:
    """By force over c; what is commanded apart ends as creep of both hands."""
    state = State(feather)
    state.update()
    way = np.linalg.pinv(state.J_rel) @ np.array([0.0, 1e-3, 0.0, 0.0, 0.0, 0.0])
    model = built(replace(SOFT, creep=2e3), feather)
    driven(model, feather, way, 3)
    soon = np.abs(model.signals["hand_wrench"]).max()
    before = model.signals["slip"].copy()
    model.step(State(feather), Command(feather.n))
    force = np.linalg.norm(model.signals["hand_wrench"].reshape(2, 6)[:, :3], axis=1)
    np.testing.assert_allclose(model.signals["slip"] - before, force * DT / 2e3, rtol=0.02)
    driven(model, feather, 0.0 * way, 3000)
    assert np.abs(model.signals["hand_wrench"]).max() < 0.01 * soon


def test_a_hand_slips_at_its_limit_and_no_earlier(feather: ClosedChain) -> None:
    state = State(feather)
    state.update()
    way = np.linalg.pinv(state.J_rel) @ np.array([0.0, 2e-3, 0.0, 0.0, 0.0, 0.0])
    firm = built(SOFT, feather)
    driven(firm, feather, way, 300)
    size = np.linalg.norm(firm.signals["hand_wrench"][:3])
    for limit in (0.5 * size, 1.5 * size):
        model = built(replace(SOFT, slip_force=float(limit)), feather)
        driven(model, feather, way, 300)
        force = np.linalg.norm(model.signals["hand_wrench"][:3])
        assert force == pytest.approx(min(limit, size), rel=1e-3)
        assert bool(model.signals["slip"].any()) == (limit < size)


def test_an_integral_part_removes_the_sag(box: ClosedChain) -> None:
    sagging, integral = built(SOFT, box), built(replace(SOFT, integral_time=0.2), box)
    driven(sagging, box, np.zeros(box.n), 1000)
    driven(integral, box, np.zeros(box.n), 1000)
    assert np.abs(sagging.measured - box.q_start).max() > 1e-3
    np.testing.assert_allclose(integral.measured, box.q_start, atol=1e-6)


def test_friction_holds_joints_that_little_pulls(box: ClosedChain) -> None:
    stuck = built(replace(SOFT, joint_friction=10.0), box)
    driven(stuck, box, np.zeros(box.n), 100)
    np.testing.assert_allclose(stuck.measured, box.q_start, atol=1e-6)


@pytest.mark.parametrize("other", ["rigid_body", "mujoco"])
def test_at_rest_it_is_as_plants_with_masses(other: str, box: ClosedChain) -> None:
    """Nothing compensates the weight, so that arms sag and squeeze; grips are firm."""
    sagging = Servo(gravity_compensation=False)
    plant: Plant = RigidBody(servo=sagging)
    if other == "mujoco":
        pytest.importorskip("mujoco")
        plant = Mujoco(servo=sagging, time_step=2.5e-4, stiffness_time=5e-4)
    ours = built(QuasiStatic(arms_compensated=0.0, object_compensated=0.0, grip=1e8), box)
    theirs = built(plant, box)
    for model in (ours, theirs):
        driven(model, box, np.zeros(box.n), 150)
    assert np.abs(ours.measured - box.q_start).max() > 1e-3
    np.testing.assert_allclose(ours.measured, theirs.measured, atol=5e-5)
    for name in ("internal_wrench", "hand_wrench", "tau"):
        size = np.abs(theirs.signals[name]).max()
        np.testing.assert_allclose(ours.signals[name], theirs.signals[name], atol=0.05 * size)


def test_compensated_weight_does_not_sag(box: ClosedChain) -> None:
    model = built(QuasiStatic(), box)
    driven(model, box, np.zeros(box.n), 100)
    np.testing.assert_allclose(model.measured, box.q_start, atol=1e-4)
    assert np.abs(model.signals["internal_wrench"]).max() < 0.05
