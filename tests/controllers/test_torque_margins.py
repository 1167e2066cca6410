"""Steps, delays and rates that the PID and the torque QP stand, and settings that they refuse."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from coopqp.base.errors import InvalidValueError
from coopqp.base.spec import Pose
from coopqp.controller import Controller
from coopqp.controllers import PassiveGraspPid, TorqueQp
from coopqp.controllers.passive_grasp_pid import TorquePid
from coopqp.execution.controller_run import run
from coopqp.model.profile import Profile
from coopqp.plant import Disturbance, Push
from coopqp.plants import Kinematic, RigidBody
from coopqp.scenario.loader import load
from coopqp.scenario.scenario import Scenario
from coopqp.tasks import Pose as PoseTask
from coopqp.torque_law.margins import DELAY, MIN_DAMPING, row_loop
from coopqp.trace import Trace

TORQUE: dict[str, Controller] = {"pid": PassiveGraspPid(), "torque_qp": TorqueQp()}


def jump(
    controller: Controller,
    *,
    dt: float = 0.002,
    delay: int = 0,
    gain: float = 25.0,
    duration: float = 0.45,
    wait: float = 0.0,
    disturbance: Disturbance | None = None,
) -> Scenario:
    """The box of passive_grasp_pose shall be 3 cm away at once."""
    scenario = load("passive_grasp_pose")
    (task,) = scenario.tasks
    assert isinstance(task, PoseTask)
    goal = Pose(position=task.goal.position)
    profile = Profile(kind="step", delay=wait)
    return replace(
        scenario,
        tasks=(replace(task, goal=goal, gain=gain, profile=profile),),
        controllers={"c": controller},
        plant=RigidBody(time_step=0.002),
        dt=dt,
        kappa=100.0,
        duration=duration,
        disturbance=disturbance or Disturbance(delay=delay),
    )


def gone(scenario: Scenario) -> tuple[Trace, np.ndarray, np.ndarray]:
    """The run, the share of the way that is left along it, and the distance left over the way."""
    (task,) = scenario.tasks
    assert isinstance(task, PoseTask)
    trace = run(scenario, controller="c")
    e = trace.position - np.array(task.goal.position)
    way = np.linalg.norm(e[0])
    assert way == pytest.approx(0.03, abs=2e-3)
    return trace, e @ e[0] / way**2, np.linalg.norm(e, axis=1) / way


@cache
def stepped(controller: str, dt: float, delay: int) -> tuple[Trace, np.ndarray, np.ndarray]:
    return gone(jump(TORQUE[controller], dt=dt, delay=delay))


@pytest.mark.few(3)
@pytest.mark.parametrize("delay", [0, 1])
@pytest.mark.parametrize("dt", [0.002, 0.01])
@pytest.mark.parametrize("controller", TORQUE)
def test_a_step_arrives_without_overshoot(controller: str, dt: float, delay: int) -> None:
    _, along, distance = stepped(controller, dt, delay)
    assert -along.min() < 0.01
    assert distance[-1] < 0.01


@pytest.mark.parametrize("controller", TORQUE)
def test_a_step_is_as_fast_as_the_model_of_its_gain(controller: str) -> None:
    trace, along, _ = stepped(controller, 0.002, 0)
    t = 25.0 * trace.t
    np.testing.assert_allclose(along, (1.0 + t) * np.exp(-t), atol=0.02)


@pytest.mark.parametrize("controller", TORQUE)
def test_a_step_that_comes_later_does_not_overshoot_either(controller: str) -> None:
    _, along, distance = gone(jump(TORQUE[controller], wait=0.2, duration=0.65))
    assert -along.min() < 0.001
    assert distance[-1] < 0.001


def test_a_step_of_the_kinematic_pid_does_not_overshoot() -> None:
    pid = PassiveGraspPid(level="kinematic")
    _, along, distance = gone(replace(jump(pid, dt=0.01, duration=2.0), plant=Kinematic()))
    assert -along.min() < 0.001
    assert distance[-1] < 0.001


@pytest.mark.few(1)
@pytest.mark.parametrize("controller", TORQUE)
def test_a_heavier_box_is_brought_all_the_way(controller: str) -> None:
    heavy = Disturbance(object_mass=2.0)
    _, _, distance = gone(jump(TORQUE[controller], duration=1.0, disturbance=heavy))
    assert distance[-1] < 0.002  # without an integral 0.1 and more


@pytest.mark.parametrize("controller", [PassiveGraspPid(ki=(0.0,)), TorqueQp(integral=0.0)])
def test_without_an_integral_a_heavier_box_sags(controller: Controller) -> None:
    heavy = Disturbance(object_mass=2.0)
    _, _, distance = gone(jump(controller, duration=0.5, disturbance=heavy))
    assert distance[-1] > 0.05


@pytest.mark.few(1)
@pytest.mark.parametrize("controller", TORQUE)
def test_a_pushed_box_comes_back(controller: str) -> None:
    pushed = Disturbance(push=Push(force=(0.0, 1.0, 0.0), start=0.3, duration=0.2))
    trace, _, distance = gone(jump(TORQUE[controller], duration=1.0, disturbance=pushed))
    assert distance[trace.t > 0.3].max() > 0.03
    assert distance[-1] < 0.01


def test_the_default_gains_are_damped_at_every_rate() -> None:
    for dt in (0.0005, 0.001, 0.002, 0.003, 0.005, 0.01):
        law = PassiveGraspPid().build(jump(PassiveGraspPid(), dt=dt).problem())
        assert isinstance(law, TorquePid)
        assert law.loop.damping(DELAY) >= MIN_DAMPING


def test_the_linear_loop_tells_the_delay_at_which_the_pid_breaks() -> None:
    scenario = jump(PassiveGraspPid(), duration=0.5)
    law = PassiveGraspPid().build(scenario.problem())
    assert isinstance(law, TorquePid)
    assert law.loop.damping(2) > 0.0 > law.loop.damping(3)
    ends = [
        gone(replace(scenario, disturbance=Disturbance(delay=delay)))[2][-1] for delay in (2, 3)
    ]
    assert ends[0] < 0.005 < ends[1]


@pytest.mark.parametrize("delay", [20, 40])
@pytest.mark.parametrize("x", [1.02, 1.05, 1.1])
def test_the_largest_integral_is_that_of_the_characteristic_equation(x: float, delay: int) -> None:
    """s^3 + exp(-s T) (2 g s^2 + g^2 s + i g^3) = 0 at s = j g x, with T = dt (1/2 + delay)."""
    integral = 2.0 * x**2 - x * math.sqrt(x**4 - 1.0)
    late = math.acos(1.0 / x**2) / x
    dt = late / (0.5 + delay)  # of g = 1; short, so that holding a command is half a tick late
    assert row_loop(1.0, 0.9 * integral, dt).damping(delay) > 0.0
    assert row_loop(1.0, 1.1 * integral, dt).damping(delay) < 0.0


def test_without_delay_the_bound_of_routh_is_two() -> None:
    assert row_loop(1.0, 1.99, 1e-3).damping(0) > 0.0 > row_loop(1.0, 2.01, 1e-3).damping(0)


@pytest.mark.parametrize(
    ("integral", "dt", "most"), [(1.9, 0.002, "0.79"), (1.9, 0.01, "0.67"), (0.7, 0.01, "0.67")]
)
def test_an_integral_that_rings_is_refused(integral: float, dt: float, most: str) -> None:
    controller = TorqueQp(integral=integral)
    message = rf"torque_qp.integral: found {integral:g}, needs at most {most} at gain 25 1/s"
    with pytest.raises(InvalidValueError, match=message):
        controller.build(jump(controller, dt=dt).problem())
    allowed = TorqueQp(integral=float(most))
    allowed.build(jump(allowed, dt=dt).problem())


@pytest.mark.parametrize("controller", TORQUE)
def test_a_gain_beyond_the_rate_is_refused(controller: str) -> None:
    chosen = TORQUE[controller]
    with pytest.raises(InvalidValueError, match=r"task carry: found gain 80 1/s.* at most 31 1/s"):
        chosen.build(jump(chosen, dt=0.01, gain=80.0).problem())
    chosen.build(jump(chosen, dt=0.01, gain=31.0).problem())


@pytest.mark.parametrize(
    ("pid", "fix"),
    [
        (PassiveGraspPid(ki=(2400, 2400, 2400, 16, 16, 16)), r"\); needs ki at most 0\.74 times"),
        (PassiveGraspPid(kd=(40, 40, 40, 1, 1, 1)), r"kp at most 0\.13 .* kd at most 0\.36 times"),
        (PassiveGraspPid(kp=(600, 600, 600, 40, 40, 40)), r"kp at most 0\.26 .* ki at most 0\.13"),
        (PassiveGraspPid(kd=(0.0,)), "or more kd with the same kp and ki"),
        (PassiveGraspPid(level="kinematic", kd=(1.5,)), r"kd at most 0\.33 times"),
    ],
)
def test_gains_that_ring_are_refused_with_what_to_change(pid: PassiveGraspPid, fix: str) -> None:
    with pytest.raises(InvalidValueError, match=rf"the gains oscillate at dt 2 ms.*{fix}"):
        pid.build(jump(pid).problem())


def test_a_damper_alone_is_allowed() -> None:
    pid = PassiveGraspPid(kp=(0.0,), ki=(0.0,))
    pid.build(jump(pid).problem())
