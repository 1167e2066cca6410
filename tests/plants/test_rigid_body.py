"""The rigid-body plant: energy, closed loops, rest, torque limits, and whole runs on it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pinocchio as pin
import pytest
from chains import BOX, closed_states, heavy, planar_pair, ring, with_mass

import coopqp
from coopqp.base.errors import InvalidValueError
from coopqp.closed_loop.dynamics import Friction
from coopqp.controller import Command, ControlProblem
from coopqp.grasps import Rigid
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.profile import Profile
from coopqp.model.state import State
from coopqp.plant import Disturbance, PlantModel
from coopqp.plants import RigidBody
from coopqp.plants._dynamic import Servo
from coopqp.robot import RobotModel
from coopqp.solvers import Daqp

DT = 0.01  # control period [s]
FINE = RigidBody(time_step=2e-4)
"""At which even the stiffest servos of these tests are integrated stably."""


def build(chain: ClosedChain, plant: RigidBody | None = None) -> tuple[PlantModel, State, Command]:
    """A plant at rest, a state for it to write and a command to stand still."""
    problem = ControlProblem(chain=chain, tasks=(), solver=Daqp(), dt=DT)
    model = (plant or RigidBody()).build(problem, 0, Disturbance())
    return model, State(chain), Command(chain.n)


def limp(chain: ClosedChain) -> ClosedChain:
    """The same chain without motors."""
    model = chain.robot.model.copy()
    model.effortLimit = np.zeros(model.nv)
    robot = replace(chain.robot, model=model)
    active = np.setdiff1d(np.arange(chain.n), chain.passive)
    return ClosedChain.attach(robot, chain.q_start[active], chain.grasps, chain.held)


@pytest.fixture(scope="module")
def box_chain(nao: RobotModel, chain: ClosedChain) -> ClosedChain:
    """NAO in a pose without symmetry holds a box whose weight is not in its middle."""
    q = closed_states(chain, 6)[-1][0]
    return ClosedChain.attach(nao, q, Rigid(), BOX)


class Ledger:
    """Energy and loop gap by pinocchio, from q and v alone."""

    def __init__(self, chain: ClosedChain) -> None:
        self.model = with_mass(chain, {len(chain.arms) - 1: 1.0})
        self.data, self.frames = self.model.createData(), chain.frames
        self.energies: list[tuple[float, float]] = []
        self.gap, self.opening = 0.0, 0.0

    def note(self, state: State) -> None:
        model, data = self.model, self.data
        kinetic = pin.computeKineticEnergy(model, data, state.q, state.v)
        self.energies.append((kinetic, pin.computePotentialEnergy(model, data, state.q)))
        pin.forwardKinematics(model, data, state.q, state.v)
        pin.updateFramePlacements(model, data)
        world = pin.LOCAL_WORLD_ALIGNED
        first = data.oMf[self.frames[0]]
        speed = pin.getFrameVelocity(model, data, self.frames[0], world).vector.copy()
        for frame in self.frames[1:]:
            other = pin.getFrameVelocity(model, data, frame, world).vector
            gap = pin.log6(first.actInv(data.oMf[frame])).vector
            self.gap = max(self.gap, float(np.abs(gap).max()))
            self.opening = max(self.opening, float(np.abs(other - speed).max()))


FREE: dict[str, Callable[[pytest.FixtureRequest], ClosedChain]] = {
    "firm": lambda request: request.getfixturevalue("chain"),
    "hinged": lambda request: request.getfixturevalue("hinged_box"),
    "three arms": lambda _: ring(3, 6),
}
#: The default, and twice as much, where 16 times the error of a step is still little enough.
FREE_STEP = {"firm": 0.002, "hinged": 0.001, "three arms": 0.002}


@pytest.mark.few(1)
@pytest.mark.parametrize("name", FREE)
def test_free_chain_keeps_its_energy_and_its_loops_for_two_seconds(
    request: pytest.FixtureRequest, name: str
) -> None:
    """Gravity and no torque: less than 1/5000 of the exchanged energy is lost or won."""
    chain = limp(FREE[name](request))
    plant, state, still = build(chain, RigidBody(time_step=FREE_STEP[name], end_stops=False))
    ledger = Ledger(chain)
    ledger.note(plant.truth(state))
    for _ in range(200):
        plant.step(state, still)
        ledger.note(plant.truth(state))
        np.testing.assert_allclose(plant.signals["energy"], ledger.energies[-1], atol=1e-9)
        assert not plant.signals["tau"].any()
    kinetic, potential = np.array(ledger.energies).T
    exchanged = np.ptp(potential)
    assert exchanged > 0.1
    assert np.ptp(kinetic + potential) < 2e-4 * exchanged
    assert ledger.gap < 1e-9
    fastest = float(np.abs(plant.truth(state).v).max())
    assert ledger.opening < 1e-9 * max(1.0, fastest)
    assert state.t == pytest.approx(2.0)


def test_friction_only_takes_energy(box_chain: ClosedChain) -> None:
    friction = Friction(viscous=0.01, coulomb=0.02)
    plant, state, still = build(limp(box_chain), RigidBody(friction=friction, end_stops=False))
    totals = []
    for _ in range(200):
        plant.step(state, still)
        totals.append(plant.signals["energy"].sum())
    assert all(later <= sooner + 1e-9 for sooner, later in pairwise(totals))
    assert totals[0] - totals[-1] > 0.05


def test_smaller_steps_come_closer_with_the_fourth_power(box_chain: ClosedChain) -> None:
    """Half a second of free fall; the projection on the loops does not spoil the order."""
    ends = []
    for time_step in (0.01, 0.005, 0.0025, 0.00125):
        plant, state, still = build(
            limp(box_chain), RigidBody(time_step=time_step, end_stops=False)
        )
        for _ in range(30):
            plant.step(state, still)
        ends.append(plant.truth(state).q.copy())
    gaps = [np.linalg.norm(q - ends[-1]) for q in ends[:-1]]
    assert gaps[0] / gaps[1] > 8
    assert gaps[1] / gaps[2] > 8


def test_motion_is_the_same_in_every_run(box_chain: ClosedChain) -> None:
    ends = []
    for _ in range(2):
        plant, state, command = build(box_chain)
        command.v[:] = 0.5
        for _ in range(20):
            plant.step(state, command)
        true = plant.truth(state)
        ends.append(np.concatenate([true.q, true.v]))
    np.testing.assert_array_equal(*ends)


def heavy_planar_pair() -> ClosedChain:
    """A planar pair with links that weigh something and motors without a limit."""
    return heavy(planar_pair())


RESTING: dict[str, Callable[[pytest.FixtureRequest], ClosedChain]] = {
    "start": lambda request: request.getfixturevalue("chain"),
    "box": lambda request: request.getfixturevalue("box_chain"),
    "hinged": lambda request: request.getfixturevalue("hinged_box"),
    "planar": lambda _: heavy_planar_pair(),
    "three arms": lambda _: ring(3, 7),
}


@pytest.mark.few(2)
@pytest.mark.parametrize("name", RESTING)
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_nothing_moves_at_rest_with_gravity_compensation(
    request: pytest.FixtureRequest, name: str
) -> None:
    chain = RESTING[name](request)
    plant, state, still = build(chain)
    for _ in range(100):
        plant.step(state, still)
    true = plant.truth(state)
    np.testing.assert_allclose(true.q, chain.q_start, atol=1e-9)
    np.testing.assert_allclose(true.v, 0, atol=1e-8)
    assert plant.signals["energy"][0] < 1e-15
    assert not plant.signals["saturated"].any()


def test_servos_without_compensation_sag_and_hold(box_chain: ClosedChain) -> None:
    """At rest the springs carry the weight: N' K (q_d - q) = N' gravity."""
    plant, state, still = build(box_chain, replace(FINE, servo=Servo(gravity_compensation=False)))
    for _ in range(100):
        plant.step(state, still)
    true = plant.truth(state)
    assert np.abs(true.v).max() < 1e-3
    sag = np.abs(true.q - box_chain.q_start).max()
    assert 1e-3 < sag < 0.1
    model = with_mass(box_chain, {0: 1.0})
    gravity = pin.computeGeneralizedGravity(model, model.createData(), true.q)
    rows = np.linalg.svd(box_chain.loop_jacobian(true.q))[2][6:]
    np.testing.assert_allclose(rows @ plant.signals["tau"], rows @ gravity, atol=1e-3)


def test_torque_never_goes_beyond_the_limits(
    box_chain: ClosedChain, rng: np.random.Generator
) -> None:
    """Wild commands: motors at their limits, loops closed all the same, and it is told."""
    plant, state, command = build(box_chain)
    ledger, limit = Ledger(box_chain), box_chain.model.effortLimit
    full, shares = 0.0, np.zeros(10)
    for _ in range(100):
        command.v[:] = rng.uniform(-8, 8, 10)
        plant.step(state, command)
        ledger.note(plant.truth(state))
        tau = np.abs(plant.signals["tau"])
        assert np.all(tau <= limit)
        full = max(full, float((tau / limit).max()))
        saturated = plant.signals["saturated"]
        assert np.all((saturated >= 0) & (saturated <= 1))
        shares += saturated
    assert full == 1.0
    assert shares.max() > 1
    assert ledger.gap < 1e-9


def test_hinges_have_no_motor_and_are_never_at_a_limit(hinged_box: ClosedChain) -> None:
    plant, state, command = build(hinged_box)
    command.v[:] = 1.0
    for _ in range(30):
        plant.step(state, command)
        np.testing.assert_array_equal(plant.signals["tau"][hinged_box.passive], 0)
        np.testing.assert_array_equal(plant.signals["saturated"][hinged_box.passive], 0)


def test_joints_follow_a_slow_motion_along_the_loops(box_chain: ClosedChain) -> None:
    """A commanded self-motion of the closed loops is carried out."""
    plant, state, command = build(box_chain, FINE)
    target = box_chain.q_start.copy()
    for _ in range(50):
        _, _, rows = np.linalg.svd(box_chain.loop_jacobian(target))
        direction = rows[6:].T @ rows[6:] @ np.linspace(-1, 1, 10)
        command.v[:] = 0.2 * direction / np.linalg.norm(direction)
        plant.step(state, command)
        target += DT * command.v
    assert np.linalg.norm(target - box_chain.q_start) > 0.08
    np.testing.assert_allclose(plant.truth(state).q, target, atol=0.01)


def test_wrench_at_the_cut_holds_the_box_at_rest(box_chain: ClosedChain) -> None:
    """Each hand's wrench is its share of the weight plus what cancels between the hands."""
    plant, state, still = build(box_chain, FINE)
    for _ in range(10):
        plant.step(state, still)
    internal = plant.signals["internal_wrench"].reshape(2, 6)
    np.testing.assert_allclose(internal.sum(axis=0), 0, atol=1e-9)
    bare, data = box_chain.model, box_chain.model.createData()
    q = plant.truth(state).q
    pin.computeJointJacobians(bare, data, q)
    pin.updateFramePlacements(bare, data)
    X = data.oMf[box_chain.frames[0]]
    weight = np.array([0.0, 0.0, BOX.mass * 9.81])
    needed = np.concatenate([weight, np.cross(X.rotation @ np.array(BOX.com), weight)])
    held = pin.computeGeneralizedGravity(bare, data, q)
    for frame, wrench in zip(box_chain.frames, internal + 0.5 * needed, strict=True):
        J = pin.getFrameJacobian(bare, data, frame, pin.LOCAL_WORLD_ALIGNED)
        held = held + J.T @ wrench
    np.testing.assert_allclose(plant.signals["tau"], held, atol=1e-6)


@pytest.mark.parametrize("time_step", [0.003, 0.007, 0.02, 0.01001])
def test_time_step_that_does_not_divide_the_period(chain: ClosedChain, time_step: float) -> None:
    with pytest.raises(InvalidValueError, match=rf"{time_step} s.*dt = 0\.01 s") as caught:
        build(chain, RigidBody(time_step=time_step))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("time_step", [0.01, 0.005, 0.001, 0.0001])
def test_time_step_that_divides_the_period(chain: ClosedChain, time_step: float) -> None:
    plant, state, still = build(chain, RigidBody(time_step=time_step))
    plant.step(state, still)
    assert state.t == pytest.approx(DT, rel=1e-12)


@pytest.mark.full
def test_run_does_not_depend_on_the_time_step() -> None:
    """A pose where the arms are nearly stretched: the same box at the same place.

    Half the step leaves a sixteenth of the error, so that the difference is the error of the other.
    """
    scenario = coopqp.load("near_singular")
    hurried = tuple(replace(task, profile=Profile(duration=1.0)) for task in scenario.tasks)
    scenario = replace(scenario, tasks=hurried, duration=1.5)
    ends = []
    for time_step in (0.001, 0.0005):
        trace = coopqp.run(replace(scenario, plant=RigidBody(time_step=time_step)), controller="qp")
        ends.append(np.concatenate([trace.position[-1], 1e-3 * trace.signals["tau"][-1]]))
    np.testing.assert_allclose(*ends, atol=1e-4)
