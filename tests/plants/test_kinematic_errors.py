"""Errors of the model: the real loops close, the controllers do not know, and nobody squeezes."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

import coopqp
from coopqp.base.errors import InvalidValueError, ScenarioError
from coopqp.controller import Command, ControlProblem
from coopqp.grasps import Rigid
from coopqp.metrics.internal_force import InternalForce
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.grasp_configuration import HeldObject
from coopqp.model.state import State
from coopqp.plant import Disturbance, Plant, Slip
from coopqp.plants import Kinematic, Mujoco, RigidBody
from coopqp.plants._true_chain import true_chain
from coopqp.robot import RobotModel
from coopqp.robots import PlanarPair
from coopqp.solvers import Daqp
from coopqp.trace import Trace

DT = 0.01  # s
WITH_MASSES: dict[str, Plant] = {
    "rigid_body": RigidBody(time_step=0.002),
    "mujoco": Mujoco(time_step=0.001),
}
PLANTS: dict[str, Plant] = {"kinematic": Kinematic(), **WITH_MASSES}
GRASP = Disturbance(grasp_offset=2e-3, grasp_offset_angle=5e-3)
LINKS = Disturbance(link_length=1e-3)
ENCODERS = Disturbance(encoder_offset=5e-3)
ERRORS = {"links": LINKS, "encoders": ENCODERS, "grasp": GRASP}
ALL = replace(GRASP, link_length=5e-4, encoder_offset=5e-3, noise_position=1e-4, delay=2)
#: A goal away from the stops.
NEAR = (0.15, 0.03, 0.035)  # m
#: On the way, and until the end; the last half second, where the squeeze is looked at, is rest.
WAY, SECONDS = 1.5, 2.1


@cache
def carried(plant: str, disturbance: Disturbance) -> Trace:
    if plant == "mujoco":
        pytest.importorskip("mujoco")
    scenario = coopqp.load("point_on_point")
    (task,) = scenario.tasks
    near = replace(task, goal=NEAR, profile=replace(task.profile, duration=WAY))
    scenario = replace(
        scenario, tasks=(near,), plant=PLANTS[plant], disturbance=disturbance, duration=SECONDS
    )
    return coopqp.run(scenario, controller="qp")


def squeeze(trace: Trace) -> float:
    """Internal force of the last half second [N]."""
    force = InternalForce().measure(trace)
    assert force is not None
    return force["end"]


# The true chain


@pytest.mark.parametrize("error", ERRORS)
@pytest.mark.parametrize("seed", [0, 1])
def test_the_true_loops_close_where_the_modelled_ones_are_open(
    chain: ClosedChain, error: str, seed: int
) -> None:
    real = true_chain(chain, seed, ERRORS[error])
    assert np.abs(State(real).loop_error).max() < 1e-9
    assert np.linalg.norm(State(chain, real.q_start).loop_error) > 5e-4
    assert np.abs(real.q_start - chain.q_start).max() < 0.05, "the nearest start"


def test_the_signs_are_those_of_the_seed(chain: ClosedChain) -> None:
    starts = [true_chain(chain, seed, GRASP).q_start for seed in (3, 3, 4)]
    np.testing.assert_array_equal(starts[0], starts[1])
    assert np.abs(starts[0] - starts[2]).max() > 1e-4


def test_without_errors_the_true_chain_is_the_model(chain: ClosedChain) -> None:
    assert true_chain(chain, 0, Disturbance(noise_position=1e-3, delay=3)) is chain


def test_an_encoder_that_is_off_says_another_angle_for_the_same_pose(
    chain: ClosedChain, nao: RobotModel
) -> None:
    """The model at q - offset is where the true chain is at q, for signs that the seed chose."""
    real, q = true_chain(chain, 0, ENCODERS).robot.model, chain.q_start
    places = hand_places(real, nao, q)
    joints = range(chain.n)
    off = np.zeros(chain.n)
    for j in joints:  # each joint's own sign, by which of the two puts its child where it is
        data, told = real.createData(), nao.model.createData()
        pin.forwardKinematics(real, data, q)
        for sign in (1.0, -1.0):
            pin.forwardKinematics(nao.model, told, q - sign * 5e-3)
            if told.liMi[j + 1].isApprox(data.liMi[j + 1], 1e-12):
                off[j] = sign * 5e-3
    assert set(np.abs(off)) == {5e-3}
    np.testing.assert_allclose(hand_places(nao.model, nao, q - off), places, atol=1e-12)


def hand_places(model: pin.Model, robot: RobotModel, q: np.ndarray) -> np.ndarray:
    data = model.createData()
    pin.framesForwardKinematics(model, data, q)
    return np.array([data.oMf[model.getFrameId(arm.tip)].translation for arm in robot.arms])


def test_links_are_longer_or_shorter_by_as_much_as_said(
    chain: ClosedChain, nao: RobotModel
) -> None:
    real = true_chain(chain, 0, LINKS).robot.model
    for joint in range(1, real.njoints):
        told = np.linalg.norm(nao.model.jointPlacements[joint].translation)
        found = np.linalg.norm(real.jointPlacements[joint].translation)
        assert abs(found - told) == pytest.approx(1e-3 if told > 1e-3 else 0.0, abs=1e-12)


def test_planar_arms_keep_what_they_cannot_follow_out_of_their_loops() -> None:
    chain = coopqp.load("planar_pair").chain
    real = true_chain(chain, 0, Disturbance(grasp_offset=1e-3, grasp_offset_angle=1e-3))
    assert np.abs(State(real).loop_error).max() < 1e-9


def test_errors_that_no_pose_can_close_are_refused_in_one_line() -> None:
    """Planar arms that point at each other, stretched out: shorter links do not meet."""
    pair = PlanarPair(distance=1.3).build()
    q = np.radians([90.0, 0.0, 0.0, -90.0, 0.0, 0.0])
    stretched = ClosedChain.attach(pair, q, Rigid(), HeldObject())
    refused = []
    for seed in range(10):
        try:
            true_chain(stretched, seed, LINKS)
        except InvalidValueError as error:
            refused.append(str(error))
    assert 0 < len(refused) < 10, "shorter ones only"
    assert "cannot close their loops" in refused[0]
    assert "\n" not in refused[0]


# Plants


@pytest.mark.parametrize("plant", WITH_MASSES)
def test_velocity_commands_leave_the_commanded_joints_in_q(plant: str, chain: ClosedChain) -> None:
    if plant == "mujoco":
        pytest.importorskip("mujoco")
    disturbance = replace(GRASP, noise_position=1e-4)
    problem = ControlProblem(chain=chain, tasks=(), solver=Daqp(), dt=DT)
    model = WITH_MASSES[plant].build(problem, 0, disturbance)
    assert model.measured is not None
    start = model.measured.copy()
    state, command = State(chain, start), Command(chain.n)
    for k in range(10):
        command.v[:] = 0.1
        model.step(state, command)
        np.testing.assert_allclose(state.q, start + 0.1 * DT * (k + 1), atol=1e-15)
        np.testing.assert_array_equal(state.v, command.v)
        assert state.q_measured is not None
        noise = state.q_measured - model.truth(state).q
        assert 0.0 < np.abs(noise).max() < 1e-3
    assert np.abs(state.q - state.q_measured).max() > 1e-3, "the loops do not let them"


@pytest.mark.parametrize("plant", WITH_MASSES)
def test_torque_commands_leave_the_measured_joints_in_q(plant: str, chain: ClosedChain) -> None:
    if plant == "mujoco":
        pytest.importorskip("mujoco")
    problem = ControlProblem(chain=chain, tasks=(), solver=Daqp(), dt=DT)
    model = WITH_MASSES[plant].build(problem, 0, GRASP)
    state, command = State(chain), Command(chain.n, torques=True)
    for _ in range(5):
        model.step(state, command)
    np.testing.assert_array_equal(state.q, model.measured)
    np.testing.assert_array_equal(state.q, model.truth(state).q)
    assert state.q_measured is None
    assert np.abs(state.v).max() > 1e-3, "nothing holds it"


def test_perfect_joints_have_nothing_to_measure(chain: ClosedChain) -> None:
    problem = ControlProblem(chain=chain, tasks=(), solver=Daqp(), dt=DT)
    model, state = Kinematic().build(problem, 0, Disturbance()), State(chain)
    model.step(state, Command(chain.n))
    assert model.measured is None
    assert state.q_measured is None
    assert model.truth(state) is state


@pytest.mark.few(3)
@pytest.mark.parametrize("error", ERRORS)
@pytest.mark.parametrize("plant", WITH_MASSES)
def test_errors_of_the_model_do_not_squeeze_the_box(plant: str, error: str) -> None:
    trace = carried(plant, ERRORS[error])
    assert squeeze(trace) <= squeeze(carried(plant, Disturbance())) + 0.05
    assert not trace.signals["saturated"].any()
    assert set(trace.status) == {"OPTIMAL"}
    assert trace.loop_position.max() < 1e-5, "the true loops are closed"
    assert np.linalg.norm(trace.loop_offset[-1, :3]) > 5e-4, "and the controller has seen the error"


@pytest.mark.parametrize("plant", WITH_MASSES)
def test_all_errors_with_noise_and_delay_do_not_squeeze_the_box(plant: str) -> None:
    trace = carried(plant, ALL)
    assert squeeze(trace) <= squeeze(carried(plant, Disturbance())) + 0.1
    assert not trace.signals["saturated"].any()
    assert set(trace.status) == {"OPTIMAL"}


@pytest.mark.parametrize("plant", WITH_MASSES)
def test_a_slip_is_let_go_of(plant: str) -> None:
    trace = carried(plant, Disturbance(slip=Slip(at=0.5, by=5e-3)))
    force = np.linalg.norm(trace.signals["internal_wrench"][:, :3], axis=1)
    assert force[:50].max() < 0.2
    assert force[60:70].max() > 1.0
    assert squeeze(trace) < 0.1
    assert np.linalg.norm(trace.loop_offset[-1, :3]) == pytest.approx(5e-3, rel=0.05)


def test_plants_agree_on_where_the_box_really_is() -> None:
    ends = [carried(plant, GRASP).position[-1] for plant in PLANTS]
    np.testing.assert_allclose(ends[1], ends[2], atol=1e-5)
    np.testing.assert_allclose(ends[0], ends[1], atol=1e-3)
    off = np.linalg.norm(ends[1] - np.array(NEAR))
    assert 2e-4 < off < 4e-3, "which is not where the controller believes it is"
    assert carried("rigid_body", GRASP).task_error[-1, 0] == pytest.approx(off)


def test_perfect_joints_show_how_far_the_hands_are_apart() -> None:
    """Nothing holds them together, so that the error's change along the way is a loop offset."""
    trace = carried("kinematic", GRASP)
    assert trace.loop_position[0] < 1e-9
    assert 1e-5 < trace.loop_position[-1] < 2e-3


def test_the_loop_offset_is_in_the_verdict() -> None:
    comparison = coopqp.compare(coopqp.load("calibration_error"), controllers=["qp"])
    metrics, said = comparison.metrics["qp"], comparison.verdicts["qp"]
    assert metrics["reached"]
    assert metrics["internal_force"]["end"] < 0.1
    assert "the hands are 3.3 mm and 17 mrad from where the model has them." in said
    worse = Disturbance(encoder_offset=0.01, grasp_offset=5e-3)
    scenario = replace(comparison.scenario, plant=Kinematic(), disturbance=worse)
    said = coopqp.compare(scenario, controllers=["qp"]).verdicts["qp"]
    assert "from where the model has them: calibrate" in said


# Scenario files

BAD = {
    "link_length: -0.001": "greater than or equal to 0",
    "grasp_offset: 2": "less than or equal to 0.02",
    "encoder_offset: 5": "less than or equal to 0.1",
    "slip: {at: 1}": "by: is missing",
    "slip: {at: 1, by: 0}": "greater than 0",
    "link: 0.001": "unknown key 'link'",
}


@pytest.mark.parametrize("text", BAD)
def test_senseless_errors_are_refused_with_their_line(tmp_path: Path, text: str) -> None:
    with pytest.raises(ScenarioError, match=BAD[text]) as caught:
        load(tmp_path, f"disturbance: {{{text}}}\n")
    assert len(caught.value.faults) == 1


def test_perfect_joints_take_errors_of_the_model_and_nothing_with_mass(tmp_path: Path) -> None:
    load(tmp_path, "disturbance: {grasp_offset: 0.002, slip: {at: 1.0, by: 0.005}}\n")
    words = "disturbance.delay: has no effect on this plant; use one with masses"
    with pytest.raises(ScenarioError, match=words):
        load(tmp_path, "disturbance: {grasp_offset: 0.002, delay: 1}\n")


def test_springs_take_noise_delay_mass_and_pushes_too(tmp_path: Path) -> None:
    taken = "noise_position: 0.01, delay: 2, object_mass: 1.5, push: {PUSH}"
    taken = taken.replace("PUSH", "force: [1.0, 0.0, 0.0], start: 0.0, duration: 0.1")
    loaded = load(tmp_path, f"plant: quasi_static\ndisturbance: {{{taken}}}\n")
    trace = coopqp.run(replace(loaded, duration=0.2), controller="qp")
    assert 8e-3 < (trace.measured - trace.q[: len(trace.measured)]).std() < 12e-3
    with pytest.raises(ScenarioError, match=r"disturbance.object_com: has no effect on this plant"):
        load(tmp_path, "plant: quasi_static\ndisturbance: {object_com: [0.0, 0.0, 0.01]}\n")


def load(folder: Path, more: str) -> coopqp.Scenario:
    path = folder / "s.yaml"
    text = coopqp.load("point_on_point").source
    path.write_text(text + more, encoding="utf-8")
    return coopqp.load(path)
