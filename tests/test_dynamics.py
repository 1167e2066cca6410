"""Closed-loop dynamics against systems written out here, pinocchio's own, and Newton's laws."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
import scipy.linalg
from mujoco_model import MujocoChain
from numpy.typing import NDArray
from test_closed_chain import planar_pair, spherical_pair, three_arms

from coopqp.checked import Vector3, spec
from coopqp.closed_chain import ClosedChain
from coopqp.closed_loop.constraint_equations import constraint_equations
from coopqp.closed_loop.dynamics import ClosedLoopDynamics, Friction
from coopqp.errors import InvalidValueError, UnknownNameError
from coopqp.grasp import Grasp, PassiveJoint
from coopqp.grasps import Rigid
from coopqp.held_object import HeldObject
from coopqp.robot import Arm, RobotModel
from coopqp.robot_files import mdh
from coopqp.state import State

Array = NDArray[np.float64]
Closed = tuple[Array, Array]
"""q and v with all loops closed."""

STATES = 1000
STEP = 0.3  # size of a step of the random walk along the closed loops [rad]
H = 1e-4  # step of central differences in time [s]

#: A box whose weight is not in its middle.
BOX = HeldObject(
    mass=0.6, com=(0.01, -0.02, 0.03), inertia=(1.4e-3, 1e-4, -5e-5, 9e-4, 2e-4, 1.6e-3)
)

PAPER_SCHEME = ("RShoulderPitch", "RShoulderRoll", "RElbowYaw", "LShoulderRoll")  # q1 q2 q3 q7


@spec
class Hinge(Grasp):
    """A passive revolute joint through the hand; about the wrist's axis as in Table 2."""

    axis: Vector3 = (1.0, 0.0, 0.0)

    def passive_joints(self, *_: Array) -> tuple[PassiveJoint, ...]:
        joint = pin.JointModelRevoluteUnaligned(np.array(self.axis))
        return (PassiveJoint(name="hinge", joint=joint, placement=pin.SE3.Identity()),)


def closed_states(chain: ClosedChain, count: int, seed: int = 11) -> list[Closed]:
    """Random states inside the limits: a walk on the closed loops, velocities along them."""
    rng, state, found = np.random.default_rng(seed), State(chain), []
    while len(found) < count:
        before = state.q.copy()
        free = scipy.linalg.null_space(state.J_rel, rcond=1e-8)
        state.q += STEP * free @ rng.normal(size=free.shape[1])
        state.update()
        state.close_loops(6)
        inside = np.all((chain.lower < state.q) & (state.q < chain.upper))
        if inside and np.abs(state.loop_error).max() < 1e-13:
            free = scipy.linalg.null_space(state.J_rel, rcond=1e-8)
            found.append((state.q.copy(), free @ rng.normal(size=free.shape[1])))
        else:
            state.q[:] = before
            state.update()
    return found


@pytest.fixture(scope="module")
def box_chain(nao: RobotModel, chain: ClosedChain) -> ClosedChain:
    """NAO holds a box whose weight is not in its middle."""
    return ClosedChain(nao, chain.q_start, Rigid(), BOX)


@pytest.fixture(scope="module")
def hinged(nao: RobotModel, chain: ClosedChain) -> ClosedChain:
    """The same box between two hinges: Table 2 of the paper."""
    return ClosedChain(nao, chain.q_start, Hinge(), BOX)


@pytest.fixture(scope="module")
def states(box_chain: ClosedChain) -> list[Closed]:
    return closed_states(box_chain, STATES)


@pytest.fixture(scope="module")
def hinged_states(hinged: ClosedChain) -> list[Closed]:
    return closed_states(hinged, 20)


def inertia_of(held: HeldObject) -> Array:
    """As given, or that of a solid box."""
    if held.inertia is None:
        squares = np.square(held.size)
        return np.asarray(held.mass / 12 * np.diag(squares.sum() - squares))
    xx, xy, xz, yy, yz, zz = held.inertia
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def with_mass(chain: ClosedChain, shares: dict[int, float]) -> pin.Model:
    """The tree with shares of the object's mass as bodies of their own, written out."""
    model, held = chain.model.copy(), chain.held
    about_com = inertia_of(held)
    for arm, share in shares.items():
        frame = chain.model.frames[chain.frames[arm]]
        body = pin.Inertia(share * held.mass, np.array(held.com), share * about_com)
        model.appendBodyToJoint(frame.parentJoint, body, frame.placement)
    return model


class Oracle:
    """The terms of the closed chain from pinocchio's local Jacobians and their time variation."""

    def __init__(self, chain: ClosedChain, arm: int = 0) -> None:
        self.frames, self.model = chain.frames, with_mass(chain, {arm: 1.0})
        self.data = self.model.createData()

    def update(self, q: Array, v: Array) -> None:
        """A, H, J and Jdot v with the rows in the object's own axes."""
        model, data, local = self.model, self.data, pin.LOCAL
        self.H = pin.rnea(model, data, q, v, np.zeros_like(v))
        self.A = pin.crba(model, data, q).copy()
        pin.computeJointJacobiansTimeVariation(model, data, q, v)
        pin.updateFramePlacements(model, data)
        J = [pin.getFrameJacobian(model, data, f, local) for f in self.frames]
        dJ = [pin.getFrameJacobianTimeVariation(model, data, f, local) for f in self.frames]
        self.J = np.vstack([J_i - J[0] for J_i in J[1:]])
        self.drift = np.concatenate([(dJ_i - dJ[0]) @ v for dJ_i in dJ[1:]])

    def by_projection(self, tau: Array) -> Array:
        """Accelerations N y + a_0 with N' A N y = N' (tau - H - A a_0)."""
        N = scipy.linalg.null_space(self.J, rcond=1e-8)
        a_0 = -np.linalg.lstsq(self.J, self.drift, rcond=1e-8)[0]
        rest = tau - self.H - self.A @ a_0
        return a_0 + N @ np.linalg.solve(N.T @ self.A @ N, N.T @ rest)

    def by_kkt(self, tau: Array) -> Array:
        """Accelerations from the whole system with multipliers."""
        rows = len(self.drift)
        K = np.block([[self.A, self.J.T], [self.J, np.zeros((rows, rows))]])
        x = np.linalg.solve(K, np.concatenate([tau - self.H, -self.drift]))
        return np.asarray(x[: len(tau)])


class PinocchioOracle:
    """pinocchio's own constrained forward dynamics, one 6D contact between the arms' objects."""

    def __init__(self, chain: ClosedChain) -> None:
        self.model = with_mass(chain, {0: 1.0})
        self.data = self.model.createData()
        first, second = (chain.model.frames[f] for f in chain.frames)
        contact = pin.RigidConstraintModel(
            pin.ContactType.CONTACT_6D, self.model, first.parentJoint, first.placement,
            second.parentJoint, second.placement, pin.LOCAL,
        )  # fmt: skip
        self.contacts, self.contact_data = (
            pin.StdVec_RigidConstraintModel([contact]),
            pin.StdVec_RigidConstraintData([contact.createData()]),
        )
        self.settings = pin.ProximalSettings(1e-14, 0.0, 10)
        pin.initConstraintDynamics(self.model, self.data, self.contacts, self.contact_data)

    def acceleration(self, q: Array, v: Array, tau: Array) -> Array:
        a = pin.constraintDynamics(
            self.model, self.data, q, v, tau, self.contacts, self.contact_data, self.settings
        )
        return np.array(a)


def relative(found: Array, true: Array) -> float:
    return float(np.linalg.norm(found - true) / np.linalg.norm(true))


def accelerations(
    dynamics: ClosedLoopDynamics, states: list[Closed], seed: int = 5
) -> list[tuple[Array, Array]]:
    """Random torques of the actuated joints and the accelerations they cause, in each state."""
    rng, found = np.random.default_rng(seed), []
    for q, v in states:
        tau = np.zeros(len(q))
        tau[dynamics.actuated] = rng.normal(size=len(dynamics.actuated))
        dynamics.update(q, v)
        found.append((tau, dynamics.direct(tau).a.copy()))
    return found


def test_random_states_are_closed(box_chain: ClosedChain, states: list[Closed]) -> None:
    data = box_chain.model.createData()
    for q, v in states:
        pin.framesForwardKinematics(box_chain.model, data, q)
        right, left = (data.oMf[frame] for frame in box_chain.frames)
        assert right.isApprox(left, 1e-12)
        np.testing.assert_allclose(box_chain.loop_jacobian(q) @ v, 0, atol=1e-12)


def test_direct_model_solves_the_kkt_system(box_chain: ClosedChain, states: list[Closed]) -> None:
    oracle, worst = Oracle(box_chain), 0.0
    found = accelerations(ClosedLoopDynamics(box_chain), states)
    for (q, v), (tau, a) in zip(states, found, strict=True):
        oracle.update(q, v)
        worst = max(worst, relative(a, oracle.by_kkt(tau)))
    assert worst <= 1e-9


def test_direct_model_is_the_projection_on_the_free_motions(
    box_chain: ClosedChain, states: list[Closed]
) -> None:
    oracle, worst = Oracle(box_chain), 0.0
    found = accelerations(ClosedLoopDynamics(box_chain), states)
    for (q, v), (tau, a) in zip(states, found, strict=True):
        oracle.update(q, v)
        worst = max(worst, relative(a, oracle.by_projection(tau)))
    assert worst <= 1e-9


def test_direct_model_agrees_with_pinocchios_constraint_dynamics(
    box_chain: ClosedChain, states: list[Closed]
) -> None:
    oracle, worst = PinocchioOracle(box_chain), 0.0
    found = accelerations(ClosedLoopDynamics(box_chain), states)
    for (q, v), (tau, a) in zip(states, found, strict=True):
        worst = max(worst, relative(a, oracle.acceleration(q, v, tau)))
    assert worst <= 1e-9


def test_inverse_model_undoes_the_direct_model_at_every_state(
    box_chain: ClosedChain, states: list[Closed]
) -> None:
    """Ten motors, four freedoms: not the same torques, but the same push along the free motions."""
    dynamics = ClosedLoopDynamics(box_chain)
    for (q, v), (tau, a) in zip(states, accelerations(dynamics, states), strict=True):
        dynamics.update(q, v)
        result = dynamics.inverse(a)
        N = scipy.linalg.null_space(box_chain.loop_jacobian(q))
        np.testing.assert_allclose(N.T @ result.tau, N.T @ tau, atol=1e-9)
        assert not result.singular


def test_redundant_torques_are_the_least_of_all_that_cause_the_motion(
    box_chain: ClosedChain, states: list[Closed]
) -> None:
    dynamics = ClosedLoopDynamics(box_chain)
    some = states[:50]
    for (q, v), (tau, a) in zip(some, accelerations(dynamics, some), strict=True):
        dynamics.update(q, v)
        found = dynamics.inverse(a).tau
        N = scipy.linalg.null_space(box_chain.loop_jacobian(q))
        np.testing.assert_allclose(found, np.linalg.pinv(N.T) @ (N.T @ tau), atol=1e-9)


@pytest.mark.parametrize("count", [5, 7])
def test_least_torques_of_some_motors(
    box_chain: ClosedChain, states: list[Closed], count: int, rng: np.random.Generator
) -> None:
    """Every other distribution over the same motors is the found one plus squeeze, and larger."""
    motors = list(rng.permutation(box_chain.n)[:count])
    names = [box_chain.joint_names[i] for i in motors]
    dynamics = ClosedLoopDynamics(box_chain, actuated=names)
    some = states[:20]
    for (q, v), (tau, a) in zip(some, accelerations(dynamics, some), strict=True):
        dynamics.update(q, v)
        found = dynamics.inverse(a).tau
        idle = np.setdiff1d(np.arange(box_chain.n), motors)
        np.testing.assert_array_equal(found[idle], 0)
        N = scipy.linalg.null_space(box_chain.loop_jacobian(q))
        np.testing.assert_allclose(N.T @ found, N.T @ tau, atol=1e-8)
        squeeze = scipy.linalg.null_space(N[motors].T)
        np.testing.assert_allclose(squeeze.T @ found[motors], 0, atol=1e-8)
        assert np.linalg.norm(found) <= np.linalg.norm(tau) + 1e-9


def test_redundant_actuation_follows_equation_27(
    box_chain: ClosedChain, states: list[Closed]
) -> None:
    names = [*PAPER_SCHEME, "RWristYaw", "LElbowYaw", "LWristYaw"]
    dynamics = ClosedLoopDynamics(box_chain, actuated=names)
    motors = [box_chain.joint_names.index(name) for name in names]
    for q, v in states[:50]:
        equations = constraint_equations(box_chain, q, v, actuated=PAPER_SCHEME)
        if equations.condition > 1e4:
            continue
        a = equations.motion @ [0.3, -2.0, 1.0, 0.7] + equations.drift
        dynamics.update(q, v)
        Gamma = dynamics.A @ a + dynamics.H
        tau_a = equations.motion.T @ Gamma
        spread = np.linalg.pinv(equations.motion[motors].T)  # [I, dq_r/dq_a']^+
        np.testing.assert_allclose(dynamics.inverse(a).tau[motors], spread @ tau_a, atol=1e-9)


def test_as_many_motors_as_freedoms_follow_equation_23(
    box_chain: ClosedChain, states: list[Closed]
) -> None:
    """The torques are [I G'] Gamma of the tree and no choice is left."""
    dynamics = ClosedLoopDynamics(box_chain, actuated=PAPER_SCHEME)
    oracle, regular = Oracle(box_chain), 0
    for q, v in states[:100]:
        equations = constraint_equations(box_chain, q, v, actuated=PAPER_SCHEME)
        if equations.condition > 1e4:
            continue
        regular += 1
        a = equations.motion @ [0.3, -2.0, 1.0, 0.7] + equations.drift
        oracle.update(q, v)
        Gamma = oracle.A @ a + oracle.H
        a_and_c = list(equations.actuated)
        tau = Gamma[a_and_c] + equations.G.T @ Gamma[list(equations.passive)]
        tau += equations.G_cut.T @ Gamma[list(equations.cut)]
        dynamics.update(q, v)
        result = dynamics.inverse(a)
        np.testing.assert_allclose(result.tau[a_and_c], tau, rtol=1e-8, atol=1e-8)
        assert not result.singular
    assert regular > 50


def test_papers_scheme_at_the_mirror_symmetric_start_is_called_singular(
    box_chain: ClosedChain, chain: ClosedChain
) -> None:
    """Its motors cannot make every motion there, and the answer says how much stays undone."""
    dynamics = ClosedLoopDynamics(box_chain, actuated=PAPER_SCHEME)
    still = np.zeros(10)
    dynamics.update(chain.q_start, still)
    N = scipy.linalg.null_space(box_chain.loop_jacobian(chain.q_start))
    result = dynamics.inverse(N @ np.array([3.0, -1.0, 2.0, 4.0]))
    assert result.singular
    assert result.residual > 1e-3
    everyone = ClosedLoopDynamics(box_chain)
    everyone.update(chain.q_start, still)
    assert not everyone.inverse(still).singular
    assert not everyone.direct(still).singular


def test_residual_of_a_singular_scheme_is_what_the_motors_leave_undone(
    box_chain: ClosedChain, chain: ClosedChain
) -> None:
    """The tree's equation with the found torques and wrench is off by the residual."""
    dynamics = ClosedLoopDynamics(box_chain, actuated=PAPER_SCHEME)
    dynamics.update(chain.q_start, np.zeros(10))
    N = scipy.linalg.null_space(box_chain.loop_jacobian(chain.q_start))
    a = N @ np.array([3.0, -1.0, 2.0, 4.0])
    result = dynamics.inverse(a)
    left = dynamics.A @ a + dynamics.H - result.tau - dynamics.J.T @ result.wrench
    assert np.abs(left).max() == pytest.approx(result.residual, rel=1e-9)


def test_regular_answer_leaves_no_residual(box_chain: ClosedChain, states: list[Closed]) -> None:
    dynamics = ClosedLoopDynamics(box_chain)
    for (q, v), (_, a) in zip(states[:20], accelerations(dynamics, states[:20]), strict=True):
        dynamics.update(q, v)
        result = dynamics.inverse(a)
        assert result.residual == 0.0
        left = dynamics.A @ a + dynamics.H - result.tau - dynamics.J.T @ result.wrench
        np.testing.assert_allclose(left, 0, atol=1e-9)


def test_terms_do_not_depend_on_what_was_computed_before(
    box_chain: ClosedChain, states: list[Closed]
) -> None:
    """Reused arrays keep nothing of another state."""
    used = ClosedLoopDynamics(box_chain)
    accelerations(used, states[:5])
    q, v = states[7]
    fresh = ClosedLoopDynamics(box_chain)
    tau = np.linspace(-1, 1, 10)
    for dynamics in (used, fresh):
        dynamics.update(q, v)
    np.testing.assert_array_equal(used.direct(tau).a, fresh.direct(tau).a)
    np.testing.assert_array_equal(used.inverse(tau).tau, fresh.inverse(tau).tau)


SHARES = ({"right": 1.0}, {"left": 1.0}, {"right": 0.5, "left": 0.5})


def test_accelerations_do_not_depend_on_which_hand_carries_the_mass(
    hinged: ClosedChain, hinged_states: list[Closed]
) -> None:
    """A link without mass behind a passive joint makes the tree's inertia singular, no more."""
    results = []
    for shares in SHARES:
        dynamics = ClosedLoopDynamics(hinged, shares=shares)
        results.append([a for _, a in accelerations(dynamics, hinged_states)])
    for one, other in itertools.combinations(results, 2):
        for a, b in zip(one, other, strict=True):
            assert relative(a, b) < 1e-9
    dynamics = ClosedLoopDynamics(hinged)
    dynamics.update(*hinged_states[0])
    singular = np.linalg.eigvalsh(dynamics.A)[0] / np.linalg.eigvalsh(dynamics.A)[-1]
    assert abs(singular) < 1e-12


def test_a_massless_link_agrees_with_the_projection(
    hinged: ClosedChain, hinged_states: list[Closed]
) -> None:
    found = accelerations(ClosedLoopDynamics(hinged), hinged_states)
    for arm in (0, 1):
        oracle = Oracle(hinged, arm)
        for (q, v), (tau, a) in zip(hinged_states, found, strict=True):
            oracle.update(q, v)
            assert relative(a, oracle.by_projection(tau)) < 1e-9


@pytest.mark.parametrize("shares", SHARES)
def test_inverse_model_with_hinges_leaves_them_without_torque(
    hinged: ClosedChain, hinged_states: list[Closed], shares: dict[str, float]
) -> None:
    dynamics = ClosedLoopDynamics(hinged, shares=shares)
    found = accelerations(dynamics, hinged_states)
    for (q, v), (tau, a) in zip(hinged_states, found, strict=True):
        dynamics.update(q, v)
        result = dynamics.inverse(a)
        N = scipy.linalg.null_space(hinged.loop_jacobian(q))
        np.testing.assert_array_equal(result.tau[hinged.passive], 0)
        np.testing.assert_allclose(N.T @ result.tau, N.T @ tau, atol=1e-9)
        motors = dynamics.actuated
        least = np.linalg.pinv(N[motors].T) @ (N.T @ tau)
        np.testing.assert_allclose(result.tau[motors], least, atol=1e-8)


def test_hands_with_hinges_exert_no_moment_about_them(
    hinged: ClosedChain, hinged_states: list[Closed]
) -> None:
    """Whoever carries the mass, a hinge passes no moment about its axis."""
    data = hinged.model.createData()
    for shares in SHARES:
        dynamics = ClosedLoopDynamics(hinged, shares=shares)
        for q, v in hinged_states:
            dynamics.update(q, v)
            result = dynamics.direct(np.zeros(hinged.n))
            wrenches = dynamics.object_wrenches(result.a, result.wrench)
            pin.framesForwardKinematics(hinged.model, data, q)
            for i, joint in enumerate(hinged.passive):
                hinge, origin = data.oMi[int(joint) + 1], data.oMf[hinged.frames[i]].translation
                force, torque = wrenches.by_arm[i, :3], wrenches.by_arm[i, 3:]
                moment = torque - np.cross(hinge.translation - origin, force)
                assert abs(moment @ hinge.rotation[:, 0]) < 1e-9


def test_redundant_loop_rows_do_no_harm(rng: np.random.Generator) -> None:
    """In the plane three of six loop rows follow from the others."""
    chain = heavy(planar_pair())
    dynamics, oracle = ClosedLoopDynamics(chain), Oracle(chain)
    some = closed_states(chain, 20)
    for (q, v), (tau, a) in zip(some, accelerations(dynamics, some), strict=True):
        oracle.update(q, v)
        assert relative(a, oracle.by_projection(tau)) < 1e-9
        dynamics.update(q, v)
        direct, inverse = dynamics.direct(tau), dynamics.inverse(a)
        assert not direct.singular
        assert not inverse.singular
        N = scipy.linalg.null_space(oracle.J, rcond=1e-8)
        np.testing.assert_allclose(inverse.tau, np.linalg.pinv(N.T) @ N.T @ tau, atol=1e-9)


def test_loop_rows_whose_dependence_varies_do_no_harm() -> None:
    """The multipliers are not unique, the accelerations are."""
    chain = heavy(spherical_pair())
    assert chain.loops.varying
    dynamics, oracle = ClosedLoopDynamics(chain), Oracle(chain)
    some = closed_states(chain, 10)
    for (q, v), (tau, a) in zip(some, accelerations(dynamics, some), strict=True):
        oracle.update(q, v)
        assert relative(a, oracle.by_projection(tau)) < 1e-8
        dynamics.update(q, v)
        N = scipy.linalg.null_space(oracle.J, rcond=1e-8)
        result = dynamics.inverse(a)
        np.testing.assert_allclose(result.tau, np.linalg.pinv(N.T) @ N.T @ tau, atol=1e-8)
        assert result.residual < 1e-9


def test_regular_state_of_varying_loop_rows_is_not_called_singular() -> None:
    chain = heavy(spherical_pair())
    dynamics, (q, v) = ClosedLoopDynamics(chain), closed_states(chain, 1)[0]
    dynamics.update(q, v)
    direct = dynamics.direct(np.ones(6))
    assert not direct.singular
    assert not dynamics.inverse(direct.a.copy()).singular


def heavy(chain: ClosedChain) -> ClosedChain:
    """The same chain with links that weigh something and a box in its hands."""
    model = chain.robot.model.copy()
    for joint in range(1, model.njoints):
        model.inertias[joint] = pin.Inertia(
            0.4 + 0.1 * joint, np.array([0.1, 0.01, 0.02]), np.diag([1e-3, 2e-3, 2.5e-3])
        )
    robot = replace(chain.robot, model=model)
    return ClosedChain(robot, chain.q_start, chain.grasps, BOX)


def small_arm(name: str, base: mdh.MdhParameters, joints: int) -> list[mdh.MdhRow]:
    """Alternating axes, ten centimetres between every second pair of them."""
    link = mdh.Link(mass=0.1, com=(0.02, 0.01, 0.03), inertia=(3e-4, 1e-5, 0, 2e-4, 0, 2.5e-4))
    rows: list[mdh.MdhRow] = []
    for i in range(joints):
        turn = mdh.MdhParameters(alpha=(-1) ** i * math.pi / 2, r=0.1 * (i % 2))
        rows.append(
            mdh.MdhRow(
                name=f"{name}{i + 1}", antecedent=rows[-1].name if rows else None,
                parameters=turn if rows else base, lower=-3.0, upper=3.0, velocity=5.0,
                effort=2.0, link=link,
            )
        )  # fmt: skip
    return rows


def ring(arms: int, joints: int) -> ClosedChain:
    """Small arms on a circle around the object they hold."""
    names = "abcdefgh"[:arms]
    tables = {
        name: small_arm(name, mdh.MdhParameters(gamma=2 * math.pi * i / arms, d=0.2), joints)
        for i, name in enumerate(names)
    }
    tips = {f"{n}_tip": mdh.Tip(parent=t[-1].name, offset=(0.05, 0, 0)) for n, t in tables.items()}
    model = mdh.build_model("ring", [row for t in tables.values() for row in t], tips)
    robot = RobotModel(
        name="ring", model=model, arms=tuple(Arm(name=n, tip=f"{n}_tip") for n in names)
    )
    q = np.tile(np.linspace(0.4, 0.9, joints), arms) * np.resize([1.0, -0.7, 1.3], arms * joints)
    return ClosedChain(robot, q, Rigid(), BOX)


@pytest.mark.parametrize("build", [lambda: ring(3, 6), lambda: ring(4, 7), three_arms])
def test_three_and_four_arms(build: Callable[[], ClosedChain]) -> None:
    chain = build()
    chain = ClosedChain(chain.robot, chain.q_start, chain.grasps, BOX)
    shares = {arm.name: 1 / len(chain.arms) for arm in chain.arms}
    first, even = ClosedLoopDynamics(chain), ClosedLoopDynamics(chain, shares=shares)
    oracle, some = Oracle(chain, arm=2), closed_states(chain, 8)
    for (q, v), (tau, a) in zip(some, accelerations(first, some), strict=True):
        oracle.update(q, v)
        assert relative(a, oracle.by_projection(tau)) < 1e-9
        first.update(q, v)
        even.update(q, v)
        assert relative(even.direct(tau).a, a) < 1e-9
        N = scipy.linalg.null_space(oracle.J)
        least = np.linalg.pinv(N.T) @ (N.T @ tau)
        np.testing.assert_allclose(first.inverse(a).tau, least, atol=1e-8)
        np.testing.assert_allclose(even.inverse(a).tau, least, atol=1e-8)


@pytest.mark.parametrize("friction", [Friction(viscous=0.3), Friction(coulomb=0.2, smoothing=0.05)])
def test_friction_takes_power_and_never_gives_it(
    box_chain: ClosedChain, states: list[Closed], friction: Friction
) -> None:
    smooth, rough = ClosedLoopDynamics(box_chain), ClosedLoopDynamics(box_chain, friction=friction)
    for q, v in states[:100]:
        smooth.update(q, v)
        rough.update(q, v)
        force = rough.H - smooth.H
        assert np.all(force * v >= 0)
        assert force @ v > 0
        tau = np.zeros(10)
        slower, faster = rough.direct(tau).a.copy(), smooth.direct(tau).a.copy()
        # The change of kinetic energy, v' A a, is less by the power of friction.
        assert v @ smooth.A @ (slower - faster) == pytest.approx(-force @ v, rel=1e-8)


def test_friction_is_viscous_plus_coulomb(box_chain: ClosedChain, states: list[Closed]) -> None:
    q, v = states[3]
    friction = Friction(viscous=0.3, coulomb=0.2, smoothing=0.05)
    rough, smooth = ClosedLoopDynamics(box_chain, friction=friction), ClosedLoopDynamics(box_chain)
    for dynamics in (rough, smooth):
        dynamics.update(q, v)
    expected = 0.3 * v + 0.2 * np.tanh(v / 0.05)
    np.testing.assert_allclose(rough.H - smooth.H, expected, atol=1e-12)
    for dynamics in (rough, smooth):
        dynamics.update(q, 0 * v)
    np.testing.assert_array_equal(rough.H, smooth.H)  # nothing slides


def test_power_of_the_motors_and_of_gravity_becomes_kinetic_energy(
    box_chain: ClosedChain, states: list[Closed]
) -> None:
    """d/dt of both energies, by differences along the motion, is the power of the torques."""
    dynamics = ClosedLoopDynamics(box_chain)
    some = states[:30]
    for (q, v), (tau, a) in zip(some, accelerations(dynamics, some), strict=True):
        energy = [
            dynamics.kinetic_energy(q + h * v + 0.5 * h * h * a, v + h * a)
            + dynamics.potential_energy(q + h * v + 0.5 * h * h * a)
            for h in (-0.1 * H, 0.1 * H)
        ]
        assert (energy[1] - energy[0]) / (0.2 * H) == pytest.approx(tau @ v, rel=1e-4, abs=1e-5)


def object_motion(chain: ClosedChain, q: Array, v: Array, a: Array) -> tuple[Array, Array, Array]:
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
    return force, torque, now.rotation


@pytest.mark.parametrize("shares", SHARES)
def test_wrench_on_the_object_is_what_its_motion_needs(
    box_chain: ClosedChain, states: list[Closed], shares: dict[str, float]
) -> None:
    dynamics = ClosedLoopDynamics(box_chain, shares=shares)
    some = states[:20]
    for (q, v), (tau, a) in zip(some, accelerations(dynamics, some), strict=True):
        dynamics.update(q, v)
        result = dynamics.direct(tau)
        wrenches = dynamics.object_wrenches(result.a, result.wrench)
        force, torque, rotation = object_motion(box_chain, q, v, a)
        size = np.linalg.norm(a)
        np.testing.assert_allclose(wrenches.needed[:3], force, atol=1e-5 * size)
        np.testing.assert_allclose(wrenches.needed[3:], torque, atol=1e-5 * size)
        np.testing.assert_allclose(wrenches.rotation, rotation, atol=1e-12)
        np.testing.assert_allclose(wrenches.by_arm.sum(axis=0), wrenches.needed, atol=1e-9)
        np.testing.assert_allclose(wrenches.internal.sum(axis=0), 0, atol=1e-9)


@pytest.mark.parametrize("shares", SHARES)
def test_each_arm_feels_the_wrench_of_its_hand(
    box_chain: ClosedChain, states: list[Closed], shares: dict[str, float]
) -> None:
    """The arms without the object obey A a + H = tau - sum J_i' wrench_i."""
    dynamics, bare = ClosedLoopDynamics(box_chain, shares=shares), box_chain.model
    data = bare.createData()
    some = states[:20]
    for (q, v), (tau, a) in zip(some, accelerations(dynamics, some), strict=True):
        dynamics.update(q, v)
        for used, wrench in (
            (tau, dynamics.direct(tau).wrench.copy()),
            (dynamics.inverse(a).tau, dynamics.inverse(a).wrench),
        ):
            wrenches = dynamics.object_wrenches(a, wrench)
            moved = pin.rnea(bare, data, q, v, a)
            pin.computeJointJacobians(bare, data, q)
            pin.updateFramePlacements(bare, data)
            for frame, by_hand in zip(box_chain.frames, wrenches.by_arm, strict=True):
                J = pin.getFrameJacobian(bare, data, frame, pin.LOCAL_WORLD_ALIGNED)
                moved = moved + J.T @ by_hand
            np.testing.assert_allclose(moved, used, atol=1e-8)


@pytest.mark.parametrize("shares", SHARES)
def test_hands_need_not_bring_what_pushes_from_outside(
    box_chain: ClosedChain, states: list[Closed], shares: dict[str, float]
) -> None:
    """With a push on the object each arm still feels the wrench of its hand and no more."""
    dynamics, bare = ClosedLoopDynamics(box_chain, shares=shares), box_chain.model
    data, push = bare.createData(), np.array([3.0, -2.0, 5.0, 0.1, 0.3, -0.2])
    for q, v in states[:10]:
        dynamics.update(q, v)
        tau = np.linspace(-1, 1, 10)
        result = dynamics.direct(tau + dynamics.J_object.T @ push)
        wrenches = dynamics.object_wrenches(result.a, result.wrench, push)
        alone = dynamics.object_wrenches(result.a, result.wrench).needed
        np.testing.assert_allclose(wrenches.needed + push, alone, atol=1e-12)
        np.testing.assert_allclose(wrenches.by_arm.sum(axis=0), wrenches.needed, atol=1e-9)
        moved = pin.rnea(bare, data, q, v, result.a)
        pin.computeJointJacobians(bare, data, q)
        pin.updateFramePlacements(bare, data)
        for frame, by_hand in zip(box_chain.frames, wrenches.by_arm, strict=True):
            J = pin.getFrameJacobian(bare, data, frame, pin.LOCAL_WORLD_ALIGNED)
            moved = moved + J.T @ by_hand
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
    shares = {"a": 0.2, "b": 0.5, "c": 0.3}
    dynamics, bare = ClosedLoopDynamics(chain, shares=shares), chain.model
    data, some = bare.createData(), closed_states(chain, 5)
    for (q, v), (tau, a) in zip(some, accelerations(dynamics, some), strict=True):
        dynamics.update(q, v)
        result = dynamics.direct(tau)
        wrenches = dynamics.object_wrenches(result.a, result.wrench)
        np.testing.assert_allclose(wrenches.by_arm.sum(axis=0), wrenches.needed, atol=1e-8)
        np.testing.assert_allclose(wrenches.internal.sum(axis=0), 0, atol=1e-8)
        moved = pin.rnea(bare, data, q, v, a)
        pin.computeJointJacobians(bare, data, q)
        pin.updateFramePlacements(bare, data)
        for frame, wrench in zip(chain.frames, wrenches.by_arm, strict=True):
            J = pin.getFrameJacobian(bare, data, frame, pin.LOCAL_WORLD_ALIGNED)
            moved = moved + J.T @ wrench
        np.testing.assert_allclose(moved, tau, atol=1e-7)


def test_object_at_rest_needs_its_weight_at_its_centre_of_mass(box_chain: ClosedChain) -> None:
    dynamics, still = ClosedLoopDynamics(box_chain), np.zeros(10)
    dynamics.update(box_chain.q_start, still)
    result = dynamics.inverse(still)
    wrenches = dynamics.object_wrenches(still, result.wrench)
    weight = np.array([0.0, 0.0, BOX.mass * 9.81])
    np.testing.assert_allclose(wrenches.needed[:3], weight, atol=1e-12)
    torque = np.cross(wrenches.rotation @ np.array(BOX.com), weight)
    np.testing.assert_allclose(wrenches.needed[3:], torque, atol=1e-12)
    assert dynamics.direct(result.tau).a == pytest.approx(0, abs=1e-9)


@pytest.fixture(scope="module", params=["rigid", "hinged"])
def held(
    request: pytest.FixtureRequest, box_chain: ClosedChain, hinged: ClosedChain
) -> tuple[ClosedChain, MujocoChain]:
    pytest.importorskip("mujoco")
    chain = box_chain if request.param == "rigid" else hinged
    return chain, MujocoChain(chain)


def test_holding_torques_are_those_of_mujoco(held: tuple[ClosedChain, MujocoChain]) -> None:
    """Least torques that do the virtual work of gravity along MuJoCo's own closed-loop motions."""
    chain, twin = held
    dynamics, still = ClosedLoopDynamics(chain), np.zeros(chain.n)
    for q in [chain.q_start, *(q for q, _ in closed_states(chain, 20))]:
        dynamics.update(q, still)
        tau = dynamics.inverse(still).tau
        work = twin.gravity_work(q)  # along the columns of motions
        np.testing.assert_allclose(work.motions.T @ tau, work.done, rtol=1e-6, atol=1e-7)
        motors = dynamics.actuated
        least = np.linalg.pinv(work.motions[motors].T) @ work.done
        np.testing.assert_allclose(tau[motors], least, rtol=1e-5, atol=1e-6)


def test_torques_for_a_motion_are_those_of_mujoco(
    held: tuple[ClosedChain, MujocoChain], rng: np.random.Generator
) -> None:
    """At speed too: MuJoCo's bias forces and inertia, along its own closed-loop motions."""
    chain, twin = held
    dynamics = ClosedLoopDynamics(chain)
    for q, v in closed_states(chain, 20):
        dynamics.update(q, v)
        N = dynamics.null_space()
        a = 5.0 * N @ rng.normal(size=N.shape[1]) - np.linalg.pinv(dynamics.J) @ dynamics.drift
        tau = dynamics.inverse(a).tau
        work = twin.work(q, v, a)
        np.testing.assert_allclose(work.motions.T @ tau, work.done, rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize(
    ("shares", "message"),
    [
        ({"right": 0.5}, "needs shares that sum to 1"),
        ({"right": 1.5, "left": -0.5}, "needs shares that sum to 1"),
        ({}, "needs shares that sum to 1"),
        pytest.param(
            {"right": math.nan, "left": 1.0},
            "needs shares that sum to 1",
        ),
    ],
)
def test_shares_that_are_none(chain: ClosedChain, shares: dict[str, float], message: str) -> None:
    with pytest.raises(InvalidValueError, match=message):
        ClosedLoopDynamics(chain, shares=shares)


def test_share_of_an_unknown_arm(chain: ClosedChain) -> None:
    with pytest.raises(UnknownNameError, match="did you mean 'right'"):
        ClosedLoopDynamics(chain, shares={"rigth": 1.0})


@pytest.mark.parametrize(
    ("actuated", "message"),
    [
        (["RShoulderPitch", "RElbowYaw", "LElbowYaw"], "3 joints cannot drive 4 degrees"),
        ([], "0 joints cannot drive 4 degrees"),
        (["RElbowYaw", "RElbowYaw", "LElbowYaw", "LWristYaw"], "RElbowYaw given more than once"),
    ],
)
def test_actuated_joints_that_are_no_choice(
    chain: ClosedChain, actuated: list[str], message: str
) -> None:
    with pytest.raises(InvalidValueError, match=message):
        ClosedLoopDynamics(chain, actuated=actuated)


def test_unknown_actuated_joint(chain: ClosedChain) -> None:
    with pytest.raises(UnknownNameError, match="did you mean 'RElbowYaw'"):
        ClosedLoopDynamics(chain, actuated=["RElbowYwa", "RElbowRoll", "LElbowYaw", "LWristYaw"])


def test_passive_joint_has_no_motor(hinged: ClosedChain) -> None:
    with pytest.raises(InvalidValueError, match=r"right\.hinge' is a passive joint"):
        ClosedLoopDynamics(hinged, actuated=[*hinged.joint_names[:5], "right.hinge"])


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"mass": -0.2}, "greater than or equal to 0"),
        ({"mass": math.nan}, "finite"),
        ({"inertia": (1e-3, 0, 0, 1e-3, 0, 3e-3)}, "impossible"),
        ({"inertia": (1e-3, 0, 0, -1e-3, 0, 1e-3)}, "impossible"),
        ({"inertia": (1e-3, 5e-3, 0, 1e-3, 0, 1e-3)}, "impossible"),
        ({"inertia": (1e-3, 0, 0, 1e-3)}, "needs 6 numbers"),
        ({"com": (0.0, 0.0)}, "needs 3 numbers"),
    ],
)
def test_object_that_no_body_can_be(values: dict[str, object], message: str) -> None:
    with pytest.raises(InvalidValueError, match=message) as caught:
        HeldObject(**values)
    assert len(str(caught.value).splitlines()) == 1
