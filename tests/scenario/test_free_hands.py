"""Phases in which no arm holds the object: approach, take hold, move, put down, let go."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from scenario_files import TAKES_HOLD, needs_robots, phased

import coopqp
from coopqp.base.errors import GraspError, ScenarioError
from coopqp.base.spec import Array
from coopqp.controller import Command
from coopqp.controllers.torque_qp import TorqueQpLaw
from coopqp.grasp import pose_matrix
from coopqp.limits import SelfCollision
from coopqp.online.simulated import SimulatedRobot
from coopqp.plant import Plant
from coopqp.plants import Mujoco, QuasiStatic, RigidBody
from coopqp.scenario.scenario import Scenario
from coopqp.solver import Status
from coopqp.solvers import Daqp
from coopqp.trace import Trace


@pytest.fixture(scope="module")
def pandas() -> Scenario:
    return coopqp.load("pick_and_place")


@pytest.fixture(scope="module")
def trace(pandas: Scenario) -> Trace:
    return coopqp.run(pandas, controller="qp", timed=False)


def _in_phase(scenario: Scenario, name: str) -> slice:
    i = [phase.name for phase in scenario.schedule].index(name)
    first = scenario.first_ticks[i]
    return slice(first, first + scenario.schedule[i].ticks(scenario.dt))


@needs_robots
def test_the_object_stands_moves_with_the_hands_and_stays_where_it_was_put(
    pandas: Scenario, trace: Trace
) -> None:
    assert pandas.held.pose is not None
    start, (up, down) = pose_matrix(pandas.held.pose), _goals(pandas)
    for name in ("approach", "reach"):
        assert (trace.position[_in_phase(pandas, name)] == start.translation).all()
    assert trace.position[_in_phase(pandas, "put down").start] == pytest.approx(up, abs=1e-4)
    stands = trace.position[_in_phase(pandas, "leave")]
    assert stands[0] == pytest.approx(down, abs=1e-4)
    assert np.ptp(stands, axis=0) == pytest.approx([0.0, 0.0, 0.0], abs=1e-12)
    assert set(trace.status) == {"OPTIMAL"}
    assert ((trace.lower <= trace.q) & (trace.q <= trace.upper)).all()


def _goals(scenario: Scenario) -> tuple[Array, Array]:
    tasks = [phase.tasks[0] for phase in scenario.phases if phase.name in ("carry", "put down")]
    first, second = (np.array(task.goal.position) for task in tasks)  # type: ignore[attr-defined]
    return first, second


@needs_robots
def test_hands_take_hold_where_the_file_says_that_they_shall(
    pandas: Scenario, trace: Trace
) -> None:
    """The tips by pinocchio, in the object, are the inverse of object_in_hand."""
    q, model = trace.q[_in_phase(pandas, "close").start], pandas.robot_model.model
    data = model.createData()
    pin.framesForwardKinematics(model, data, q)
    assert pandas.held.pose is not None
    assert isinstance(pandas.grasps, Mapping)
    X_WO = pose_matrix(pandas.held.pose)
    for arm in pandas.robot_model.arms:
        X_TO = pandas.grasps[arm.name].object_in_hand
        assert X_TO is not None
        tip = data.oMf[model.getFrameId(arm.tip)]
        assert np.abs(pin.log6(tip.actInv(X_WO).actInv(pose_matrix(X_TO))).vector).max() < 1e-4


@needs_robots
def test_hands_keep_away_from_the_object_until_they_are_about_to_hold_it(
    pandas: Scenario, trace: Trace
) -> None:
    limit = next(limit for limit in pandas.limits if isinstance(limit, SelfCollision))
    name = "object|left/panda_leftfinger"
    fingers = {row.name: m for row, m in trace.margins.items() if name in row.name}
    assert fingers
    for margins in fingers.values():
        watched = np.isfinite(margins)
        approach = _in_phase(pandas, "approach")
        assert watched[approach].all()
        assert not watched[approach.stop :].any()
        assert margins[approach].min() > 0.0
    assert any("leftfinger" in row.name for row in limit.rows(pandas.problem().chain))


@needs_robots
def test_the_plain_law_says_the_same_as_the_kernel(
    pandas: Scenario, monkeypatch: pytest.MonkeyPatch
) -> None:
    cut = replace(pandas, phases=tuple(replace(p, duration=0.05) for p in pandas.phases))
    compiled = coopqp.run(cut, controller="qp", timed=False)
    monkeypatch.setattr(Daqp, "kernel_instead", False)
    plain = coopqp.run(cut, controller="qp", timed=False)
    assert not plain.compiled.any()
    assert np.abs(compiled.q - plain.q).max() < 1e-8


@pytest.mark.full
@needs_robots
@pytest.mark.parametrize("plant", [RigidBody(), QuasiStatic(), Mujoco(time_step=0.001)])
def test_hands_carry_the_weight_between_taking_hold_and_letting_go(
    pandas: Scenario, plant: Plant
) -> None:
    if isinstance(plant, Mujoco):
        pytest.importorskip("mujoco")
    given = replace(pandas, plant=plant, limits=pandas.limits[:2], dt=0.01)
    trace = coopqp.run(given, controller="qp", timed=False)
    forces = trace.signals["hand_wrench"].reshape(trace.ticks, -1, 6)[:, :, :3].sum(axis=1)
    for name in ("approach", "reach", "leave"):
        assert not forces[_in_phase(given, name)].any()
    weight = [0.0, 0.0, 9.81 * given.held.mass]
    assert forces[_in_phase(given, "close").stop - 1] == pytest.approx(weight, abs=0.01)
    end = trace.position[-1]
    assert end == pytest.approx(_goals(given)[1], abs=2e-3)  # servos as springs sag
    assert (np.ptp(trace.position[_in_phase(given, "leave")], axis=0) < 1e-9).all()


def test_nao_takes_hold_of_a_box_that_stands_and_leaves_it(tmp_path: Path) -> None:
    scenario = phased(tmp_path, TAKES_HOLD)
    for controller in scenario.controllers:
        trace = coopqp.run(scenario, controller=controller)
        lift, leave = scenario.first_ticks[1:]
        assert (trace.position[: lift + 1] == [0.16, 0.0, 0.05]).all()
        assert trace.position[leave] == pytest.approx([0.16, 0.0, 0.07], abs=1e-4)
        assert np.ptp(trace.position[leave:], axis=0).max() < 1e-12
        assert trace.loop_position.max() < 1e-3


def test_an_object_that_stands_has_a_pose(tmp_path: Path) -> None:
    text = TAKES_HOLD.replace(", pose: {position: [0.16, 0.0, 0.05]}", "")
    with pytest.raises(ScenarioError, match=r"object: no arm holds the object at the start; say"):
        phased(tmp_path, text)


# By torques


def _by_torques(folder: Path, **changes: str) -> Scenario:
    """Both arms of NAO reach by their joints, of which each has five."""
    text, back = TAKES_HOLD, TAKES_HOLD.index("      - relative_motion")
    away = text[text.index("      - posture") : text.index("  - name: lift")]
    text = text[:back] + away.replace("name: in", "name: out") + text[text.index("controllers") :]
    text = text.replace("dt: 0.01", "plant: rigid_body\ndt: 0.005")
    for old, new in ({"[qp, pseudoinverse]": "[torque_qp]"} | changes).items():
        text = text.replace(old, new)
    return phased(folder, text)


@pytest.mark.parametrize("shares", ["weights", "motors", "{right: 0.3, left: 0.7}"])
def test_torques_move_free_hands_and_the_object_between_them(tmp_path: Path, shares: str) -> None:
    law = f"{{torque_qp: {{shares: {shares}}}}}"
    scenario = _by_torques(tmp_path, **{"[qp, pseudoinverse]": f"[{law}]"})
    trace = coopqp.run(scenario, controller="torque_qp", timed=False)
    assert set(trace.status) == {"OPTIMAL"}
    take, leave = _in_phase(scenario, "take"), _in_phase(scenario, "leave")
    assert (trace.position[take] == [0.16, 0.0, 0.05]).all()
    assert trace.position[leave.start] == pytest.approx([0.16, 0.0, 0.07], abs=1e-3)
    assert np.ptp(trace.position[leave], axis=0) == pytest.approx([0.0, 0.0, 0.0], abs=1e-12)
    goal = scenario.phases[0].tasks[0].goal["left"]  # type: ignore[attr-defined]
    robot = scenario.robot_model
    arm = next(arm for arm in robot.arms if arm.name == "left")
    own = [scenario.chain.joint_names.index(name) for name in robot.arm_joints(arm)]
    assert trace.q[take.stop, own] == pytest.approx(goal, abs=0.01)


@pytest.mark.parametrize("knows", ["unknown", "observed", "measured"])
def test_torques_of_free_hands_are_those_of_the_arms_alone(tmp_path: Path, knows: str) -> None:
    """By pinocchio's inverse dynamics of a robot without an object."""
    law = f"{{torque_qp: {{external_wrench: {knows}}}}}"
    scenario = _by_torques(tmp_path, **{"[qp, pseudoinverse]": f"[{law}]"})
    own = scenario.controllers["torque_qp"].build(scenario.problem())
    assert isinstance(own, TorqueQpLaw)
    state, model = own.start(), scenario.robot_model.model
    state.v[:], state.hand_wrench = np.linspace(-0.5, 0.5, len(state.v)), np.zeros(12)
    command = own.tick(state)
    assert command.causes == (Status.OPTIMAL,)
    a = own.solution.v[own.layout.a]
    tau = pin.rnea(model, model.createData(), state.q, state.v, a)
    assert command.tau == pytest.approx(tau, abs=1e-6)


def test_the_loop_by_torques_rests_with_free_hands_and_goes_on(tmp_path: Path) -> None:
    scenario = _by_torques(tmp_path)
    loop = coopqp.OnlineLoop(scenario, "torque_qp", clock=None)
    robot, gripped = SimulatedRobot(loop), dict[str, Mapping[str, str]]()
    for k in range(scenario.ticks + 180):
        if k == 20:
            loop.stop("somebody is near")
        if k == 200:
            assert loop.at_rest
            assert loop.phase.name == "take"
            loop.resume()
        command = loop.tick(robot.read())
        assert command.tau is not None
        robot.apply(command.tau)
        gripped[loop.phase.name] = command.grippers
    opened, closed = (dict.fromkeys(("right", "left"), word) for word in ("open", "close"))
    assert gripped == {"take": opened, "lift": closed, "leave": opened}
    assert loop.state.p_WO == pytest.approx([0.16, 0.0, 0.07], abs=1e-3)
    assert not loop.faults


def test_torques_refuse_rows_that_free_arms_cannot_have(tmp_path: Path) -> None:
    text = TAKES_HOLD.replace("dt: 0.01", "plant: rigid_body\ndt: 0.005")
    scenario = phased(tmp_path, text)  # of a pose by five joints
    words = "torque_qp: the tasks ask 6 rows of free arms, and the motors decide only 5 of them"
    with pytest.raises(GraspError, match=words):
        coopqp.run(scenario, controller="torque_qp")
    with pytest.raises(GraspError, match="passive_grasp_pid: no arm holds the object in one of"):
        coopqp.run(scenario, controller="passive_grasp_pid")


# The loop for robots


def test_the_loop_takes_the_object_where_it_is_seen_and_tells_the_grippers(tmp_path: Path) -> None:
    scenario = phased(tmp_path, TAKES_HOLD)
    loop = coopqp.OnlineLoop(scenario, clock=None)
    loop.begin(scenario.chain.q_start + 1e-3, object_pose=[0.15, 0.01, 0.06, 0.0, 0.0, 0.0, 1.0])
    robot = SimulatedRobot(loop)
    assert loop.state.p_WO == pytest.approx([0.15, 0.01, 0.06])
    seen = [0.155, 0.0, 0.055, 0.0, 0.0, np.sin(0.1), np.cos(0.1)]
    gripped, taken = dict[str, Mapping[str, str]](), np.zeros(3)
    for k in range(scenario.ticks + 20):
        inputs = {10: {"object_pose": seen}, 20: {"object_pose": [1.0, 2.0]}}.get(k)
        command = loop.tick(robot.read(), inputs=inputs)
        robot.write(loop.setpoint, command.v)
        if k == 20:
            assert command.causes[0] is Status.INPUT_REFUSED
            assert (
                loop.note
                == "object_pose: found shape (2,), needs 7 numbers: x, y, z, qx, qy, qz, qw"
            )
        if loop.phase.name == "lift" and "lift" not in gripped:
            taken[:] = loop.state.p_WO
        gripped[loop.phase.name] = command.grippers
    opened, closed = (dict.fromkeys(("right", "left"), word) for word in ("open", "close"))
    assert gripped == {"take": opened, "lift": closed, "leave": opened}
    assert taken == pytest.approx(seen[:3], abs=1e-9)
    assert loop.state.p_WO == pytest.approx([0.16, 0.0, 0.07], abs=1e-4)  # where it was put
    assert not loop.faults


def test_the_first_tick_may_bring_the_object(tmp_path: Path) -> None:
    loop = coopqp.OnlineLoop(phased(tmp_path, TAKES_HOLD), clock=None)
    q = loop.scenario.chain.q_start
    loop.tick(q, {"object_pose": coopqp.Pose(position=(0.15, 0.0, 0.06))})
    assert loop.begun
    assert loop.state.p_WO == pytest.approx([0.15, 0.0, 0.06])


def test_a_driver_with_a_gripper_is_told_when_it_changes(tmp_path: Path) -> None:
    class Driver:
        def __init__(self, loop: coopqp.OnlineLoop) -> None:
            self.q, self.told = loop.setpoint.copy(), list[Mapping[str, str]]()

        def read(self) -> Array:
            return self.q.copy()

        def write(self, q: Array, v: Array) -> None:
            self.q[:] = q

        def grip(self, grippers: Mapping[str, str]) -> None:
            self.told.append(grippers)

    loop = coopqp.OnlineLoop(phased(tmp_path, TAKES_HOLD), phases="asked")
    driver, ticks = Driver(loop), iter(range(10_000))

    def inputs() -> None:
        if next(ticks) in (5, 15):
            loop.next_phase()

    coopqp.real_time(loop, driver, inputs=inputs, duration=0.4)
    assert [told["left"] for told in driver.told] == ["open", "close", "open"]


def test_commands_of_other_loops_have_no_grippers() -> None:
    assert not Command(2).grippers


def test_the_loop_rests_on_the_way_to_the_object_and_goes_on(tmp_path: Path) -> None:
    scenario = phased(tmp_path, TAKES_HOLD)
    loop = coopqp.OnlineLoop(scenario, clock=None)
    robot = SimulatedRobot(loop)
    for k in range(scenario.ticks + 60):
        if k == 10:
            loop.stop("somebody is near")
        if k == 50:
            assert loop.at_rest
            loop.resume()
        command = loop.tick(robot.read())
        robot.write(loop.setpoint, command.v)
    assert loop.phase.name == "leave"
    assert loop.state.p_WO == pytest.approx([0.16, 0.0, 0.07], abs=1e-4)
