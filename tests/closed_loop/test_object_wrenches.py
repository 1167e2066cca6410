"""Wrenches on the object and in the hands, against Newton's laws."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from chains import BOX, Closed, closed_states, inertia_of, ring
from dynamics_by_hand import SHARES, accelerations

from coopqp.base.spec import Array
from coopqp.closed_loop.dynamics import ClosedLoopDynamics
from coopqp.model.closed_chain import ClosedChain

H = 1e-4  # step of central differences in time [s]


def test_hands_with_hinges_exert_no_moment_about_them(
    hinged_box: ClosedChain, hinged_states: list[Closed]
) -> None:
    """Whoever carries the mass, a hinge passes no moment about its axis."""
    data = hinged_box.model.createData()
    for shares in SHARES:
        dynamics = ClosedLoopDynamics(hinged_box, shares=shares)
        for q, v in hinged_states:
            dynamics.update(q, v)
            result = dynamics.direct(np.zeros(hinged_box.n))
            wrenches = dynamics.object_wrenches(result.a, result.wrench)
            pin.framesForwardKinematics(hinged_box.model, data, q)
            for i, joint in enumerate(hinged_box.passive):
                hinge, origin = data.oMi[int(joint) + 1], data.oMf[hinged_box.frames[i]].translation
                force, torque = wrenches.by_arm[i, :3], wrenches.by_arm[i, 3:]
                moment = torque - np.cross(hinge.translation - origin, force)
                assert abs(moment @ hinge.rotation[:, 0]) < 1e-9


def object_motion(chain: ClosedChain, q: Array, v: Array, a: Array) -> tuple[Array, Array]:
    """Newton-Euler of the object from where it was, is and will be; wrench at its origin."""
    held, data = chain.held, chain.model.createData()
    about_com = inertia_of(held)
    places = []
    for h in (-H, 0.0, H):
        pin.framesForwardKinematics(chain.model, data, q + h * v + 0.5 * h * h * a)
        places.append(data.oMf[chain.frames[0]].copy())
    before, now, after = places
    coms = [X.act(np.array(held.com)) for X in places]
    force = held.mass * ((coms[0] - 2 * coms[1] + coms[2]) / H**2 + [0, 0, 9.81])
    spin = []
    for first, second in ((before, now), (now, after)):
        omega = pin.log3(second.rotation @ first.rotation.T) / H
        half = pin.exp3(0.5 * H * omega) @ first.rotation
        spin.append(half @ about_com @ half.T @ omega)
    torque = (spin[1] - spin[0]) / H + np.cross(coms[1] - now.translation, force)
    return force, torque


def hand_torques(chain: ClosedChain, q: Array, v: Array, a: Array, by_arm: Array) -> Array:
    """What the joints must bring when the arms move alone and feel the hands' wrenches [N m]."""
    data = chain.model.createData()
    torques = pin.rnea(chain.model, data, q, v, a)
    pin.computeJointJacobians(chain.model, data, q)
    pin.updateFramePlacements(chain.model, data)
    for frame, wrench in zip(chain.frames, by_arm, strict=True):
        J = pin.getFrameJacobian(chain.model, data, frame, pin.LOCAL_WORLD_ALIGNED)
        torques = torques + J.T @ wrench
    return torques


@pytest.mark.parametrize("shares", SHARES)
def test_wrench_on_the_object_is_what_its_motion_needs(
    box_chain: ClosedChain, states: list[Closed], shares: tuple[float, float]
) -> None:
    dynamics = ClosedLoopDynamics(box_chain, shares=shares)
    some = states[:20]
    for (q, v), (tau, a) in zip(some, accelerations(dynamics, some), strict=True):
        dynamics.update(q, v)
        result = dynamics.direct(tau)
        wrenches = dynamics.object_wrenches(result.a, result.wrench)
        force, torque = object_motion(box_chain, q, v, a)
        size = np.linalg.norm(a)
        np.testing.assert_allclose(wrenches.needed[:3], force, atol=1e-5 * size)
        np.testing.assert_allclose(wrenches.needed[3:], torque, atol=1e-5 * size)
        np.testing.assert_allclose(wrenches.by_arm.sum(axis=0), wrenches.needed, atol=1e-9)
        np.testing.assert_allclose(wrenches.internal.sum(axis=0), 0, atol=1e-9)


@pytest.mark.parametrize("shares", SHARES)
def test_each_arm_feels_the_wrench_of_its_hand(
    box_chain: ClosedChain, states: list[Closed], shares: tuple[float, float]
) -> None:
    """The arms without the object obey A a + H = tau - sum J_i' wrench_i."""
    dynamics, some = ClosedLoopDynamics(box_chain, shares=shares), states[:20]
    for (q, v), (tau, a) in zip(some, accelerations(dynamics, some), strict=True):
        dynamics.update(q, v)
        for used, wrench in (
            (tau, dynamics.direct(tau).wrench.copy()),
            (dynamics.inverse(a).tau, dynamics.inverse(a).wrench),
        ):
            wrenches = dynamics.object_wrenches(a, wrench)
            moved = hand_torques(box_chain, q, v, a, wrenches.by_arm)
            np.testing.assert_allclose(moved, used, atol=1e-8)


@pytest.mark.parametrize("shares", SHARES)
def test_hands_need_not_bring_what_pushes_from_outside(
    box_chain: ClosedChain, states: list[Closed], shares: tuple[float, float]
) -> None:
    """With a push on the object each arm still feels the wrench of its hand and no more."""
    dynamics = ClosedLoopDynamics(box_chain, shares=shares)
    push = np.array([3.0, -2.0, 5.0, 0.1, 0.3, -0.2])
    for q, v in states[:10]:
        dynamics.update(q, v)
        tau = np.linspace(-1, 1, 10)
        result = dynamics.direct(tau + dynamics.J_object.T @ push)
        wrenches = dynamics.object_wrenches(result.a, result.wrench, push)
        alone = dynamics.object_wrenches(result.a, result.wrench).needed
        np.testing.assert_allclose(wrenches.needed + push, alone, atol=1e-12)
        np.testing.assert_allclose(wrenches.by_arm.sum(axis=0), wrenches.needed, atol=1e-9)
        moved = hand_torques(box_chain, q, v, result.a, wrenches.by_arm)
        np.testing.assert_allclose(moved, tau, atol=1e-8)


def test_hand_wrenches_do_not_depend_on_where_the_mass_is_counted(
    box_chain: ClosedChain, states: list[Closed]
) -> None:
    by_arm = []
    for shares in SHARES:
        dynamics = ClosedLoopDynamics(box_chain, shares=shares)
        dynamics.update(*states[4])
        result = dynamics.direct(np.linspace(-1, 1, 10))
        by_arm.append(dynamics.object_wrenches(result.a, result.wrench).by_arm)
    np.testing.assert_allclose(by_arm[1], by_arm[0], atol=1e-9)
    np.testing.assert_allclose(by_arm[2], by_arm[0], atol=1e-9)


def test_wrenches_of_three_arms_sum_to_what_the_object_needs() -> None:
    chain = ring(3, 6)
    shares = (0.2, 0.5, 0.3)
    dynamics, some = ClosedLoopDynamics(chain, shares=shares), closed_states(chain, 5)
    for (q, v), (tau, a) in zip(some, accelerations(dynamics, some), strict=True):
        dynamics.update(q, v)
        result = dynamics.direct(tau)
        wrenches = dynamics.object_wrenches(result.a, result.wrench)
        np.testing.assert_allclose(wrenches.by_arm.sum(axis=0), wrenches.needed, atol=1e-8)
        np.testing.assert_allclose(wrenches.internal.sum(axis=0), 0, atol=1e-8)
        moved = hand_torques(chain, q, v, a, wrenches.by_arm)
        np.testing.assert_allclose(moved, tau, atol=1e-7)


def test_object_at_rest_needs_its_weight_at_its_centre_of_mass(box_chain: ClosedChain) -> None:
    dynamics, still = ClosedLoopDynamics(box_chain), np.zeros(10)
    dynamics.update(box_chain.q_start, still)
    result = dynamics.inverse(still)
    wrenches = dynamics.object_wrenches(still, result.wrench)
    weight = np.array([0.0, 0.0, BOX.mass * 9.81])
    np.testing.assert_allclose(wrenches.needed[:3], weight, atol=1e-12)
    torque = np.cross(box_chain.object_pose(box_chain.q_start).rotation @ np.array(BOX.com), weight)
    np.testing.assert_allclose(wrenches.needed[3:], torque, atol=1e-12)
    assert dynamics.direct(result.tau).a == pytest.approx(0, abs=1e-9)
