"""Section 5.3: all six degrees of freedom under the PID and the torque QP, on two plants."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import refused_in_one_line
from scenario_files import write

import coopqp
from coopqp.base.errors import InvalidValueError
from coopqp.controllers import PassiveGraspPid, TorqueQp
from coopqp.execution.controller_run import run
from coopqp.plant import Disturbance, Push
from coopqp.plants import Kinematic, Mujoco, RigidBody
from coopqp.scenario.loader import load, shipped
from coopqp.scenario.scenario import Scenario
from coopqp.solver import Status
from coopqp.tasks import InternalWrench, Pose
from coopqp.trace import Trace

PLANTS = {"rigid_body": RigidBody(time_step=0.002), "mujoco": Mujoco(time_step=0.001)}
DISTURBANCES = {
    "undisturbed": Disturbance(),
    "twice as heavy": Disturbance(object_mass=2.0),
    "pushed": Disturbance(push=Push(force=(0.0, 1.0, 0.0), start=0.2, duration=0.2)),
}
TORQUE = ("passive_grasp_pid", "torque_qp")
WAY, SECONDS = 0.7, 0.9  # on the way, and until the end


def hurried(**settings: Any) -> Scenario:
    """The scenario of section 5.3 in less than half of its time."""
    scenario = load("passive_grasp_pose")
    (task,) = scenario.tasks
    assert isinstance(task, Pose)
    profile = replace(task.profile, duration=WAY)
    given = {"tasks": (replace(task, profile=profile),), "duration": SECONDS, **settings}
    return replace(scenario, **given)


@cache
def carried(plant: str, disturbance: str, controller: str) -> Trace:
    scenario = hurried(plant=PLANTS[plant], disturbance=DISTURBANCES[disturbance])
    return run(scenario, controller=controller)


@pytest.mark.each_value
@pytest.mark.parametrize("controller", TORQUE)
@pytest.mark.parametrize("disturbance", DISTURBANCES)
@pytest.mark.parametrize("plant", PLANTS)
def test_the_box_arrives_and_torques_and_loops_hold(
    plant: str, disturbance: str, controller: str
) -> None:
    trace = carried(plant, disturbance, controller)
    position, orientation = trace.task_error[-1]
    assert position <= 1e-3
    assert orientation <= np.radians(0.5)
    assert trace.loop_position.max() <= 5e-4
    assert trace.signals.get("gap", np.zeros(1)).max() <= 5e-4
    motors = trace.effort > 0.0
    assert np.all(np.abs(trace.signals["tau"][:, motors]) <= trace.effort[motors])
    assert not trace.failures
    assert np.all((trace.lower <= trace.q) & (trace.q <= trace.upper))


def test_the_trajectory_is_three_centimetres_and_fifteen_degrees() -> None:
    trace = carried("rigid_body", "undisturbed", "torque_qp")
    way = np.linalg.norm(trace.position[-1] - trace.position[0])
    turn = trace.rotation[-1] @ trace.rotation[0].T
    assert way == pytest.approx(0.03, abs=5e-4)
    assert np.degrees(np.arccos((np.trace(turn) - 1.0) / 2.0)) == pytest.approx(15.0, abs=0.1)


@pytest.mark.few(2)
@pytest.mark.parametrize("disturbance", DISTURBANCES)
@pytest.mark.parametrize("controller", TORQUE)
def test_both_plants_agree_on_the_path_of_the_box(controller: str, disturbance: str) -> None:
    ours, theirs = (carried(plant, disturbance, controller) for plant in PLANTS)
    assert np.linalg.norm(ours.position - theirs.position, axis=1).max() <= 1e-3


def test_the_push_is_felt_and_the_weight_sags_before_they_are_taken_up() -> None:
    calm, pushed, heavy = (
        carried("mujoco", name, "passive_grasp_pid").task_error[:, 0].max() for name in DISTURBANCES
    )  # undisturbed, twice as heavy, pushed
    assert pushed > 10.0 * calm
    assert heavy > 10.0 * calm


@pytest.mark.parametrize("plant", PLANTS)
def test_a_noisy_run_is_the_same_to_the_bit_with_the_same_seed(plant: str) -> None:
    scenario = replace(
        load("passive_grasp_pose"),
        plant=PLANTS[plant],
        duration=0.1,
        disturbance=Disturbance(noise_position=1e-4, noise_velocity=1e-3, delay=1),
    )
    runs = [run(replace(scenario, seed=seed), controller="passive_grasp_pid") for seed in (7, 7, 8)]
    assert np.array_equal(runs[0].q, runs[1].q)
    assert np.array_equal(runs[0].signals["tau"], runs[1].signals["tau"])
    assert not np.array_equal(runs[0].q, runs[2].q)


def test_a_weak_motor_saturates_and_is_recorded() -> None:
    scenario = load("passive_grasp_pose")
    strong = PassiveGraspPid(name="strong")
    pushed = replace(
        scenario,
        controllers={"strong": strong},
        duration=0.5,
        disturbance=Disturbance(push=Push(force=(0, 0, -15.0), start=0.1, duration=0.3)),
    )
    trace = run(pushed, controller="strong")
    assert trace.signals["saturated"].max() > 0.0
    assert "TASKS_RELAXED" in trace.status
    law = strong.build(pushed.problem())
    for v, status in ((50.0, Status.TASKS_RELAXED), (1e300, Status.NOT_FINITE)):
        state = law.start()
        state.v[1] = v
        command = law.tick(state)
        assert command.status is status
        assert command.tau is not None
        assert command.tau.any()
        assert (np.abs(command.tau) <= pushed.chain.model.effortLimit).all()
        assert (pushed.chain.joint_names[1] in command.note) == (v == 50.0)
    motors = trace.effort > 0.0
    assert np.all(np.abs(trace.signals["tau"][:, motors]) <= trace.effort[motors])


def test_the_internal_force_is_what_the_hands_do_against_each_other() -> None:
    trace = carried("rigid_body", "undisturbed", "torque_qp")
    internal = trace.signals["internal_wrench"].reshape(trace.ticks, 2, 6)
    assert np.abs(internal.sum(axis=1)).max() < 1e-9
    assert np.abs(internal).max() > 1e-6


@pytest.mark.few(1)
@pytest.mark.parametrize("plant", PLANTS)
def test_the_pid_squeezes_as_it_is_asked_to_while_it_carries(plant: str) -> None:
    scenario = hurried(plant=PLANTS[plant])
    asked = InternalWrench(squeeze=6.0, twist=0.05)
    trace = run(replace(scenario, tasks=(*scenario.tasks, asked)), controller="passive_grasp_pid")
    alone = carried(plant, "undisturbed", "passive_grasp_pid")
    np.testing.assert_allclose(trace.task_error[-1][:2], alone.task_error[-1][:2], atol=1e-3)
    wrench = trace.task_error[:, 2:]  # N, N m
    assert np.abs(wrench[20:]).max() < 0.05
    with pytest.raises(InvalidValueError, match="velocities exert no forces; use level: torque"):
        PassiveGraspPid(level="kinematic").build(
            replace(scenario, tasks=(*scenario.tasks, asked)).problem()
        )


def test_feed_forward_of_the_reference_helps_tracking() -> None:
    pid = PassiveGraspPid(name="pid", feed_forward="gravity")
    scenario = hurried(controllers={"pid": pid})
    assert run(scenario, controller="pid").task_error[:, 0].max() < 5e-3
    assert PassiveGraspPid().feed_forward == "inverse_dynamics"
    whole = carried("rigid_body", "undisturbed", "passive_grasp_pid")
    assert whole.task_error[:, 0].max() < 1e-5


def test_a_kinematic_pid_reaches_the_pose_by_velocities() -> None:
    trace = run(load("rigid_vs_passive"), controller="passive_grasp_pid")
    assert trace.task_error[-1, 0] < 1e-3
    assert trace.loop_position.max() < 1e-4


def test_firm_hands_cannot_reach_the_pose_and_hinged_ones_can() -> None:
    metrics = coopqp.compare(load("rigid_vs_passive")).metrics
    assert metrics["qp_hinged"]["reached"]
    assert not metrics["qp_firm"]["reached"]
    assert metrics["qp_firm"]["limit_violation_max"] == 0.0


def test_wrong_numbers_of_gains_are_refused() -> None:
    scenario = load("passive_grasp_pose")
    with pytest.raises(InvalidValueError, match=r"kp: found 4 gains, needs 1 or 6"):
        PassiveGraspPid(kp=(1.0, 2.0, 3.0, 4.0)).build(scenario.problem())
    with pytest.raises(ValueError, match="greater than or equal to 0"):
        PassiveGraspPid(ki=(-1.0,))


def test_torques_are_refused_by_ideal_joints() -> None:
    scenario = replace(load("passive_grasp_pose"), plant=Kinematic())
    with pytest.raises(InvalidValueError, match="commands torques"):
        run(scenario, controller="torque_qp")


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("[passive_grasp_pid, ", "[passive_grasp_pid: {kp: [-1]}, ", "needs greater than or equal"),
        ("plant: rigid_body", "disturbance: {delay: 2}", "disturbance.delay: has no effect"),
        ("plant: rigid_body", "grasp_of: {qq: rigid}", "unknown controller 'qq'"),
        ("plant: rigid_body", "plant: rigid_body\ngrasps: {right: rigid}", "not both"),
        ("    point:", "    pont:", "unknown key 'pont'; did you mean 'point'"),
        ("dt: 0.002", "dt: 0.0025", "needs a whole part of dt"),
    ],
)
def test_bad_input_gets_one_message_and_exit_code_2(
    tmp_path: Path, old: str, new: str, message: str
) -> None:
    text = shipped()["passive_grasp_pose"].read_text(encoding="utf-8")
    assert old in text
    said = refused_in_one_line("compare", write(tmp_path, text.replace(old, new, 1)))
    assert message in " ".join(said.split())


def test_mujoco_is_asked_for_in_words_when_it_is_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "mujoco", None)
    scenario = replace(load("passive_grasp_pose"), plant=Mujoco())
    with pytest.raises(coopqp.CoopqpError, match=r"pip install 'coopqp\[mujoco\]'"):
        run(scenario, controller="torque_qp")


def test_the_torque_qp_answers_within_its_budget() -> None:
    scenario = load("passive_grasp_pose")
    law = TorqueQp().build(scenario.problem())
    state = law.start()
    state.update()
    command = law.tick(state)
    assert command.status.usable
    assert law.solution.primal_residual < 1e-6  # type: ignore[attr-defined]
