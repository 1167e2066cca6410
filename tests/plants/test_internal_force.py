"""The servos' feed-forward carries without squeezing, and both plants tell what squeezes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from numpy.typing import NDArray
from scenario_files import needs_robots

import coopqp
from coopqp.controller import Command, ControlProblem
from coopqp.execution.controller_run import run
from coopqp.grasps import Revolute, Rigid
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.grasp_configuration import HeldObject
from coopqp.model.state import State
from coopqp.plant import Disturbance, Plant, PlantModel
from coopqp.plants import Mujoco, RigidBody
from coopqp.plants._dynamic import Servo, ServoLaw
from coopqp.robot import RobotModel
from coopqp.solvers import Daqp

Array = NDArray[np.float64]

DT = 0.01  # s
BOX = HeldObject(size=(0.08, 0.19, 0.08), mass=0.2)
SAGGING = Servo(gravity_compensation=False)
#: Welds so stiff that the hands hold as firmly as on rigid bodies.
PLANTS: Mapping[str, Plant] = {
    "rigid_body": RigidBody(servo=SAGGING),
    "mujoco": Mujoco(servo=SAGGING, time_step=2.5e-4, stiffness_time=5e-4),
}


@pytest.fixture(scope="module")
def box(nao: RobotModel, chain: ClosedChain) -> ClosedChain:
    return ClosedChain.attach(nao, chain.q_start, Rigid(), BOX)


@pytest.fixture(scope="module")
def hinged(nao: RobotModel, chain: ClosedChain) -> ClosedChain:
    return ClosedChain.attach(nao, chain.q_start, Revolute(point=(0.0, 0.0, -0.05)), BOX)


def at_rest(plant: Plant, chain: ClosedChain, ticks: int = 150) -> tuple[PlantModel, Array]:
    """A plant that has come to rest, and what each hand does to the box that cancels, (N, 6)."""
    if isinstance(plant, Mujoco):
        pytest.importorskip("mujoco")
    problem = ControlProblem(chain=chain, tasks=(), solver=Daqp(), dt=DT)
    model, state = plant.build(problem, 0, Disturbance()), State(chain)
    for _ in range(ticks):
        model.step(state, Command(chain.n))
    assert model.signals["energy"][0] < 1e-12
    return model, model.signals["internal_wrench"].reshape(-1, 6).copy()


def test_both_plants_tell_the_same_internal_wrench(box: ClosedChain) -> None:
    """Arms that sag squeeze: the servos' springs pull the box apart."""
    ours, theirs = (at_rest(plant, box)[1] for plant in PLANTS.values())
    assert np.linalg.norm(ours[0, :3]) > 1.0
    np.testing.assert_allclose(theirs, ours, atol=0.05 * np.abs(ours).max())
    np.testing.assert_allclose(theirs.sum(axis=0), 0.0, atol=1e-6)


@pytest.mark.parametrize("plant", PLANTS)
def test_the_motors_hold_the_arms_and_what_the_hands_do(plant: str, box: ClosedChain) -> None:
    """Statics by pinocchio: tau = gravity of the arms + J' (share of the weight + internal)."""
    model, internal = at_rest(PLANTS[plant], box)
    state = State(box)
    q = model.truth(state).q
    bare, data = box.model, box.model.createData()
    held = pin.computeGeneralizedGravity(bare, data, q)
    pin.computeJointJacobians(bare, data, q)
    pin.updateFramePlacements(bare, data)
    place = data.oMf[box.frames[0]]
    weight = np.array([0.0, 0.0, 9.81 * BOX.mass])
    needed = np.concatenate([weight, np.cross(place.rotation @ np.array(BOX.com), weight)])
    for frame, wrench in zip(box.frames, internal + 0.5 * needed, strict=True):
        J = pin.getFrameJacobian(bare, data, frame, pin.LOCAL_WORLD_ALIGNED)
        held = held + J.T @ wrench
    np.testing.assert_allclose(model.signals["tau"], held, atol=2e-3)


@pytest.mark.parametrize("plant", [RigidBody(), Mujoco()])
def test_servos_that_carry_their_share_do_not_squeeze(plant: Plant, box: ClosedChain) -> None:
    assert np.abs(at_rest(plant, box)[1]).max() < 1e-3


@needs_robots
def test_two_pandas_hold_a_box_without_squeezing_it() -> None:
    """The torques of least norm would squeeze it with 17 N and saturate a wrist's motor."""
    chain = coopqp.load("two_pandas").chain
    model, internal = at_rest(RigidBody(), chain, 50)
    assert np.abs(internal).max() < 1e-2
    assert (np.abs(model.signals["tau"]) < 0.5 * model.signals["tau"].size * 87.0).all()
    assert not model.signals["saturated"].any()


def test_hinges_carry_nothing_and_what_is_left_is_least(hinged: ClosedChain) -> None:
    """Motor torques in balance with the weight, by the smallest wrench that frees the hinges."""
    servo = ServoLaw(hinged, Servo())
    servo.begin(Command(hinged.n), hinged.q_start)
    tau = servo.torque(hinged.q_start, np.zeros(hinged.n)).copy()
    np.testing.assert_array_equal(tau[hinged.passive], 0.0)
    state = State(hinged)
    weight = weight_of_halves(hinged)
    missing = weight - tau
    J = state.J_loop
    wrench = np.linalg.lstsq(J.T, missing, rcond=None)[0]
    np.testing.assert_allclose(J.T @ wrench, missing, atol=1e-9)
    least = np.linalg.pinv(J[:, hinged.passive].T) @ weight[hinged.passive]
    np.testing.assert_allclose(wrench, least, atol=1e-9)


def weight_of_halves(chain: ClosedChain) -> Array:
    """Torques that hold the arms, each with half of the box, by pinocchio."""
    model = chain.model.copy()
    for frame in chain.frames:
        half = pin.Inertia(
            0.5 * BOX.mass, np.array(BOX.com), 0.5 * np.array(chain.held.body().inertia)
        )
        placed = chain.model.frames[frame]
        model.appendBodyToJoint(placed.parentJoint, half, placed.placement)
    return np.asarray(
        pin.computeGeneralizedGravity(model, model.createData(), chain.q_start), float
    )


@pytest.mark.parametrize("plant", [RigidBody(), Mujoco()])
def test_a_box_between_hinges_stays_where_it_is(plant: Plant, hinged: ClosedChain) -> None:
    if isinstance(plant, Mujoco):
        pytest.importorskip("mujoco")
    problem = ControlProblem(chain=hinged, tasks=(), solver=Daqp(), dt=DT)
    model, state = plant.build(problem, 0, Disturbance()), State(hinged)
    start = model.truth(state).p_WO.copy()
    for _ in range(50):
        model.step(state, Command(hinged.n))
    np.testing.assert_allclose(model.truth(state).p_WO, start, atol=1e-4)
    assert np.abs(model.signals["internal_wrench"]).max() < 0.1


@needs_robots
@pytest.mark.parametrize("plant", [RigidBody(), Mujoco()], ids=["rigid_body", "mujoco"])
def test_servos_do_not_fight_at_joints_that_the_loops_hold_fast(plant: Plant) -> None:
    """Two SO-101 cannot turn their bar about the vertical: their pans are held by the loops.

    Such a joint seems infinitely heavy. Damped like that, under MuJoCo its motor was saturated in
    every tick and the hands turned against each other with 1 N m.
    """
    if isinstance(plant, Mujoco):
        pytest.importorskip("mujoco")
    shipped = coopqp.load("two_so101")
    of_joints = shipped.limits[:2]  # the others read meshes, which takes seconds
    trace = run(replace(shipped, plant=plant, limits=of_joints, duration=1.0), controller="qp")
    moments = trace.signals["internal_wrench"].reshape(-1, 2, 6)[:, :, 3:]
    pans = [trace.joints.index(f"{side}/shoulder_pan") for side in ("left", "right")]
    assert not trace.signals["saturated"].any()
    assert np.abs(trace.signals["tau"][:, pans]).max() < 0.01
    assert np.abs(moments).max() < 0.05
