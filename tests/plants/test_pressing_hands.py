"""Hands that hold by pressing, in MuJoCo and on rigid bodies."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from chains import HANDS
from pads import pressing

from coopqp.assessment import assess
from coopqp.base.errors import InvalidValueError
from coopqp.base.spec import Array
from coopqp.closed_loop.grasp_matrix import section
from coopqp.controller import Controller, ControlProblem
from coopqp.controllers import TorqueQp, WrenchSplit
from coopqp.execution.rollout import rollout
from coopqp.grasps import PointContact, Rigid
from coopqp.metrics.edge_margin import EdgeMargin
from coopqp.metrics.friction_margin import FrictionMargin
from coopqp.metrics.held import Held
from coopqp.metrics.load_share import LoadShare
from coopqp.metrics.slip_distance import SlipDistance
from coopqp.metrics.squeeze import Squeeze
from coopqp.metrics.torque_margin import TorqueMargin
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.grasp_configuration import HeldObject
from coopqp.plant import Disturbance, Plant, Push
from coopqp.plants import Mujoco, RigidBody
from coopqp.robots import NaoT14
from coopqp.solver import Status
from coopqp.solvers import Daqp
from coopqp.task import Task
from coopqp.tasks import InternalWrench, PointOnPoint
from coopqp.trace import Trace

DT, G, MASS = 0.002, 9.81, 0.2  # [s], [m/s2], [kg]
PLANTS = {"mujoco": Mujoco(time_step=0.001), "rigid_body": RigidBody(time_step=0.002)}


@cache
def nao() -> ClosedChain:
    """With pads that touch a box as wide as the hands are apart."""
    robot = NaoT14().build()
    box = HeldObject(size=(0.08, 0.20864352, 0.08), mass=MASS)
    firm = ClosedChain.attach(robot, robot.configuration(HANDS), Rigid(), box)
    return pressing(firm, MASS, 0.02)


def ran(
    plant: Plant,
    disturbance: Disturbance | None = None,
    *wrenches: Task,
    seconds: float = 0.3,
    chain: ClosedChain | None = None,
    controller: Controller | None = None,
) -> Trace:
    held = chain or nao()
    x, y, z = held.start_position
    asked = ControlProblem(
        chain=held,
        tasks=[PointOnPoint(goal=(x, y, z), gain=20.0)],
        wrenches=wrenches,
        solver=Daqp(),
        dt=DT,
        kappa=50.0,
    )
    law = (controller or TorqueQp()).build(asked)
    built = plant.build(asked, 0, disturbance or Disturbance())
    return rollout(law, built, round(seconds / DT), controller="torque_qp", solver="daqp")


@cache
def at_rest(name: str) -> Trace:
    return ran(PLANTS[name])


@pytest.mark.parametrize("name", PLANTS)
def test_the_box_is_held_with_the_least_squeeze_that_friction_needs(name: str) -> None:
    """M g / (2 mu / (sqrt(2) 1.5)) presses, and the weight hangs on both hands alike."""
    trace = at_rest(name)
    assert set(trace.status) == {Status.OPTIMAL.name}
    least = MASS * G / (2.0 * 0.5 / (math.sqrt(2.0) * 1.5))
    normal = trace.signals["normal_force"][-50:]
    assert np.allclose(normal, least, rtol=0.01)
    assert np.allclose(trace.signals["tangential_force"][-50:], MASS * G / 2.0, rtol=0.01)
    # mu over what is needed, m g / 2 over the normal force.
    assert np.allclose(trace.signals["friction_use"][-50:], MASS * G / least, rtol=0.02)
    assert Held().measure(trace) == {"held": True, "lost_at": None}
    margin, slip = FrictionMargin().measure(trace), SlipDistance().measure(trace)
    assert margin is not None
    assert slip is not None
    assert 0.3 < margin < 0.55
    assert slip < 1e-4
    assert np.allclose(LoadShare().measure(trace), [0.5, 0.5], atol=0.01)


@pytest.mark.few(2)
@pytest.mark.parametrize("name", PLANTS)
@pytest.mark.parametrize("mode", ["soft", "hard"])
def test_a_squeeze_that_is_asked_for_is_measured_within_one_per_cent(name: str, mode: str) -> None:
    trace = ran(PLANTS[name], None, InternalWrench(squeeze=9.0, mode=mode))
    assert set(trace.status) == {Status.OPTIMAL.name}
    assert np.allclose(trace.signals["normal_force"][-50:], 9.0, rtol=0.01)
    found = Squeeze().measure(trace)
    assert found
    assert found["mean"] == pytest.approx(9.0, rel=0.02)
    # The task is told like any other.
    assert [task.name for task in trace.tasks][-1] == "internal_wrench"
    assert assess(trace).errors[-1] < 0.09
    assert trace.tasks[-1].unit == "N"


@pytest.mark.parametrize("name", PLANTS)
def test_hands_and_weight_balance(name: str) -> None:
    """Newton: what the hands do sums up to the weight, in force and in torque."""
    trace = at_rest(name)
    h = trace.signals["hand_wrench"][-1].reshape(2, 6)
    p = trace.signals["hand_point"][-1].reshape(2, 3)
    assert np.allclose(h[:, :3].sum(axis=0), [0, 0, MASS * G], atol=0.02)
    torque = np.cross(p - trace.position[-1], h[:, :3]).sum(axis=0) + h[:, 3:].sum(axis=0)
    assert np.allclose(torque, 0.0, atol=2e-3)
    squeeze = section(p[0], p[1]).of(h)[0]
    assert squeeze == pytest.approx(trace.signals["normal_force"][-1].mean(), rel=1e-3)


def test_with_half_the_friction_the_box_is_lost_in_both_plants() -> None:
    """What the controller keeps free is 1 - 1 / (1.5 sqrt(2)) of it, not more than a half."""
    for plant in PLANTS.values():
        trace = ran(plant, Disturbance(friction=0.4), seconds=0.4)
        found = Held().measure(trace)
        assert found
        assert not found["held"]
        # The run ends there: nothing moves any more, and nothing counts on.
        assert trace.status[-1] == Status.OBJECT_LOST.name
        assert assess(trace).ended
        assert np.array_equal(trace.q[-1], trace.q[-2])
        last = int(np.argmin(trace.signals["held"][:, 0]))
        assert np.array_equal(trace.signals["slip"][-1], trace.signals["slip"][last])
        ended = [f for f in trace.failures if f.cause == Status.OBJECT_LOST.value]
        assert [f.tick for f in ended] == list(range(ended[0].tick, trace.ticks))
        assert last < ended[0].tick <= last + 2
    assert "needs more friction than there is" in ended[0].note


def test_with_enough_friction_left_it_is_held() -> None:
    for plant in PLANTS.values():
        found = Held().measure(ran(plant, Disturbance(friction=0.6), seconds=0.4))
        assert found
        assert found["held"]


@pytest.mark.parametrize("name", PLANTS)
def test_a_pad_that_tips_is_no_lack_of_friction(name: str) -> None:
    """Walker's torques on pads ask for m g a / (2 X) = 5.1 N, friction for m g / (2 mu N) of it."""
    newtons = 4.4
    trace = ran(PLANTS[name], controller=WrenchSplit(split="walker", squeeze=newtons))
    found = Held().measure(trace)
    assert found
    assert not found["held"]
    if name == "rigid_body":
        assert "tips over its pad's edge" in trace.failures[0].note
        assert trace.signals["edge_use"][0].max() == pytest.approx(5.12 / newtons, rel=0.01)
        needed = MASS * G / (2.0 * 0.5 * newtons)
        assert np.allclose(trace.signals["friction_use"][0], needed, rtol=0.03)
        assert EdgeMargin().measure(trace) == pytest.approx(1.0 - 5.12 / newtons, abs=0.01)
    else:  # the engine's contacts bear no more than friction, and nothing outside of the pads
        assert np.nanmax(trace.signals["friction_use"]) < 1.0 + 1e-6
        assert 0.999 < np.nanmax(trace.signals["edge_use"][:20]) < 1.001


@pytest.mark.parametrize("name", PLANTS)
def test_of_friction_without_end_next_to_none_is_used(name: str) -> None:
    trace = ran(PLANTS[name], Disturbance(friction=1e6), seconds=0.1)
    assert FrictionMargin().measure(trace) == pytest.approx(1.0, abs=1e-5)


def test_a_push_uses_friction_and_a_large_one_loses_the_box() -> None:
    for newtons, held in ((0.5, True), (15.0, False)):
        push = Push(force=(0, 0, -newtons), start=0.2, duration=0.4)
        found = Held().measure(ran(Mujoco(time_step=0.001), Disturbance(push=push), seconds=0.5))
        assert found
        assert found["held"] is held


def test_a_fragile_box_is_not_pressed_harder_than_it_stands() -> None:
    firm = nao()
    fragile = {name: replace(grasp, least=5.0, most=6.0) for name, grasp in firm.grasps.items()}
    chain = ClosedChain.attach(firm.robot, firm.q_start, fragile, firm.held)
    trace = ran(Mujoco(time_step=0.001), chain=chain)
    assert np.allclose(trace.signals["normal_force"][-50:], 5.0, rtol=0.01)  # more than friction's
    with pytest.raises(InvalidValueError, match=r"can do 5 to 6 N; most force of (right|left)"):
        ran(Mujoco(time_step=0.001), None, InternalWrench(squeeze=12.0), chain=chain)


def test_a_centre_of_mass_elsewhere_is_borne() -> None:
    trace = ran(Mujoco(time_step=0.001), Disturbance(object_com=(0.0, 0.02, 0.0), object_mass=1.2))
    h = trace.signals["hand_wrench"][-1].reshape(2, 6)
    assert h[:, 2].sum() == pytest.approx(1.2 * MASS * G, rel=0.03)
    assert h[1, 2] > h[0, 2]  # it is nearer to the left hand


def test_torques_stay_inside_the_motors_and_the_least_margin_is_told() -> None:
    trace = at_rest("mujoco")
    found = TorqueMargin().measure(trace)
    assert found
    tau, effort = np.abs(trace.signals["tau"]), trace.effort
    assert found["least"] == pytest.approx(1.0 - float((tau / effort).max()))
    assert found["joint"] in trace.joints


def test_mujoco_refuses_a_contact_that_does_not_touch_the_box() -> None:
    firm = nao()
    away = replace(firm.held, size=(0.08, 0.16, 0.08))
    chain = ClosedChain.attach(firm.robot, firm.q_start, firm.grasps, away)
    with pytest.raises(InvalidValueError, match=r"contact of right is 24\.3 mm from the object"):
        ran(Mujoco(time_step=0.001), chain=chain)


def test_fingertips_hold_a_box_that_turns_between_them() -> None:
    """Two points bear no torque about the line between them, so that the box can swing there."""
    firm = nao()
    tips = {
        name: PointContact(normal=g.normal, along=g.along, edges=16)
        for name, g in firm.grasps.items()
    }
    chain = ClosedChain.attach(firm.robot, firm.q_start, tips, firm.held)
    trace = ran(Mujoco(time_step=0.001), chain=chain)
    assert Held().measure(trace) == {"held": True, "lost_at": None}
    h = trace.signals["hand_wrench"][-1].reshape(2, 6)
    # Forces alone: the contact is some micrometres deep.
    assert np.abs(h[:, 3:]).max() < 1e-5
    least = MASS * G / 2.0 / (0.5 / 1.5 * math.cos(math.pi / 16))
    normal: Array = trace.signals["normal_force"][-20:]
    assert np.all(normal > 0.97 * MASS * G / (2.0 * 0.5 / 1.5))
    assert np.all(normal < 1.03 * least)


@pytest.mark.few(3)
@pytest.mark.parametrize(
    ("split", "squeeze", "held"),
    [
        ("walker", 0.0, False),
        ("minimum_norm", 0.0, False),
        ("virtual_inertia", 0.0, False),
        ("virtual_inertia", 1.7, False),
        ("virtual_inertia", 2.3, True),
        ("walker", 4.4, False),
        ("walker", 6.0, True),
    ],
)
def test_formulas_hold_with_a_squeeze_that_somebody_found_for_them(
    split: str, squeeze: float, held: bool
) -> None:
    """Friction asks for m g / (2 mu) = 1.96 N; Walker's torques on pads for m g a / (2 X) = 5.1 N.

    Without any squeeze nothing holds, whatever the split.
    """
    settings = WrenchSplit(split=split, squeeze=squeeze)
    found = Held().measure(ran(Mujoco(time_step=0.001), seconds=0.4, controller=settings))
    assert found
    assert found["held"] is held
