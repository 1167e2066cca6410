"""Faults of sensors and motors: by closed forms on joints that follow exactly and on bodies."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from online_loops import follows, simulated

import coopqp
from coopqp.base.errors import CoopqpError, InvalidValueError
from coopqp.base.spec import Array
from coopqp.controller import Command
from coopqp.controllers import TorqueQp
from coopqp.execution.controller_run import begin_phase
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.state import State
from coopqp.plant import FAULTS, Disturbance, Fault, Plant
from coopqp.plants import Kinematic, Mujoco, RigidBody
from coopqp.scenario.faulty_plant import FaultyPlant, Injected
from coopqp.scenario.scenario import Scenario
from coopqp.solver import Status

PLANTS: dict[str, Plant] = {
    "kinematic": Kinematic(),
    "rigid_body": RigidBody(time_step=0.002),
    "mujoco": Mujoco(),
}
each_plant = pytest.mark.parametrize("plant", PLANTS)
#: Ticks; the fault begins at BEGIN and lasts until END.
TICKS, BEGIN, END = 30, 10, 20
JOINT, OTHER = 1, 6


def given(plant: str, **fault: Any) -> Scenario:
    """A box in NAO's hands, with one fault."""
    if plant == "mujoco":
        pytest.importorskip("mujoco")
    faults = (Fault(**fault),) if fault else ()
    disturbance = Disturbance(faults=faults)
    scenario = coopqp.load("point_on_point")
    return replace(scenario, plant=PLANTS[plant], disturbance=disturbance)


def names(*joints: int) -> Any:
    found = tuple(given("kinematic").chain.joint_names[j] for j in joints)
    return found if len(found) > 1 else found[0]


def timed(scenario: Scenario) -> dict[str, float]:
    return {"start": BEGIN * scenario.dt, "duration": (END - BEGIN) * scenario.dt}


class Moved:
    """What a plant said and did while all joints were told to swing slowly.

    Attributes:
        told, read, done: commanded, measured and true joints after each tick, shape (TICKS, n).
        felt: the hands' wrenches, by the sensors; asked: commanded speeds.
    """

    def __init__(self, scenario: Scenario) -> None:
        plant = scenario.simulated(scenario.problem())
        state, n = State(scenario.chain, plant.measured), scenario.chain.n
        self.asked = 0.02 * np.sin(0.3 * np.arange(TICKS))[:, None] * np.arange(1, n + 1) / n
        self.told, self.read, self.done, self.v = np.zeros((4, TICKS, n))
        self.felt, self.true = np.zeros((2, TICKS, 6 * len(scenario.chain.arms)))
        self.begin = plant.measured
        command = Command(n)
        for k in range(TICKS):
            command.v[:] = self.asked[k]
            plant.step(state, command)
            assert np.array_equal(command.v, self.asked[k])
            true = plant.truth(state)
            self.told[k], self.done[k] = state.q, true.q
            self.read[k] = state.q if state.q_measured is None else state.q_measured
            if plant.hand_wrench is not None:
                self.felt[k], self.true[k] = plant.hand_wrench, plant.signals["hand_wrench"]


def acting(k: int) -> bool:
    """Whether the fault is in the reading after tick k."""
    return BEGIN <= k + 1 < END


@pytest.mark.each_value
@each_plant
@pytest.mark.parametrize("kind", [k for k in FAULTS if k.startswith(("encoder", "readings"))])
def test_readings_are_as_the_fault_says_while_it_lasts(plant: str, kind: str) -> None:
    keys = {"joint": names(JOINT), "joints": names(JOINT, OTHER), "by": 0.05}
    sound = Moved(given(plant))
    fault = {key: keys[key] for key in FAULTS[kind]}
    moved = Moved(given(plant, kind=kind, **fault, **timed(given(plant))))
    np.testing.assert_array_equal(moved.told, sound.told)
    np.testing.assert_array_equal(moved.done, sound.done)  # sensors move nothing here
    for k in range(TICKS):
        wanted, at_begin = sound.read[k].copy(), sound.read[BEGIN - 1]
        q = wanted[JOINT]
        if acting(k):
            match kind:
                case "encoder_reversed":
                    wanted[JOINT] = at_begin[JOINT] - (q - at_begin[JOINT])
                case "encoder_stuck":
                    wanted[JOINT] = at_begin[JOINT]
                case "encoder_offset_jump":
                    wanted[JOINT] = q + 0.05
                case "encoders_swapped":
                    wanted[JOINT], wanted[OTHER] = wanted[OTHER], q
                case "encoders_in_degrees":
                    wanted = wanted * 180.0 / np.pi
                case _:
                    wanted[:] = np.nan
        np.testing.assert_allclose(moved.read[k], wanted, rtol=1e-12, atol=1e-15)


@pytest.mark.parametrize("kind", ["motor_reversed", "motor_stuck", "motors_swapped"])
def test_motors_do_what_the_fault_says_while_it_lasts(kind: str) -> None:
    key = {"joints": names(JOINT, OTHER)} if kind == "motors_swapped" else {"joint": names(JOINT)}
    scenario = given("kinematic", kind=kind, **key, **timed(given("kinematic")))
    moved = Moved(scenario)
    speeds = moved.asked.copy()
    window = slice(BEGIN, END)
    if kind == "motor_reversed":
        speeds[window, JOINT] *= -1.0
    elif kind == "motor_stuck":
        speeds[window, JOINT] = 0.0
    else:
        speeds[window, [JOINT, OTHER]] = speeds[window, [OTHER, JOINT]]
    start = scenario.chain.q_start
    done = start + scenario.dt * np.cumsum(speeds, axis=0)
    np.testing.assert_allclose(moved.done, done, atol=1e-12)
    np.testing.assert_allclose(moved.read, done, atol=1e-12)
    told = start + scenario.dt * np.cumsum(moved.asked, axis=0)
    np.testing.assert_allclose(moved.told, told, atol=1e-12)


@pytest.mark.few(3)
@pytest.mark.parametrize("plant", ["rigid_body", "mujoco"])
@pytest.mark.parametrize("kind", ["motor_reversed", "motor_stuck", "motors_swapped"])
def test_bodies_move_as_if_the_faulty_command_had_been_given(plant: str, kind: str) -> None:
    key = {"joints": names(JOINT, OTHER)} if kind == "motors_swapped" else {"joint": names(JOINT)}
    faulty = given(plant, kind=kind, **key)
    moved = Moved(faulty)
    sound = given(plant)
    model, state = sound.simulated(sound.problem()), State(sound.chain)
    command = Command(sound.chain.n)
    for k in range(TICKS):
        v = moved.asked[k].copy()
        if kind == "motors_swapped":
            v[[JOINT, OTHER]] = v[[OTHER, JOINT]]
        else:
            v[JOINT] *= -1.0 if kind == "motor_reversed" else 0.0
        command.v[:] = v
        model.step(state, command)
        np.testing.assert_array_equal(moved.done[k], model.truth(state).q)
    pulled, at_rest = (np.abs(x.signals["internal_wrench"]).max() for x in (model, rested(sound)))
    assert pulled > 2.0 * at_rest  # the hands pull at the object


def rested(scenario: Scenario) -> Any:
    """The plant after as many ticks at rest."""
    model, state = scenario.simulated(scenario.problem()), State(scenario.chain)
    for _ in range(TICKS):
        model.step(state, Command(scenario.chain.n))
    return model


@pytest.mark.parametrize("plant", ["rigid_body", "mujoco"])
@pytest.mark.parametrize("kind", [k for k in FAULTS if k.startswith("force")])
def test_forces_are_felt_as_the_fault_says_while_it_lasts(plant: str, kind: str) -> None:
    scenario = given(plant)
    arms = [arm.name for arm in scenario.chain.robot.arms]
    by = {"by": 0.5} if kind == "force_scaled" else {}
    moved = Moved(given(plant, kind=kind, arm=arms[1], **by, **timed(scenario)))
    sound = Moved(scenario)
    np.testing.assert_array_equal(moved.true, sound.felt)  # what is recorded is true
    assert np.abs(sound.felt[:, 6:]).max(axis=1).min() > 0.1
    factors = {"force_dead": 0.0, "force_reversed": -1.0, "force_scaled": 0.5, "force_stuck": 0.0}
    for k in range(TICKS):
        wanted = sound.felt[k].copy()
        if acting(k):
            wanted[6:] *= factors[kind]
            if kind == "force_stuck":
                wanted[6:] = sound.felt[BEGIN - 1, 6:]
        np.testing.assert_array_equal(moved.felt[k], wanted)


def test_several_faults_act_one_after_the_other() -> None:
    scenario = given("kinematic")
    jump = Fault(kind="encoder_offset_jump", joint=names(JOINT), by=0.1)
    degrees = Fault(kind="encoders_in_degrees")
    start = scenario.chain.q_start
    for faults, wanted in (
        ((jump, degrees), np.rad2deg(start[JOINT] + 0.1)),
        ((degrees, jump), np.rad2deg(start[JOINT]) + 0.1),
    ):
        faulty = replace(scenario, disturbance=Disturbance(faults=faults))
        measured = faulty.simulated(faulty.problem()).measured
        assert measured is not None
        assert measured[JOINT] == pytest.approx(wanted, rel=1e-12)


@pytest.mark.parametrize(("kind", "sign"), [("motor_reversed", -1.0), ("motor_stuck", 0.0)])
def test_torques_of_a_faulty_motor(kind: str, sign: float) -> None:
    scenario = given("rigid_body", kind=kind, joint=names(JOINT), start=0.05)
    model = scenario.simulated(scenario.problem())
    state, command = State(scenario.chain, model.measured), Command(scenario.chain.n, torques=True)
    assert command.tau is not None
    for k in range(10):
        command.tau[:] = 0.1 + 0.01 * k
        model.step(state, command)
        wanted = command.tau.copy()
        if k >= 5:  # one that is stuck gives the torque of the tick in which it began
            wanted[JOINT] = sign * wanted[JOINT] if sign else 0.15
        np.testing.assert_allclose(model.signals["tau"], wanted, atol=1e-12)
        assert state.q_measured is None


def test_torque_controllers_read_the_speed_of_a_reversed_encoder() -> None:
    def speed(**fault: Any) -> tuple[Array, Array]:
        scenario = given("rigid_body", **fault)
        model = scenario.simulated(scenario.problem())
        state = State(scenario.chain, model.measured)
        command = Command(scenario.chain.n, torques=True)
        assert command.tau is not None
        command.tau[JOINT] = 1.0
        for _ in range(5):
            model.step(state, command)
        return state.q, state.v

    (q, v), (q_sound, v_sound) = speed(kind="encoder_reversed", joint=names(JOINT)), speed()
    start = given("rigid_body").chain.q_start[JOINT]
    assert abs(v_sound[JOINT]) > 1e-3
    assert v[JOINT] == -v_sound[JOINT]
    assert q[JOINT] == pytest.approx(2.0 * start - q_sound[JOINT], abs=1e-12)
    others = np.arange(len(q)) != JOINT
    np.testing.assert_array_equal(q[others], q_sound[others])
    np.testing.assert_array_equal(v[others], v_sound[others])


# Whole runs


@each_plant
def test_a_run_with_lost_readings_goes_on_and_says_so(plant: str) -> None:
    scenario = replace(given(plant, kind="readings_lost", start=0.1), duration=0.2)
    trace = coopqp.run(scenario, controller="qp")
    assert Counter(trace.status)["NOT_MEASURED"] == 10
    assert np.isnan(trace.measured[10:]).all()
    assert np.isfinite(trace.measured[:10]).all()
    assert np.isfinite(trace.q).all()


def test_a_torque_controller_whose_readings_are_lost_keeps_the_last() -> None:
    scenario = replace(
        given("rigid_body", kind="readings_lost", start=0.05), duration=0.1, dt=0.002,
        controllers={"torque_qp": TorqueQp()}, kappa=50.0,
    )  # fmt: skip
    trace = coopqp.run(scenario, controller="torque_qp")
    np.testing.assert_array_equal(trace.measured[25:], np.tile(trace.measured[24], (25, 1)))
    assert len(np.unique(trace.measured[:25, JOINT])) > 20
    assert np.isfinite(trace.q).all()


@pytest.mark.parametrize("kind", ["encoder_stuck", "motor_reversed"])
def test_faults_go_on_from_phase_to_phase(kind: str) -> None:
    scenario = coopqp.load("regrasp")
    first = scenario.schedule[0].ticks(scenario.dt)
    joint = scenario.chain.joint_names[JOINT]
    fault = Fault(kind=kind, joint=joint, start=(first - 5) * scenario.dt)
    scenario = replace(
        scenario, plant=Kinematic(), disturbance=Disturbance(faults=(fault,)),
        phases=scenario.phases[:2],
    )  # fmt: skip
    controller = scenario.controllers["qp"]
    before = None
    for _ in range(2):
        run = begin_phase(scenario, controller, before)
        assert isinstance(run.plant, FaultyPlant)
        for k in range(first if before is None else 10):
            command = Command(scenario.chain.n)
            command.v[JOINT] = 0.01
            at = run.plant.truth(run.state).q[JOINT]
            run.plant.step(run.state, command)
            done = run.plant.truth(run.state).q[JOINT] - at
            fails = before is not None or k >= first - 5
            backwards = kind == "motor_reversed" and fails
            assert done == pytest.approx(0.01 * scenario.dt * (-1.0 if backwards else 1.0))
        run.ticks, before = first, run
    assert before is not None
    if kind == "encoder_stuck":
        read = scenario.chain.q_start[JOINT] + 0.01 * scenario.dt * (first - 5)
        assert before.q[JOINT] == pytest.approx(read, abs=1e-12)


def test_the_loop_for_robots_is_told_what_the_faulty_sensor_says() -> None:
    scenario = follows("kinematic")
    fault = Fault(kind="readings_lost", start=0.1, duration=0.05)
    faulty = replace(scenario, disturbance=Disturbance(faults=(fault,)))
    loop, robot = simulated(faulty, reference="commanded")
    statuses = []
    for _ in range(20):
        command = loop.tick(robot.read())
        statuses.append(command.status)
        robot.write(loop.setpoint, command.v)
    assert [s is Status.NOT_MEASURED for s in statuses] == [10 <= k < 15 for k in range(20)]


def test_equal_seeds_give_equal_runs_and_no_fault_no_wrapper() -> None:
    scenario = replace(
        given("rigid_body", kind="encoder_reversed", joint=names(JOINT)), duration=0.1
    )
    noisy = replace(scenario.disturbance, noise_position=1e-3)
    scenario = replace(scenario, disturbance=noisy)
    first, second = (coopqp.run(scenario, controller="qp") for _ in range(2))
    np.testing.assert_array_equal(first.q, second.q)
    np.testing.assert_array_equal(first.measured, second.measured)
    sound = given("rigid_body")
    assert type(sound.simulated(sound.problem())).__name__ == "RigidBodyModel"


def test_a_comparison_names_the_faults_that_were_injected() -> None:
    scenario = replace(given("kinematic", kind="motor_stuck", joint=names(JOINT)), duration=0.05)
    said = coopqp.compare(scenario, controllers=["qp"])
    assert said.notes[-1] == f"injected: motor_stuck of {names(JOINT)} from 0 s"


# At the border


@pytest.mark.parametrize(
    ("fault", "words"),
    [
        ({"kind": "encoder_reversd"}, "unknown fault 'encoder_reversd'; did you mean 'encoder_r"),
        ({"kind": "motor_dead"}, r"unknown fault 'motor_dead'; did you mean 'motor_stuck'\?"),
        ({"kind": "encoder_stuck"}, "encoder_stuck needs joint"),
        ({"kind": "force_dead", "arm": "left", "by": 1.0}, "has no key by; it takes arm"),
        ({"kind": "readings_lost", "joint": "x"}, "no key joint; it takes no key but start and"),
    ],
)
def test_a_fault_that_cannot_be_is_refused(fault: dict[str, Any], words: str) -> None:
    with pytest.raises(InvalidValueError, match=words):
        Fault(**fault)


FILE = """robot: nao_t14
start:
  right: [0.7, -0.2, 1.2, 0.9, 0.1]
  left: [0.7, 0.2, -1.2, -0.9, -0.1]
tasks: [point_on_point: {goal: [0.15, 0.03, 0.035]}]
plant: PLANT
duration: 3.0
disturbance:
  faults:
    - {kind: encoders_in_degrees, start: 1.0}
    - FAULT
"""


def test_a_passive_joint_has_a_reading_and_no_motor(hinged: ClosedChain) -> None:
    name = hinged.joint_names[hinged.passive[0]]
    assert Injected(0, Fault(kind="encoder_stuck", joint=name), hinged).at == hinged.passive[0]
    with pytest.raises(InvalidValueError, match="motor_stuck: a passive joint has no motor"):
        Injected(0, Fault(kind="motor_stuck", joint=name), hinged)


@pytest.mark.parametrize(
    ("plant", "fault", "words"),
    [
        ("kinematic", "{kind: encoder_stuck, joint: LElbowRol}",
         r"\[1\].joint: unknown joint 'LElbowRol'; did you mean 'LElbowRoll'"),
        ("rigid_body", "{kind: force_dead, arm: lefft}", r"\[1\].arm: unknown arm 'lefft'; did"),
        ("kinematic", "{kind: force_dead, arm: left}", "this plant has no force sensors; use"),
        ("kinematic", "{kind: motors_swapped, joints: [LElbowYaw, LElbowYaw]}", "needs two joints"),
    ],
)  # fmt: skip
def test_a_fault_of_what_the_robot_does_not_have_is_refused_with_its_line(
    tmp_path: Path, plant: str, fault: str, words: str
) -> None:
    path = tmp_path / "faulty.yaml"
    path.write_text(FILE.replace("PLANT", plant).replace("FAULT", fault), encoding="utf-8")
    with pytest.raises(CoopqpError, match=rf"faulty.yaml:11: disturbance.faults.*{words}"):
        coopqp.load(path)
