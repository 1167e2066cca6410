"""The torque QP's wrenches of the hands: what is asked for, shared, levelled and refused."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import qpsolvers
from chains import HANDS, Hinge
from laws import problem
from pads import pressing

import coopqp
from coopqp.base.errors import GraspError, InvalidValueError
from coopqp.base.spec import Array
from coopqp.closed_loop.dynamics import ClosedLoopDynamics
from coopqp.closed_loop.grasp_matrix import section
from coopqp.controllers import TorqueQp
from coopqp.controllers.torque_qp import TorqueQpLaw
from coopqp.grasps import Rigid
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.grasp_configuration import HeldObject
from coopqp.model.profile import Profile
from coopqp.robot import RobotModel
from coopqp.solver import Status
from coopqp.task import Task
from coopqp.tasks import InternalWrench, PointOnPoint

COMPONENTS = ("squeeze", "shear_up", "shear_side", "twist", "bend_up", "bend_side")
G = 9.81  # [m/s2]


def decided(chain: ClosedChain, *wrenches: Task, **settings: Any) -> tuple[TorqueQpLaw, Array]:
    """A law after one tick at rest at the start, and h of its answer."""
    stay = PointOnPoint(goal=tuple(chain.start_position), gain=10.0)
    asked = problem(chain, stay, wrenches=wrenches, dt=0.002, kappa=50.0)
    law = TorqueQp(**settings).build(asked)
    assert isinstance(law, TorqueQpLaw)
    command = law.tick(law.start())
    assert command.status is Status.OPTIMAL
    return law, law.programs[-1].solution.v[law.layout.h].copy()


def components(law: TorqueQpLaw, h: Array) -> Array:
    return section(law.hands.points[0], law.hands.points[1]).of(h)


def test_wrenches_and_torques_are_those_of_the_arms_dynamics(box_of_nao: ClosedChain) -> None:
    """The arms without the object, by the wrenches on their hands: S' tau = A a + H + J' h."""
    law, h = decided(box_of_nao, InternalWrench(squeeze=4.0))
    x = law.solution.v
    arms = ClosedLoopDynamics(box_of_nao, mass_scale=0.0)
    arms.update(box_of_nao.q_start, np.zeros(box_of_nao.n))
    felt = np.zeros(box_of_nao.n)
    for i in range(2):
        part = slice(6 * i, 6 * i + 6)
        felt += arms.J_arms[part].T @ law.hands.G[:, part] @ h[part]
    tau = arms.A @ x[law.layout.a] + arms.H + felt
    assert np.allclose(tau, x[law.layout.tau], atol=1e-8)
    weight = box_of_nao.held.mass * G
    assert h.reshape(2, 6)[:, 2].sum() == pytest.approx(weight, rel=1e-3)


@pytest.mark.parametrize("mode", ["soft", "hard"])
@pytest.mark.parametrize("component", COMPONENTS)
def test_every_component_is_had_by_itself(
    component: str, mode: str, box_of_nao: ClosedChain
) -> None:
    task = InternalWrench(mode=mode, **{component: 0.2})
    law, h = decided(box_of_nao, task)
    found = components(law, h)[COMPONENTS.index(component)]
    assert found == pytest.approx(0.2, rel=0.01)


def test_all_six_at_once_are_had_hard(box_of_nao: ClosedChain) -> None:
    wanted = dict(zip(COMPONENTS, (3.0, 0.2, -0.1, 0.02, -0.03, 0.01), strict=True))
    law, h = decided(box_of_nao, InternalWrench(mode="hard", **wanted))
    assert np.allclose(components(law, h), list(wanted.values()), atol=1e-8)


def test_without_a_task_hands_hardly_squeeze(box_of_nao: ClosedChain) -> None:
    law, h = decided(box_of_nao)
    assert np.abs(law.hands.split.projector @ np.ravel(h)).max() < 0.05


def test_a_later_priority_gets_what_earlier_ones_leave(box_of_nao: ClosedChain) -> None:
    first = InternalWrench(name="first", squeeze=3.0)
    same = InternalWrench(name="same", squeeze=8.0, priority=1)
    other = InternalWrench(name="other", twist=0.05, priority=2)
    law, h = decided(box_of_nao, first, same, other)
    assert len(law.programs) == 3
    found = components(law, h)
    assert found[0] == pytest.approx(3.0, rel=0.01)  # what was decided first stays
    assert found[3] == pytest.approx(0.05, rel=0.05)


@pytest.mark.parametrize("split", ["walker", "virtual_inertia"])
@pytest.mark.parametrize("share", [0.5, 0.8])
def test_arms_share_the_load_as_they_are_told(
    share: float, split: Any, box_of_nao: ClosedChain
) -> None:
    _, h = decided(box_of_nao, shares={"right": share, "left": 1.0 - share}, split=split, grip=0.1)
    lift = h.reshape(2, 6)[:, 2]
    if split == "walker":  # torques of one hand on the other cost a virtual body less
        assert lift[0] / lift.sum() == pytest.approx(share, abs=0.02)
    else:
        assert (lift[0] / lift.sum() > 0.52) == (share > 0.5)


def test_an_arm_with_weaker_motors_gets_less_of_the_load(nao: RobotModel) -> None:
    firm = ClosedChain.attach(nao, nao.configuration(HANDS), Rigid(), HeldObject(mass=0.4))
    even, h_even = decided(firm, shares="motors", split="walker", grip=0.1)
    weak = nao.model.copy()
    for name in nao.joint_names:
        if name.startswith("R"):
            weak.effortLimit[weak.getJointId(name) - 1] *= 0.6
    weaker = ClosedChain.attach(
        replace(nao, model=weak), firm.q_start, Rigid(), HeldObject(mass=0.4)
    )
    _, h = decided(weaker, shares="motors", split="walker", grip=0.1)
    assert even.hands.shares[0] == pytest.approx(0.5, abs=1e-6)
    assert h[2] < 0.8 * h_even[2]


def test_hands_that_press_stay_in_their_cones(nao: RobotModel) -> None:
    firm = ClosedChain.attach(nao, nao.configuration(HANDS), Rigid(), HeldObject(mass=0.2))
    law, h = decided(pressing(firm, 0.2, 0.02))
    assert not law.solution.v[law.layout.sigma].any()
    assert (law.hands.cones @ h <= law.hands.upper + 1e-8).all()
    assert np.isclose(components(law, h)[0], 4.162, rtol=2e-3)


def test_cones_are_left_only_where_nothing_keeps_them(nao: RobotModel) -> None:
    """Friction would have to bear a fall's end: the law says so, and leaves them by little."""
    firm = ClosedChain.attach(nao, nao.configuration(HANDS), Rigid(), HeldObject(mass=0.5))
    chain = pressing(firm, 0.5, 0.02)
    x, y, z = chain.start_position
    asked = problem(
        chain,
        PointOnPoint(goal=(x, y, z + 0.05), gain=50.0, mode="hard", profile=Profile(kind="step")),
        dt=0.002,
        kappa=50.0,
    )
    law = TorqueQp(acceleration=5000.0).build(asked)
    command = law.tick(law.start())
    assert Status.TASKS_RELAXED in command.causes
    assert isinstance(law, TorqueQpLaw)
    assert (law.hands.cones @ law.solution.v[law.layout.h] <= law.hands.upper + 1e-6).all()


@pytest.mark.parametrize(
    ("task", "words"),
    [
        (InternalWrench(squeeze=60.0), "wants 60 N, but at rest at the start the hands can do"),
        (InternalWrench(squeeze=60.0, mode="hard"), "motor RShoulderRoll"),
    ],
)
def test_a_squeeze_beyond_the_motors_is_refused(
    task: Task, words: str, box_of_nao: ClosedChain
) -> None:
    with pytest.raises(InvalidValueError, match=words):
        decided(box_of_nao, task)


def test_squeeze_alone_is_refused_with_naos_hinges() -> None:
    """No component is free of the hinges: with all others zero none is left."""
    chain = coopqp.load("passive_grasp_pose").chain
    zero = dict.fromkeys(COMPONENTS[1:], 0.0)
    with pytest.raises(GraspError, match="cannot bear all hard wrenches together") as error:
        decided(chain, InternalWrench(squeeze=5.0, mode="hard", **zero))
    assert "internal_wrench" in str(error.value)
    law, h = decided(chain, InternalWrench(squeeze=5.0, mode="hard"))  # others free
    assert components(law, h)[0] == pytest.approx(5.0)


def test_a_safety_that_friction_does_not_give_is_refused(nao: RobotModel) -> None:
    firm = ClosedChain.attach(nao, nao.configuration(HANDS), Rigid(), HeldObject(mass=0.5))
    chain = pressing(firm, 0.5, 0.02)
    with pytest.raises(GraspError, match=r"with safety 3: the hands carry \d+ % of its weight"):
        decided(chain, safety=3.0)


def test_scaled_forces_and_motions_are_refused(box_of_nao: ClosedChain) -> None:
    with pytest.raises(ValueError, match="soft or hard, not scaled"):
        InternalWrench(squeeze=1.0, mode="scaled")
    with pytest.raises(ValueError, match="needs at least one of squeeze"):
        InternalWrench()
    stay = PointOnPoint(goal=(0.2, 0.0, 0.0), mode="scaled")
    with pytest.raises(InvalidValueError, match="soft or hard"):
        TorqueQp().build(problem(box_of_nao, stay, dt=0.002))


def test_shares_of_strangers_are_refused(box_of_nao: ClosedChain) -> None:
    for shares, words in (
        ({"right": 0.5, "lft": 0.5}, "did you mean 'left'"),
        ({"right": 0.5, "left": 0.6}, "sum to 1"),
    ):
        with pytest.raises(coopqp.CoopqpError, match=words):
            decided(box_of_nao, shares=shares)


@pytest.fixture(scope="module")
def box_of_nao(nao: RobotModel) -> ClosedChain:
    return ClosedChain.attach(nao, nao.configuration(HANDS), Rigid(), HeldObject(mass=0.2))


def test_hinges_transmit_no_torque_about_them(nao: RobotModel) -> None:
    """The QP's wrenches too: a passive joint has no motor."""
    chain = ClosedChain.attach(nao, nao.configuration(HANDS), Hinge(), HeldObject(mass=0.2))
    law, h = decided(chain, InternalWrench(squeeze=3.0))
    arms = ClosedLoopDynamics(chain, mass_scale=0.0)
    arms.update(chain.q_start, np.zeros(chain.n))
    felt = sum(
        arms.J_arms[6 * i : 6 * i + 6].T @ law.hands.G[:, 6 * i : 6 * i + 6] @ h[6 * i : 6 * i + 6]
        for i in range(2)
    )
    assert np.abs(np.asarray(felt)[chain.passive]).max() < 1e-6


def round_cones(law: TorqueQpLaw, edges: int = 24) -> tuple[Array, float]:
    """The same program with forces at the pads' corners in nearly round cones: h and its cost.

    Columns of corner forces stand for each hand's wrench instead of the 16 rows.
    """
    qp, layout = law.qp, law.layout
    keep, rays = np.arange(layout.h.start), []
    for i, hand in enumerate(law.hands.hands):
        assert hand.contact
        X, Y = hand.contact.half_lengths
        mu = hand.contact.friction / 1.5 / np.cos(np.pi / edges)  # around the round cone
        angles = 2.0 * np.pi * np.arange(edges) / edges
        f = np.array([mu * np.cos(angles), mu * np.sin(angles), np.ones(edges)])
        for x, y in ((X, Y), (X, -Y), (-X, Y), (-X, -Y)):
            w = np.vstack([f, [y * f[2], -x * f[2], x * f[1] - y * f[0]]])
            turned = law.start().R_WO @ hand.X_OC.rotation
            column = np.zeros((law.hands.size, edges))
            column[6 * i : 6 * i + 3] = turned @ w[:3]
            column[6 * i + 3 : 6 * i + 6] = turned @ w[3:]
            rays.append(column)
    to_h = np.hstack(rays)
    size = len(keep) + to_h.shape[1]
    T = np.zeros((qp.n, size))
    T[: len(keep), : len(keep)] = np.eye(len(keep))
    T[layout.h, len(keep) :] = to_h
    P = T.T @ qp.P @ T + 1e-9 * np.eye(size)
    lb = np.concatenate([np.maximum(qp.lb[keep], -1e6), np.zeros(to_h.shape[1])])
    ub = np.concatenate([np.minimum(qp.ub[keep], 1e6), np.full(to_h.shape[1], 1e6)])
    y = qpsolvers.solve_qp(P, T.T @ qp.q, None, None, qp.A @ T, qp.b, lb, ub, solver="quadprog")
    assert y is not None
    x = T @ y
    return x, float(0.5 * x @ qp.P @ x + qp.q @ x)


def test_the_inner_square_costs_no_more_than_it_says(nao: RobotModel) -> None:
    """Against corners in round cones: never cheaper, and at most sqrt(2) times the squeeze."""
    firm = ClosedChain.attach(nao, nao.configuration(HANDS), Rigid(), HeldObject(mass=0.2))
    law, h = decided(pressing(firm, 0.2, 0.02))
    own = law.solution.v
    cost = float(0.5 * own @ law.qp.P @ own + law.qp.q @ own)
    x, least = round_cones(law)
    assert least <= cost + 1e-9
    ratio = components(law, h)[0] / components(law, x[law.layout.h])[0]
    assert 1.0 < ratio <= np.sqrt(2.0) * 1.01
