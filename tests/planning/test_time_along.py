"""The fastest motion along a path: closed forms, pinocchio's dynamics, limits between places."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from dynamics_by_hand import PinocchioOracle, relative
from random_ways import random_way
from scenario_files import needs_robots

from coopqp.base.errors import CoopqpError, InvalidValueError
from coopqp.base.spec import Array, Positive, spec
from coopqp.base.table import csv_text
from coopqp.closed_loop.grasp_matrix import COMPONENTS
from coopqp.controller import Controller
from coopqp.controllers import PassiveGraspPid, TorqueQp
from coopqp.execution.comparison import compare
from coopqp.execution.controller_run import run
from coopqp.grasps import Rigid
from coopqp.limits import JointAcceleration, JointPosition, JointVelocity, ObjectSpeed
from coopqp.model.grasp_configuration import HeldObject
from coopqp.model.profile import Profile
from coopqp.model.state import State
from coopqp.planning.closed_path import CLOSED
from coopqp.planning.time_along import LIGHTER, MORE, TOLERATED, TimedPath, time_along, would_do
from coopqp.planning.timing import SHARE_OF_TASKS, Clock, timed, with_fastest_profiles
from coopqp.plant import Disturbance
from coopqp.plants import Mujoco, RigidBody
from coopqp.robot import Arm, Robot, RobotModel
from coopqp.robots import PlanarPair
from coopqp.scenario.loader import load
from coopqp.scenario.planned import PlanReference, Way, following, way_tasks
from coopqp.scenario.scenario import Phase, Scenario
from coopqp.signal import CLOCK, POSE, Moment, Trajectory
from coopqp.signals import Waypoints
from coopqp.tasks import InternalWrench, Posture
from coopqp.torque_law.task_dynamics import TaskDynamics

MASS, EFFORT, SPEED, PUSH = 2.0, 6.0, 0.7, 1.5
"""Of a slider and what it carries [kg, N, m/s, m/s2]."""


@spec
class Sliders(Robot):
    """Two sliding joints side by side, level, each with a hand and without mass."""

    speed: Positive = 1e3
    effort: Positive = 1e3

    def build(self) -> RobotModel:
        model = pin.Model()
        for name, y in (("left", 0.05), ("right", -0.05)):
            base = pin.SE3(np.eye(3), np.array([0.0, y, 0.0]))
            joint = model.addJoint(0, pin.JointModelPX(), base, name)
            hand = pin.Frame(f"{name}_hand", joint, 0, pin.SE3.Identity(), pin.FrameType.OP_FRAME)
            model.addFrame(hand)
        model.lowerPositionLimit[:], model.upperPositionLimit[:] = -5.0, 5.0
        model.velocityLimit[:], model.effortLimit[:] = self.speed, self.effort
        arms = tuple(Arm(name=name, tip=f"{name}_hand") for name in ("left", "right"))
        return RobotModel(name="sliders", model=model, arms=arms)


def sliders(speed: float = 1e3, effort: float = 1e3, push: float | None = None) -> Scenario:
    limits = (JointPosition(), *([JointAcceleration(max=push)] if push else []))
    return replace(
        load("point_on_point"), robot=Sliders(speed=speed, effort=effort), limits=limits,
        start={"left": [0.0], "right": [0.0]}, grasps=Rigid(),
        held=HeldObject(mass=MASS, size=(0.1, 0.1, 0.1)),
    )  # fmt: skip


#: |v| of both over the speed of one.
ROOT = np.sqrt(2.0)
LINE = np.linspace([0.0, 0.0], [1.2, 1.2], 7)


@pytest.mark.parametrize(
    ("scenario", "a", "v"),
    [
        (sliders(effort=EFFORT), 2.0 * EFFORT / MASS, 1e3),
        (sliders(push=PUSH), PUSH, 1e3),
        (sliders(push=PUSH, speed=SPEED), PUSH, SPEED),
        (sliders(effort=EFFORT, speed=SPEED), 2.0 * EFFORT / MASS, SPEED),
    ],
)
def test_two_sliders_take_the_time_of_closed_forms(scenario: Scenario, a: float, v: float) -> None:
    found = time_along(LINE, scenario, points=100)
    way = LINE[-1, 0]
    quickest = 2.0 * np.sqrt(way / a) if v**2 / a > way else way / v + v / a
    assert found.duration == pytest.approx(quickest, rel=1e-3)


def test_two_sliders_go_from_speed_to_speed() -> None:
    found = time_along(LINE, sliders(push=PUSH), points=100, speed=(ROOT * 0.5, ROOT * 0.3))
    peak = np.sqrt(PUSH * LINE[-1, 0] + 0.5 * (0.5**2 + 0.3**2))
    assert found.duration == pytest.approx((2.0 * peak - 0.8) / PUSH, rel=1e-3)
    assert found.at(0.0).v[0] == pytest.approx(0.5)
    assert found.at(found.duration).v[0] == pytest.approx(0.3)
    with pytest.raises(InvalidValueError, match=r"speed: found 3 rad/s at the beginning, needs 0"):
        time_along(LINE, sliders(push=PUSH), points=100, speed=(3.0, 0.0))


@pytest.mark.parametrize("rise", [0.05, 0.2])
def test_two_sliders_with_bounded_jerk_take_the_time_of_the_closed_form(rise: float) -> None:
    """A bang-bang motion's mean over the rise: so much longer, with jerk 2 a / rise."""
    found = time_along(LINE, sliders(push=PUSH), points=100, rise=rise)
    quickest = 2.0 * np.sqrt(LINE[-1, 0] / PUSH)
    assert found.duration == pytest.approx(quickest + rise, rel=1e-3)
    assert (
        f"takes {rise:g} s more; the joints' jerk is at most {2 * PUSH / rise:.3g} r"
        in found.notes[0]
    )
    t = np.linspace(0.0, found.duration, 4001)
    v = np.array([found.where(now)[1] for now in t]) / ROOT
    a = np.diff(v) / np.diff(t)
    assert np.abs(a).max() < PUSH * 1.001
    window = len(t) // 20  # longer than the steps in which accelerations change
    dt = window * (t[1] - t[0])
    assert np.abs(a[window:] - a[:-window]).max() / dt < 2.0 * PUSH / rise * (1.0 + rise / dt / 6)
    with pytest.raises(InvalidValueError, match=r"rise: found .* needs a speed of 0 at both ends"):
        time_along(LINE, sliders(push=PUSH), points=100, rise=rise, speed=(0.5, 0.0))


def test_a_motion_with_bounded_jerk_keeps_speeds_and_torques() -> None:
    found, jumps = nao(0, rise=0.02), nao(0)
    assert max(limits_used(found, 501)) < 1.001
    assert jumps.duration + 0.02 < found.duration < jumps.duration + 0.06
    for motion, most in ((found, 0.5), (jumps, 2.0)):  # of what the motors can, within 2 ms
        tau = np.array([motion.at(t).tau for t in np.arange(0.0, motion.duration - 2e-3, 2e-3)])
        steps = np.abs(np.diff(tau, axis=0) / motion.path.chain.model.effortLimit).max()
        assert 0.5 * most < steps < most


def test_each_moment_is_the_derivative_of_the_one_before() -> None:
    found = nao(1)
    h = 1e-5
    for t in np.linspace(0.1, 0.9, 7) * found.duration:
        if np.any(np.abs(found.profile.t - t) < 2 * h):
            continue
        before, now, after = (found.at(t + dt) for dt in (-h, 0.0, h))
        np.testing.assert_allclose((after.q - before.q) / (2 * h), now.v, atol=2e-4)
        np.testing.assert_allclose((after.v - before.v) / (2 * h), now.a, rtol=1e-4, atol=5e-3)


@cache
def nao(seed: int, **options: float) -> TimedPath:
    scenario = load("point_on_point")
    return time_along(random_way(scenario.chain, seed), scenario, **options)


def test_planned_torques_cause_the_planned_accelerations() -> None:
    found = nao(0)
    oracle = PinocchioOracle(found.path.chain)
    for t in np.linspace(0.02, 0.98, 25) * found.duration:
        now = found.at(float(t))
        a = oracle.acceleration(now.q, now.v, now.tau)
        assert relative(a, now.a) < 1e-6


def limits_used(found: TimedPath, count: int) -> tuple[float, float]:
    """Largest share of speed and torque at so many times; torques as :meth:`TimedPath.at` has."""
    chain = found.path.chain
    moments = [found.at(float(t)) for t in np.linspace(0.0, found.duration, count)]
    motors = np.setdiff1d(np.arange(chain.n), chain.passive)
    v = max(np.abs(now.v[motors] / chain.velocity[motors]).max() for now in moments)
    effort = np.array(chain.model.effortLimit)
    return v, max(np.abs(now.tau[motors] / effort[motors]).max() for now in moments)


@pytest.mark.parametrize("name", ["point_on_point", "passive_grasp_pose"])
def test_limits_are_kept_between_the_places_and_one_is_met(name: str) -> None:
    scenario = load(name)
    found = time_along(random_way(scenario.chain, 3), scenario)
    speed, torque = limits_used(found, 501)
    assert max(speed, torque) < 1.001
    assert found.exceeded < 1.001
    assert found.shares.get("nothing", 0.0) < 0.05
    assert max(speed, torque) > 0.99


@pytest.mark.full
@pytest.mark.parametrize("name", ["point_on_point", "joint_limit_stress"])
def test_limits_are_kept_on_a_grid_that_is_too_coarse_for_the_path(name: str) -> None:
    scenario = load(name)
    found = time_along(run(scenario, controller="qp", timed=False), scenario, points=20)
    assert max(limits_used(found, 2001)) < 1.005


def test_loops_stay_closed_all_along() -> None:
    found = nao(2)
    chain = found.path.chain
    for s in np.linspace(0.0, found.path.length, 400):
        q = found.path.spline(s)
        places = [X.translation.copy() for X in chain._carried(q, chain.model.createData())]
        assert np.linalg.norm(places[1] - places[0]) < CLOSED


def test_less_of_anything_takes_longer() -> None:
    quickest = nao(0).duration
    assert nao(0, torque=0.7).duration > quickest
    assert nao(0, wrench=(1e-3, 1e-3)).duration >= quickest * (1.0 - 1e-6)
    scenario = load("point_on_point")
    limits = (JointPosition(), JointVelocity(scale=0.5), ObjectSpeed(linear=0.1))
    path = random_way(scenario.chain, 0)
    slow = time_along(path, replace(scenario, limits=limits))
    assert slow.duration > quickest
    assert any(name.startswith("speed of the object") for name in slow.active)
    moments = [slow.at(float(t)) for t in np.linspace(0.0, slow.duration, 200)]
    steps = np.diff([now.p_WO for now in moments], axis=0) / (slow.duration / 199)
    assert np.abs(steps).max() < 0.1 * 1.001


def test_what_would_do_is_what_timing_with_it_takes() -> None:
    found, scenario = nao(0), load("point_on_point")
    tried = would_do(found)
    assert (
        list(tried)
        == [*(name for name in found.shares if name != "nothing"), LIGHTER][-len(tried) :]
    )
    assert max(tried.values()) <= found.duration * (1.0 + 1e-3)
    held = replace(scenario.held, mass=0.8 * scenario.held.mass)
    lighter = time_along(random_way(scenario.chain, 0), replace(scenario, held=held))
    assert tried[LIGHTER] == pytest.approx(lighter.duration, rel=1e-9)
    sliding = sliders(push=PUSH, speed=SPEED)
    tried = would_do(time_along(LINE, sliding, points=100))
    for name, a, v in (("acceleration", MORE * PUSH, SPEED), ("speed", PUSH, MORE * SPEED)):
        found_by_name = [seconds for key, seconds in tried.items() if key.startswith(name)]
        assert found_by_name
        both = LINE[-1, 0] / v + v / a  # of both sliders; of one alone the other still binds
        assert min(found_by_name) >= both - 1e-6


def test_plans_are_timed_within_the_objects_speed_and_accelerations() -> None:
    scenario = load("point_on_point")
    limits = (JointPosition(), JointVelocity(), JointAcceleration(max=4.0), ObjectSpeed(linear=0.1))
    problem = replace(scenario, limits=limits).problem()
    q = nao(0).path.spline(np.linspace(0.0, nao(0).path.length, 400))
    _, ticks = timed(problem, q, lambda near: near, Clock(60.0))
    np.testing.assert_allclose(ticks[[0, -1]], q[[0, -1]], atol=1e-9)
    places = np.array([scenario.chain.object_pose(row).translation for row in ticks])
    speeds = np.abs(np.diff(places, axis=0)) / problem.dt
    assert 0.079 < speeds.max() < 0.081
    v = np.diff(ticks, axis=0, prepend=ticks[:1], append=ticks[-1:]) / problem.dt
    assert 2.0 < np.abs(np.diff(v, axis=0)).max() / problem.dt < 4.0


def test_internal_wrenches_stay_in_the_box_and_cancel() -> None:
    found = nao(0, wrench=(0.5, 0.05))
    for t in np.linspace(0.0, found.duration, 40):
        internal = found.at(float(t)).internal
        assert np.abs(internal[:, :3]).max() < 0.5 * TOLERATED + 1e-6  # as all limits
        assert np.abs(internal[:, 3:]).max() < 0.05 * TOLERATED + 1e-6
        assert np.abs(internal.sum(axis=0)).max() < 1e-9


def test_the_box_of_the_wrench_is_a_limit_that_is_named_and_kept() -> None:
    scenario = load("yeo_4_5")  # whose hinge leaves the wrench no choice
    way = random_way(scenario.chain, 0, count=3, step=0.3)
    found = time_along(way, scenario, wrench=(2.0, 0.2))
    assert found.duration > time_along(way, scenario).duration
    assert sum(found.shares.values()) == pytest.approx(1.0)
    assert found.shares["internal wrench of left (x)"] > 0.3
    assert found.shares.get("nothing", 0.0) < 0.01
    assert found.exceeded < 1.001
    moments = [found.at(float(t)) for t in np.linspace(0.0, found.duration, 201)]
    assert 1.99 < max(np.abs(now.internal[:, :3]).max() for now in moments) < 2.002


def test_hands_that_press_stay_in_their_cones() -> None:
    """The wrenches by the direct model's own object dynamics, in the contact's own rows."""
    scenario = load("nao_presses")
    chain = scenario.chain
    q = random_way(chain, 1, count=2, step=0.2)
    found = time_along(q, scenario)
    assert {name.partition(" ")[0] for name in found.active} & {"friction", "edge", "least"}
    assert pressed(found, 1.5) < 1e-4
    assert pressed(time_along(q, scenario, safety=1.0), 1.5) > 0.0


def pressed(found: TimedPath, safety: float) -> float:
    """By how much the hands leave their cones at worst [N]."""
    from coopqp.closed_loop.dynamics import ClosedLoopDynamics
    from coopqp.closed_loop.grasp_matrix import moved
    from coopqp.closed_loop.hands import hands, in_axes

    chain = found.path.chain
    dynamics = ClosedLoopDynamics(chain, shares=[0.5, 0.5])
    worst = -np.inf
    for t in np.linspace(0.0, found.duration, 60):
        now = found.at(float(t))
        dynamics.update(now.q, now.v)
        M, b = dynamics.object_inertia()
        w = M @ (dynamics.drift_arms[:6] + dynamics.J_object @ now.a) + b
        for hand, internal in zip(hands(chain), now.internal, strict=True):
            assert hand.contact
            at = now.p_WO + now.R_WO @ hand.X_OC.translation
            h = moved(0.5 * w + internal, now.p_WO, at)
            h = in_axes(h, (now.R_WO @ hand.X_OC.rotation).T)
            cone = hand.contact.force_rows(safety)
            worst = max(worst, float((cone.rows @ h - cone.upper).max()))
    return worst


@needs_robots
def test_accelerations_of_two_pandas_are_kept_and_bind() -> None:
    scenario = load("two_pandas")
    limits = (JointPosition(), JointVelocity(), JointAcceleration(max=7.5))
    found = time_along(random_way(scenario.chain, 4), replace(scenario, limits=limits))
    moments = [found.at(float(t)) for t in np.linspace(0.0, found.duration, 801)]
    assert max(np.abs(now.a).max() for now in moments) < 7.5 * 1.001
    assert sum(share for name, share in found.shares.items() if "acceleration" in name) > 0.5


@pytest.mark.parametrize("seed", [11, 12])
def test_motors_without_limits_leave_speeds(seed: int) -> None:
    scenario = load("yeo_4_5")  # whose one hinge is all that has a limit of torque: 0
    found = time_along(random_way(scenario.chain, seed, count=3, step=0.3), scenario)
    speed, _ = limits_used(found, 201)
    assert 0.99 < speed < 1.001
    hinge = scenario.chain.passive
    for t in np.linspace(0.0, found.duration, 9):
        now = found.at(float(t))
        J = scenario.chain.loop_jacobian(now.q)[:, hinge]
        tree = tree_torques(found, now.q, now.v, now.a)[hinge]
        assert np.abs(tree + J.T @ now.internal[1]).max() < 1e-6


def tree_torques(found: TimedPath, q: Array, v: Array, a: Array) -> Array:
    """Of the tree whose arms carry the object's mass alike."""
    model = found.maker.dynamics.model
    return np.asarray(pin.rnea(model, model.createData(), q, v, a))


@needs_robots
def test_every_instant_has_torques() -> None:
    scenario = load("two_so101")  # ten motors, of which little is planned with
    found = time_along(random_way(scenario.chain, 0), scenario, torque=0.15)
    for t in np.linspace(0.0, found.duration, 60):
        tau = found.at(float(t)).tau
        assert np.abs(tau).max() < 0.15 * 2.94 * 1.002


def test_a_path_of_redundant_loops_is_timed() -> None:
    scenario = load("planar_pair")
    found = time_along(random_way(scenario.chain, 0), scenario)
    speed, torque = limits_used(found, 301)
    assert 0.99 < max(speed, torque) < 1.001


def test_a_path_that_turns_back_is_timed_and_named() -> None:
    scenario = load("point_on_point")
    way = random_way(scenario.chain, 0, count=2, step=0.4)
    there = time_along(way, scenario).path.spline(np.linspace(0.0, 0.4, 21))
    found = time_along(np.vstack([there, there[-2::-1]]), scenario)
    assert "turns back; it is passed slowly" in found.notes[0]
    assert max(limits_used(found, 301)) < 1.01


def test_stretched_arms_are_passed_and_named() -> None:
    """Arms on one another stretch, where no motor tells how hard they pull along them."""
    bend = np.linspace(-0.5, 0.5, 21)[:, None]
    arm = np.hstack([-0.5 * bend, bend, -0.5 * bend])
    start = {"right": arm[0].tolist(), "left": arm[0].tolist()}
    scenario = replace(load("planar_pair"), robot=PlanarPair(distance=1e-5), start=start)
    found = time_along(np.hstack([arm, arm]), scenario)
    assert any("the arms are singular; it is passed slowly" in note for note in found.notes)
    assert max(limits_used(found, 301)) < 1.001


def test_one_arm_alone_carries_as_its_own_dynamics_say() -> None:
    scenario = load("point_on_point")
    alone = Phase(name="alone", duration=1.0, released=("left",), tasks=scenario.tasks)
    scenario = replace(scenario, phases=(alone,), tasks=())
    found = time_along(random_way(scenario.chain, 0), scenario)
    assert max(limits_used(found, 201)) < 1.001
    model = found.maker.dynamics.model
    for t in np.linspace(0.1, 0.9, 5) * found.duration:
        now = found.at(float(t))
        tau = pin.rnea(model, model.createData(), now.q, now.v, now.a)
        np.testing.assert_allclose(now.tau, tau, atol=1e-10)


def test_the_table_is_a_reference_that_way_points_read(tmp_path: Path) -> None:
    found = nao(1)
    file = tmp_path / "timed.csv"
    file.write_text(csv_text(found.table(0.01)), encoding="utf-8")
    chain = found.path.chain
    pose = Waypoints(file=file).bind(POSE, Moment(0.0), None)
    pose.update(Moment(0.5 * found.duration))
    X = chain.object_pose(found.at(0.5 * found.duration).q)
    np.testing.assert_allclose(pose.value[:3], X.translation, atol=1e-4)
    again = time_along(file, load("point_on_point"))
    assert again.duration == pytest.approx(found.duration, rel=0.01)


def test_torques_that_follow_it_squeeze_as_planned(tmp_path: Path) -> None:
    """In the rigid-body plant; by itself the controller has less than a fifth of it."""
    found, dt = nao(0, torque=0.8), 0.002
    file = tmp_path / "timed.csv"
    file.write_text(csv_text(found.table(dt)), encoding="utf-8")
    posture = Posture(goal=Waypoints(file=file), gain=40.0, profile=Profile(kind="step"))
    wrench = InternalWrench(
        **{part: Waypoints(file=file, column=part, between="linear") for part in COMPONENTS}
    )
    scenario = replace(
        load("point_on_point"), plant=RigidBody(), dt=dt, kappa=100.0, duration=found.duration,
        controllers={"torque_qp": TorqueQp()}, secondary=(),
    )  # fmt: skip
    forces = []
    for tasks in ((posture, wrench), (posture,)):
        trace = run(replace(scenario, tasks=tasks), controller="torque_qp", timed=False)
        assert np.abs(trace.q[-1] - found.at(found.duration).q).max() < 0.01
        assert (np.abs(trace.signals["tau"]) <= trace.effort * (1.0 + 1e-9)).all()
        between = trace.signals["internal_wrench"].reshape(len(trace.t) - 1, -1, 6)
        forces.append(np.linalg.norm(between[:, 0, :3], axis=1))
    planned = [np.linalg.norm(found.at(t).internal[0, :3]) for t in trace.t[:-1]]
    assert np.median(np.abs(forces[0] - planned)) < 0.01 * np.max(planned)
    assert np.median(forces[1]) < 0.2 * np.median(planned)


@pytest.mark.full
@pytest.mark.parametrize(
    ("name", "law"),
    [
        ("point_on_point", TorqueQp()),
        ("passive_grasp_pose", TorqueQp()),
        ("passive_grasp_pose", PassiveGraspPid()),
    ],
)
def test_a_plan_that_is_timed_is_followed_with_its_forces(
    name: str, law: Controller, tmp_path: Path
) -> None:
    """In MuJoCo; without the columns of the wrench the law shares the load by itself."""
    pytest.importorskip("mujoco")
    shipped, dt = load(name), 0.002
    found = time_along(random_way(shipped.chain, 0, count=3, step=0.3), shipped, torque=0.8)
    table = found.table(dt)
    alone = {key: column for key, column in table.items() if key not in COMPONENTS}
    scenario = shipped.changed(
        plant=Mujoco(), dt=dt, kappa=100.0, secondary=(), controllers={law.name: law}
    )
    whole = [found.at(dt * k) for k in range(round(found.duration / dt))]
    off, forces, torques = [], [], []
    for columns in (table, alone):
        file = tmp_path / f"{len(columns)}.csv"
        file.write_text(csv_text(columns), encoding="utf-8")
        trace = run(
            following(scenario, PlanReference(plan=file, late=0.1)),
            controller=law.name,
            timed=False,
        )
        ticks = slice(0, len(whole))
        off.append(np.abs(trace.q[ticks] - [now.q for now in whole]).max())
        assert (np.abs(trace.signals["tau"]) <= trace.effort * (1.0 + 1e-9)).all()
        motors = np.setdiff1d(np.arange(shipped.chain.n), shipped.chain.passive)
        tau = trace.signals["tau"][ticks] - [now.tau for now in whole]
        torques.append(np.median(np.abs(tau[:, motors]) / shipped.chain.model.effortLimit[motors]))
        between = trace.signals["internal_wrench"].reshape(-1, 2, 6)[ticks, 0, :3]
        forces.append(np.median(np.abs(between - [now.internal[0, :3] for now in whole])))
    assert off[0] < 0.01
    assert forces[0] < 0.1  # N, of up to 6 and 16
    assert forces[0] < 0.2 * forces[1]
    assert torques[0] < 0.02
    assert torques[0] < 0.25 * torques[1]


@pytest.mark.parametrize("pace", [1.0, 0.4])
def test_accelerations_along_a_way_are_those_of_its_clock(pace: float) -> None:
    """The second derivative of x(clock) is x'' pace^2, whatever the time is."""
    scenario = load("point_on_point")
    t = np.linspace(0.0, 1.0, 41)
    q = scenario.chain.q_start + 0.1 * np.sin(2.0 * t)[:, None]
    way = Way(t, q, np.zeros((0, 7)))
    tasks = way_tasks(way, scenario.dt, True, TorqueQp())
    level = TaskDynamics(replace(scenario.problem(), tasks=tasks))
    state = State(scenario.chain)
    state.t, clock = 3.0, Trajectory(CLOCK, np.array([0.6]))
    clock.rate[0], state.inputs["way"] = pace, clock
    level.update(state)
    wanted = -0.4 * np.sin(1.2) * pace**2
    np.testing.assert_allclose(level.drift, -wanted, rtol=2e-3)


@pytest.mark.few(1)
@needs_robots
@pytest.mark.parametrize(("safety", "rest"), [(1.5, 0.2), (1.0, 1.0)])
def test_a_box_between_pads_is_held_or_lost_with_less_friction_and_said(
    safety: float, rest: float, tmp_path: Path
) -> None:
    """In MuJoCo, with friction 30 % less than told."""
    pytest.importorskip("mujoco")
    scenario = load("press_and_lift")
    way = random_way(scenario.chain, 1, count=3, step=0.4)
    found = time_along(way, scenario, safety=safety)
    file = tmp_path / "timed.csv"
    file.write_text(csv_text(found.table(0.002)), encoding="utf-8")
    task = Posture(goal=Waypoints(file=file), gain=40.0, profile=Profile(kind="step"))
    carried = replace(
        scenario, tasks=(task,), secondary=(), plant=Mujoco(), dt=0.002, kappa=100.0,
        controllers={"torque_qp": TorqueQp(safety=safety)}, duration=found.duration + rest,
        disturbance=Disturbance(friction=0.7),
    )  # fmt: skip
    compared = compare(carried)
    slip = float(np.nanmax(compared.traces["torque_qp"].signals["slip"]))
    said = compared.verdicts["torque_qp"]
    if safety > 1.0:
        assert slip < 2e-3
        assert said.startswith("Holds the object")
    else:
        assert slip > 0.05
        assert said.startswith("Loses the object at ")


def test_the_fastest_profile_takes_the_time_of_closed_forms() -> None:
    """Of sliders from rest to rest; the law keeps up and reaches both limits."""
    task = Posture(goal=[1.2, 1.2], profile=Profile(kind="fastest", delay=0.1))
    made = replace(
        sliders(push=PUSH, speed=SPEED), tasks=(task,), secondary=(), duration=3.0,
        limits=(JointPosition(), JointVelocity(), JointAcceleration(max=PUSH)),
    )  # fmt: skip
    with pytest.raises(InvalidValueError, match=r"fastest is found when a file is read"):
        made.problem()
    found = with_fastest_profiles(made)
    assert found.tasks[0].way
    v, a = SHARE_OF_TASKS * SPEED, SHARE_OF_TASKS * PUSH
    assert found.tasks[0].way.duration == pytest.approx(1.2 / v + v / a, abs=made.dt)
    trace = run(found, controller="qp", timed=False)
    arrived = round(found.tasks[0].end / made.dt)
    assert np.abs(trace.q[arrived] - 1.2).max() < 1e-3
    assert SHARE_OF_TASKS * SPEED - 1e-6 < np.abs(trace.v).max() <= SPEED * (1.0 + 1e-9)
    with pytest.raises(InvalidValueError, match=r"arrives at 2\.\d+ s, after the end at 2 s"):
        with_fastest_profiles(replace(made, duration=2.0))


def test_a_file_may_ask_for_the_fastest_profile(tmp_path: Path) -> None:
    text = Path("scenarios/point_on_point.yaml").read_text(encoding="utf-8")
    file = tmp_path / "fast.yaml"
    file.write_text(text.replace("kind: quintic, duration: 2.0", "kind: fastest"), encoding="utf-8")
    scenario = load(file)
    trace = run(scenario, controller="qp", timed=False)
    arrived = round(scenario.tasks[0].end / scenario.dt)
    assert arrived < 20  # of 200 ticks
    goal = [0.13, 0.05, 0.03]
    assert np.linalg.norm(scenario.chain.object_pose(trace.q[arrived]).translation - goal) < 5e-3
    used = np.abs(trace.v[:arrived] / scenario.chain.velocity).max(axis=1)
    assert np.median(used) > 0.9
    file.write_text(text.replace("duration: 2.0", "shares: [0, 1]"), encoding="utf-8")
    with pytest.raises(CoopqpError, match=r"fast.yaml:15: .* needs shares that rise"):
        load(file)


def test_way_points_of_the_object_are_a_path(tmp_path: Path) -> None:
    found, scenario, file = nao(0), load("point_on_point"), tmp_path / "object.csv"
    poses = found.table(0.01)
    wanted = {name: poses[name][::4] for name in POSE.columns}
    file.write_text(csv_text(wanted), encoding="utf-8")
    along = time_along(file, scenario)
    at = [scenario.chain.object_pose(along.path.spline(s)) for s in along.path.points]
    places = np.array([X.translation for X in at])
    for p in np.array([wanted[name] for name in "xyz"]).T:
        assert np.linalg.norm(places - p, axis=1).min() < 2e-3
    assert max(limits_used(along, 201)) < 1.001
    file.write_text(csv_text({**wanted, "z": wanted["z"] + 0.5}), encoding="utf-8")
    with pytest.raises(InvalidValueError, match=r"object.csv:2: the law brings the object no near"):
        time_along(file, scenario)


REFUSED = {
    "needs at least 2 configurations of 10 joints": lambda q: q[:1],
    "point 1: no finite number for RShoulderPitch": lambda q: spoiled(q, np.nan),
    "point 1: RShoulderPitch is 6.9 rad beyond its limit": lambda q: spoiled(q, 9.0),
    "point 1: the loops are not closed: hands stand": lambda q: spoiled(q, q[1, 0] + 0.1),
    "its points are all the same": lambda q: q[[0, 0, 0]],
    "jumps by .* from point 10 to point 11, where the others": lambda q: np.vstack(
        [q[:1] + 1e-4 * k * (q[1:2] - q[:1]) for k in range(11)] + [q[-1:]]
    ),
}


def spoiled(q: Array, value: float) -> Array:
    found = q.copy()
    found[1, 0] = value
    return found


@pytest.mark.parametrize("words", REFUSED)
def test_paths_that_are_none_are_refused_with_the_place(words: str) -> None:
    scenario = load("point_on_point")
    path = REFUSED[words](random_way(scenario.chain, 0))
    with pytest.raises(InvalidValueError, match=words):
        time_along(path, scenario)


def test_a_load_that_cannot_be_held_is_refused_with_place_and_motor() -> None:
    scenario = load("point_on_point")
    heavy = replace(scenario, held=replace(scenario.held, mass=3.0))
    words = r"at \d+ % of the path, between points .* held at rest: .* % of torque of .Shoulder"
    with pytest.raises(InvalidValueError, match=words):
        time_along(random_way(scenario.chain, 0), heavy)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"points": 20.5}, "points: found 20.5, needs a whole number from 8 to 20000"),
        ({"points": 3}, "points: found 3, needs a whole number from 8 to 20000"),
        ({"points": "all"}, "points: found 'all', needs numbers"),
        ({"rise": -1.0}, "rise: found -1.0, needs a time from 0 to 100 s"),
        ({"rise": 1e9}, "rise: found 1000000000.0, needs a time from 0 to 100 s"),
        ({"rise": 1e-9}, r"rise: found 1e-09 s, needs 0, or at least 0.001\d+ s, the time of"),
        ({"torque": 1.5}, r"torque: found 1.5, needs a share in \(0, 1\]"),
        ({"safety": 0.5}, "safety: found 0.5, needs a number from 1 to 1000"),
        ({"wrench": (-1.0, 1.0)}, r"wrench: found \(-1.0, 1.0\), needs two numbers from 0 to 1e6"),
        ({"wrench": 40.0}, "wrench: found 40.0, needs two numbers from 0 to 1e6"),
        ({"speed": (0.0, float("nan"))}, r"speed: found \(0.0, nan\), needs two numbers"),
    ],
)
def test_options_out_of_range_are_refused(options: dict[str, Any], words: str) -> None:
    scenario = load("point_on_point")
    with pytest.raises(InvalidValueError, match=words):
        time_along(random_way(scenario.chain, 0), scenario, **options)


def test_phases_with_other_grasps_are_refused() -> None:
    """The loops and loads of the first one are not those of the next; a plan says where."""
    scenario = load("regrasp")
    path = np.tile(scenario.chain.q_start, (3, 1))
    with pytest.raises(InvalidValueError, match="found one for 4 phases: arms let go between them"):
        time_along(path, scenario)
    with pytest.raises(InvalidValueError, match="phase: found 1, needs 0 to 0"):
        time_along(path, load("two_pandas"), phase=1)
