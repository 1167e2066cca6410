"""The loop for robots whose motors take torques: it moves, comes to rest and holds on."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scenario_files import needs_robots

import coopqp
from coopqp.base.errors import InvalidValueError
from coopqp.base.spec import Array
from coopqp.controller import Command
from coopqp.online.arrivals import Readings
from coopqp.online.loop import OnlineLoop
from coopqp.online.real_time import real_time
from coopqp.online.simulated import SimulatedRobot
from coopqp.plants import Mujoco
from coopqp.scenario.scenario import Scenario
from coopqp.solver import Status

LAWS = ["torque_qp", "passive_grasp_pid"]


def simulated(scenario: Scenario, controller: str, **settings: Any) -> Any:
    """A loop that counts ticks, and its scenario's plant."""
    loop = OnlineLoop(scenario, controller, clock=None, **settings)
    return loop, SimulatedRobot(loop)


def go(
    loop: OnlineLoop, robot: SimulatedRobot, time: float, *, silent: bool = False
) -> list[Command]:
    """Some time; the commands."""
    said = []
    for _ in range(round(time / loop.problem.dt)):
        command = loop.tick(None if silent else robot.read())
        assert command.tau is not None
        robot.apply(command.tau)
        said.append(command.copy())
    return said


def place(robot: SimulatedRobot) -> Array:
    """Where the object truly is [m]."""
    robot.state.update()
    return robot.state.p_WO.copy()


def speed(robot: SimulatedRobot) -> float:
    return float(np.abs(robot.state.v).max())


@pytest.mark.few(1)
@pytest.mark.parametrize(
    ("law", "plant"),
    [("torque_qp", "rigid_body"), ("torque_qp", "mujoco"), ("passive_grasp_pid", "mujoco")],
)
def test_it_follows_stops_holds_and_goes_on(law: str, plant: str) -> None:
    scenario = replace(coopqp.load("passive_grasp_pose"), dt=0.005, kappa=np.inf)
    if plant == "mujoco":
        pytest.importorskip("mujoco")
        scenario = replace(scenario, plant=Mujoco())
    loop, robot = simulated(scenario, law)
    said = go(loop, robot, 0.6)
    assert {command.status for command in said} == {Status.OPTIMAL}
    assert speed(robot) > 0.1
    began, way = place(robot), scenario.dt * speed(robot)

    loop.stop("somebody came near")
    assert not loop.at_rest
    assert {command.status for command in go(loop, robot, 1.0)} == {Status.STOPPED}
    assert loop.at_rest
    assert loop.running
    held = place(robot)
    assert np.linalg.norm(held - began) < 3e-3 + way
    go(loop, robot, 0.3)
    np.testing.assert_allclose(place(robot), held, atol=5e-5)

    loop.resume()
    go(loop, robot, scenario.duration - loop.state.t)
    assert loop.status is Status.OPTIMAL
    wanted = coopqp.run(scenario, controller=law)
    np.testing.assert_allclose(place(robot), wanted.position[-1], atol=1e-3)
    loop.end("done")
    go(loop, robot, 0.3)
    assert not loop.running


@pytest.mark.few(1)
@pytest.mark.parametrize("law", LAWS)
def test_a_robot_that_says_nothing_is_slowed_down_by_the_model(law: str) -> None:
    scenario = replace(coopqp.load("passive_grasp_pose"), dt=0.005)
    loop, robot = simulated(scenario, law)
    go(loop, robot, 0.6)
    before, where = speed(robot), place(robot)
    said = go(loop, robot, 0.2, silent=True)
    assert {command.status for command in said} == {Status.ROBOT_SILENT}
    assert speed(robot) < 0.5 * before
    go(loop, robot, 0.2)
    assert loop.status is Status.OPTIMAL
    go(loop, robot, 0.5, silent=True)
    assert "the robot has not said where it is" in loop.stopped
    assert loop.at_rest
    assert np.linalg.norm(place(robot) - where) < 0.02


@pytest.mark.few(1)
@pytest.mark.parametrize("law", LAWS)
def test_a_load_that_the_integral_has_learned_is_held_at_rest(law: str) -> None:
    heavy = coopqp.load("heavy_object")
    assert heavy.disturbance.object_mass > 1.5  # of which the law is not told
    loop, robot = simulated(replace(heavy, dt=0.005), law)
    go(loop, robot, 0.6)
    stopped = place(robot)
    loop.stop()
    sunk = 0.0
    for _ in range(20):
        go(loop, robot, 0.05)
        sunk = max(sunk, float(np.linalg.norm(place(robot) - stopped)))
    assert sunk < 5e-3  # 30 mm with an integral that begins anew
    loop.resume()
    go(loop, robot, 0.1)
    assert np.linalg.norm(place(robot) - stopped) < 5e-3


@pytest.mark.full
@needs_robots
@pytest.mark.parametrize("dt", [0.005, 0.01])
def test_friction_alone_holds_at_every_period_with_the_default_kappa(dt: float) -> None:
    pytest.importorskip("mujoco")
    given = coopqp.load("press_and_lift")
    scenario = replace(given, dt=dt, kappa=np.inf, disturbance=type(given.disturbance)())
    loop, robot = simulated(scenario, "torque_qp")
    low = place(robot)
    go(loop, robot, 1.6)
    loop.stop()
    said = go(loop, robot, 0.6)
    assert {command.status for command in said} == {Status.STOPPED}
    lifted = place(robot)[2] - low[2]
    assert 0.01 < lifted < 0.1
    loop.resume()
    said = go(loop, robot, 1.4)
    assert {command.status for command in said} == {Status.OPTIMAL}
    np.testing.assert_allclose(place(robot)[2] - low[2], 0.1, atol=3e-3)


def test_what_a_driver_must_say_and_take() -> None:
    scenario = coopqp.load("passive_grasp_pose")
    loop, robot = simulated(scenario, "torque_qp")
    n = scenario.chain.n
    command = loop.tick(robot.read()[0])
    assert command.tau is None
    assert loop.status is Status.NOT_MEASURED
    assert loop.note == (
        f"found shape ({n},), needs (2, {n}): joints and their velocities, by which torques are "
        "computed"
    )
    reading = robot.read()
    reading[1, 0] = np.nan
    loop.tick(reading)
    assert loop.note == "the velocities of joints are NaN or infinite"
    go(loop, robot, 0.01)
    assert loop.begun
    for v, seen in ((50.0, r"limit is"), (1e300, r"limit is")):
        reading = robot.read()
        reading[1, 1] = v
        loop.tick(reading)
        assert loop.status is Status.NOT_MEASURED
        assert f"{scenario.chain.joint_names[1]} at +{v:.3g} rad/s, but its {seen}" in loop.note

    timed = OnlineLoop(scenario, "torque_qp")
    with pytest.raises(InvalidValueError, match="has no method apply"):
        real_time(timed, object.__new__(_Velocities))
    with pytest.raises(InvalidValueError, match="check joints by a loop of a controller"):
        coopqp.check_joints(timed, object.__new__(_Velocities))


class _Velocities:
    def read(self) -> None:
        """Nothing."""

    def write(self, q: Array, v: Array) -> None:
        """Nothing."""


def test_an_early_call_holds_the_torques() -> None:
    scenario, now = coopqp.load("passive_grasp_pose"), [0.0]
    loop = OnlineLoop(scenario, "torque_qp", clock=lambda: now[0])
    robot = SimulatedRobot(loop)
    tau = loop.tick(robot.read()).tau.copy()
    now[0] += 0.1 * scenario.dt
    held = loop.tick(robot.read())
    assert held.status is Status.EARLY
    np.testing.assert_array_equal(held.tau, tau)


def test_the_robot_is_left_with_torques_that_hold() -> None:
    scenario = coopqp.load("passive_grasp_pose")
    loop, taken = OnlineLoop(scenario, "torque_qp"), list[Array]()
    still = np.stack([scenario.chain.q_start, np.zeros(scenario.chain.n)])

    class Robot:
        def read(self) -> Array:
            return still

        def apply(self, tau: Array) -> None:
            taken.append(tau.copy())

    ended = real_time(loop, Robot(), duration=0.05)
    assert "the time is up" in ended.why
    dynamics = loop.law._level.dynamics
    dynamics.update(still[0], still[1])
    np.testing.assert_allclose(
        taken[-1], dynamics.distribute(dynamics.gravity(still[0])).tau, atol=1e-9
    )


@pytest.mark.few(1)
@pytest.mark.parametrize("wrong", ["reversed", "zero", "in degrees"])
def test_a_velocity_that_does_not_fit_the_way_is_named_and_the_arms_rest(wrong: str) -> None:
    """Believed it moves NAO's arms by 70 to 145 rad/s."""
    loop, robot = simulated(coopqp.load("heavy_object"), "torque_qp")
    joint, factor = 1, {"reversed": -1.0, "zero": 0.0, "in degrees": np.rad2deg(1.0)}[wrong]
    fastest, factors = 0.0, np.ones(loop.problem.chain.n)
    for k in range(round(1.5 / loop.problem.dt)):
        factors[joint] = factor if k * loop.problem.dt > 0.3 else 1.0
        command = loop.tick(robot.read() * [np.ones_like(factors), factors])
        robot.apply(command.tau)
        fastest = max(fastest, speed(robot))
    first = loop.faults[0]
    assert first[:2] == ("velocities_wrong", (loop.problem.chain.joint_names[joint],))
    assert first.t < 0.4
    assert loop.stopped
    assert fastest < 6.0
    assert speed(robot) < 0.3


@pytest.mark.full
@pytest.mark.parametrize("name", ["press_and_lift", "heavy_object"])
def test_velocities_that_are_all_in_degrees_are_named_before_the_arms_run_away(name: str) -> None:
    """Where only those already found wrong are taken from positions Pandas reach 89 rad/s."""
    loop, robot = simulated(coopqp.load(name), "torque_qp")
    fastest, began = 0.0, 0.3
    for k in range(round(0.9 / loop.problem.dt)):
        wrong = k * loop.problem.dt > began
        command = loop.tick(robot.read() * [[1.0], [np.rad2deg(1.0) if wrong else 1.0]])
        robot.apply(command.tau)
        fastest = max(fastest, speed(robot))
    assert loop.faults[0].kind == "velocities_wrong"
    assert loop.faults[0].t < began + 0.05
    assert loop.stopped
    assert fastest < 1.5
    assert speed(robot) < 0.1


def test_one_velocity_that_is_lost_is_no_fault() -> None:
    loop, robot = simulated(coopqp.load("heavy_object"), "torque_qp")
    for k in range(round(0.6 / loop.problem.dt)):
        reading = robot.read()
        reading[1, 1] = 50.0 if k == 150 else reading[1, 1]
        robot.apply(loop.tick(reading).tau)
        assert (loop.status is Status.NOT_MEASURED) == (k == 150)
    assert not loop.faults


def test_a_velocity_that_does_not_fit_is_taken_from_positions() -> None:
    """Of a joint that goes at 1 rad/s; a first-order filter's answer is 1 - exp(-t/T)."""
    chain = coopqp.load("passive_grasp_pose").chain
    readings, q, dt = Readings(chain, rates=True), chain.q_start.copy(), 1e-3
    v = np.zeros(chain.n)
    for k in range(100):
        assert readings.take(np.array([q, v]), q, k * dt) is None
        q[1] += dt
    assert readings.misread == (1,)
    assert readings.v is not None
    np.testing.assert_allclose(readings.v[1], 1.0, atol=1e-3)
    assert not np.delete(readings.v, 1).any()
    readings.forget()
    assert not readings.misread
