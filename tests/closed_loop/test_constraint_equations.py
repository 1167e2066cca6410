"""Section 3.1 of the paper: eq. (8)-(13) and (17)-(19) against what the joints really do."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
import scipy.linalg
from chains import PAPER_SCHEME, Hinge, closed_states, planar_pair, small_arm, three_arms

from coopqp.base.errors import InvalidValueError, UnknownNameError
from coopqp.base.spec import Array
from coopqp.closed_loop.constraint_equations import ConstraintEquations, constraint_equations
from coopqp.grasps import Rigid
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.grasp_configuration import HeldObject
from coopqp.robot import Arm, RobotModel
from coopqp.robot_files import mdh
from coopqp.robots.planar_pair import PlanarPair

OTHER_SCHEMES = (
    PAPER_SCHEME,
    ("RShoulderPitch", "RElbowYaw", "LElbowYaw", "LWristYaw"),
    ("RElbowYaw", "LShoulderPitch", "LElbowRoll", "LWristYaw"),
)
H = 1e-5  # step of the central differences [s]


def regular_states(
    chain: ClosedChain, actuated: tuple[str, ...], count: int = 15
) -> list[tuple[Array, Array]]:
    """Closed states at which the scheme is well conditioned."""
    states = closed_states(chain, 4 * count)
    good = [
        (q, v)
        for q, v in states
        if constraint_equations(chain, q, v, actuated=actuated).condition < 1e4
    ]
    assert len(good) >= count
    return good[:count]


def rows_at_cut(chain: ClosedChain, q: Array, joint: int, arm: int = 1) -> Array:
    """Relative motion of the two carriers of the object at a joint's frame, in its axes."""
    model, data = chain.model, chain.model.createData()
    pin.computeJointJacobians(model, data, q)
    pin.updateFramePlacements(model, data)
    X_WC = data.oMi[joint + 1]
    rows = []
    for frame in (chain.frames[arm], chain.frames[0]):
        # Twist of the object as a spatial vector in the world, then in the axes of the cut joint.
        J = pin.getFrameJacobian(model, data, frame, pin.WORLD)
        rows.append(X_WC.inverse().toActionMatrix() @ J)
    return np.asarray(rows[0] - rows[1])


def jdot_v(chain: ClosedChain, q: Array, v: Array) -> Array:
    """Time derivative of J_c along the motion, times v, by differences; one object point."""

    def rows(q: Array) -> Array:
        model, data = chain.model, chain.model.createData()
        pin.computeJointJacobians(model, data, q)
        pin.updateFramePlacements(model, data)
        J = [
            pin.getFrameJacobian(model, data, f, pin.LOCAL_WORLD_ALIGNED).copy()
            for f in chain.frames
        ]
        return np.vstack([J_i - J[0] for J_i in J[1:]])

    return np.asarray((rows(q + H * v) - rows(q - H * v)) @ v / (2 * H))


def check_motion(chain: ClosedChain, found: ConstraintEquations, q: Array, v: Array) -> None:
    """The joints move as the loops allow, in velocity and in acceleration."""
    n, f = chain.n, len(found.actuated)
    J = chain.loop_jacobian(q)
    size = np.abs(found.motion).max()
    np.testing.assert_allclose(J @ found.motion, 0, atol=1e-11 * size)
    np.testing.assert_allclose(found.motion[list(found.actuated)], np.eye(f), atol=1e-12)
    np.testing.assert_allclose(found.motion @ v[list(found.actuated)], v, atol=1e-9 * size)
    np.testing.assert_array_equal(found.G, found.motion[list(found.passive)])
    np.testing.assert_array_equal(found.G_cut, found.motion[list(found.cut)])
    assert sorted((*found.actuated, *found.passive, *found.cut)) == list(range(n))
    a = found.motion @ np.linspace(-2, 3, f) + found.drift
    np.testing.assert_allclose(J @ a, -jdot_v(chain, q, v), atol=1e-7 * size)


def check_object(chain: ClosedChain, found: ConstraintEquations, q: Array) -> None:
    """J_a is the object's twist by differences, whoever carries it."""
    h = 1e-6
    data = chain.model.createData()
    for k in range(len(found.actuated)):
        for i, frame in enumerate(chain.frames):
            places = []
            for sign in (-1, 1):
                pin.framesForwardKinematics(chain.model, data, q + sign * h * found.motion[:, k])
                places.append(data.oMf[frame].copy())
            before, after = places
            twist = np.concatenate(
                [
                    after.translation - before.translation,
                    pin.log3(after.rotation @ before.rotation.T),
                ]
            ) / (2 * h)
            size = max(1.0, float(np.abs(found.motion).max()))
            np.testing.assert_allclose(found.J_a[i, :, k], twist, atol=1e-7 * size**2)


@pytest.mark.parametrize("actuated", OTHER_SCHEMES, ids=["paper", "second", "third"])
def test_joints_and_object_follow_the_actuated_joints(
    chain: ClosedChain, actuated: tuple[str, ...]
) -> None:
    for q, v in regular_states(chain, actuated):
        found = constraint_equations(chain, q, v, actuated=actuated)
        assert not found.singular
        check_motion(chain, found, q, v)
        check_object(chain, found, q)
        first, second = found.J_a
        np.testing.assert_allclose(first, second, atol=1e-10 * np.abs(found.motion).max())


@pytest.mark.parametrize("cut", ["LWristYaw", "LElbowRoll", "LElbowYaw", "LShoulderPitch"])
def test_rows_without_the_cut_joint_are_zero_in_its_own_frame(chain: ClosedChain, cut: str) -> None:
    """The block of zeros in eq. (8): one row holds the cut joint, five do not."""
    joint = chain.joint_names.index(cut)
    for q, v in regular_states(chain, PAPER_SCHEME, 5):
        rows = rows_at_cut(chain, q, joint)
        np.testing.assert_allclose(rows[:, joint], [0, 0, 0, 0, 0, 1], atol=1e-14)
        found = constraint_equations(chain, q, v, actuated=PAPER_SCHEME, cut=[cut])
        assert found.cut == (joint,)
        G_a, G_p = rows[:5, list(found.actuated)], rows[:5, list(found.passive)]
        np.testing.assert_allclose(found.G, -np.linalg.solve(G_p, G_a), rtol=1e-7, atol=1e-9)
        assert found.condition == pytest.approx(np.linalg.cond(G_p), rel=1e-6)
        # Eq. (12): G_c = 1 in the joint's own frame.
        G_cut = -(rows[5:, list(found.actuated)] + rows[5:, list(found.passive)] @ found.G)
        np.testing.assert_allclose(found.G_cut, G_cut, rtol=1e-7, atol=1e-9)


@pytest.mark.parametrize("cut", ["LElbowRoll", "LElbowYaw", "LShoulderPitch"])
def test_motion_does_not_depend_on_where_the_loop_is_cut(chain: ClosedChain, cut: str) -> None:
    for q, v in regular_states(chain, PAPER_SCHEME, 5):
        wrist = constraint_equations(chain, q, v, actuated=PAPER_SCHEME)
        other = constraint_equations(chain, q, v, actuated=PAPER_SCHEME, cut=[cut])
        scale = np.abs(wrist.motion).max()
        np.testing.assert_allclose(other.motion, wrist.motion, atol=1e-9 * scale)
        np.testing.assert_allclose(other.J_a, wrist.J_a, atol=1e-9 * scale)
        np.testing.assert_allclose(other.drift, wrist.drift, atol=1e-9 * scale**2)


def test_loop_is_cut_at_the_last_free_joint_unless_told(chain: ClosedChain) -> None:
    """The paper's choice, q10; the joint before it when that one is actuated."""
    q, v = regular_states(chain, PAPER_SCHEME, 1)[0]
    joints = chain.joint_names
    assert constraint_equations(chain, q, v, actuated=PAPER_SCHEME).cut == (9,)
    scheme = ("RShoulderPitch", "RElbowYaw", "LElbowYaw", "LWristYaw")
    found = constraint_equations(chain, q, v, actuated=scheme)
    assert [joints[i] for i in found.cut] == ["LElbowRoll"]


def test_object_and_arms_do_not_move_by_themselves(chain: ClosedChain) -> None:
    """Without velocity there is no drift."""
    q, v = regular_states(chain, PAPER_SCHEME, 1)[0]
    found = constraint_equations(chain, q, 0 * v, actuated=PAPER_SCHEME)
    np.testing.assert_allclose(found.drift, 0, atol=1e-15)


def test_papers_scheme_is_singular_at_mirror_symmetric_poses(chain: ClosedChain) -> None:
    """Reported, and no number that looks like an answer is given."""
    still = np.zeros(10)
    found = constraint_equations(chain, chain.q_start, still, actuated=PAPER_SCHEME)
    assert found.singular
    assert found.condition > 1e8
    assert np.isnan(found.G).all()
    assert np.isnan(found.motion[list(found.passive)]).all()
    assert np.isnan(found.J_a).any()


def test_singular_scheme_gives_no_drift(chain: ClosedChain) -> None:
    N = scipy.linalg.null_space(chain.loop_jacobian(chain.q_start))
    v = N @ np.array([1.0, 0.5, -0.4, 0.2])
    found = constraint_equations(chain, chain.q_start, v, actuated=PAPER_SCHEME)
    assert found.singular
    assert np.isnan(found.drift).any()


def test_papers_scheme_is_regular_at_generic_poses(chain: ClosedChain) -> None:
    conditions = [
        constraint_equations(chain, q, v, actuated=PAPER_SCHEME).condition
        for q, v in closed_states(chain, 200)
    ]
    assert max(conditions) < 1e8
    assert 50 < np.median(conditions) < 5000


def test_other_schemes_are_regular_where_the_papers_is_not(chain: ClosedChain) -> None:
    N = scipy.linalg.null_space(chain.loop_jacobian(chain.q_start))
    v = N @ np.array([1.0, 0.5, -0.4, 0.2])
    for actuated in OTHER_SCHEMES[1:]:
        found = constraint_equations(chain, chain.q_start, v, actuated=actuated)
        assert not found.singular
        check_motion(chain, found, chain.q_start, v)


@pytest.mark.parametrize("cut", ["", "left.hinge", "LWristYaw"])
def test_hinged_grasp(nao: RobotModel, chain: ClosedChain, cut: str) -> None:
    """Table 2: six actuated joints, the loop cut at the hinge or before it."""
    hinged = ClosedChain.attach(nao, chain.q_start, Hinge(), HeldObject())
    names = hinged.joint_names
    actuated = (*names[:4], names[6], names[8])
    for q, v in regular_states(hinged, actuated, 8):
        found = constraint_equations(hinged, q, v, actuated=actuated, cut=[cut] if cut else [])
        assert [names[i] for i in found.cut] == [cut or "left.hinge"]
        check_motion(hinged, found, q, v)
        check_object(hinged, found, q)


def test_planar_pair_needs_only_the_rows_that_count() -> None:
    chain = planar_pair()
    for q, v in regular_states(chain, ("r1", "r2", "r3"), 8):
        found = constraint_equations(chain, q, v, actuated=("r1", "r2", "r3"))
        assert found.G.shape == (2, 3)
        check_motion(chain, found, q, v)
        check_object(chain, found, q)


def test_each_loop_of_three_arms_has_its_cut() -> None:
    """Fifteen joints, two loops: three freedoms, ten passive joints, two cuts."""
    chain = three_arms()
    N = scipy.linalg.null_space(chain.loop_jacobian(chain.q_start))
    order = scipy.linalg.qr(N.T, pivoting=True)[2][:3]
    actuated = tuple(chain.joint_names[i] for i in order)
    for q, v in regular_states(chain, actuated, 5):
        found = constraint_equations(chain, q, v, actuated=actuated)
        assert len(found.cut) == 2
        assert found.G.shape == (10, 3)
        check_motion(chain, found, q, v)
        check_object(chain, found, q)
        for arm, joint in enumerate(found.cut, start=1):
            rows = rows_at_cut(chain, q, joint, arm)
            np.testing.assert_allclose(rows[:, joint], [0, 0, 0, 0, 0, 1], atol=1e-14)


def torso_pair() -> ClosedChain:
    """Two arms of six joints on a torso that turns without moving the loop."""
    rows = [mdh.MdhRow(name="torso", antecedent=None, lower=-1, upper=1, velocity=1)]
    tips = {}
    for name, side in (("a", 0.0), ("b", np.pi)):
        arm = small_arm(name, mdh.MdhParameters(gamma=side, d=0.1), 6)
        rows += [replace(arm[0], antecedent="torso"), *arm[1:]]
        tips[f"{name}_tip"] = mdh.Tip(parent=arm[-1].name, offset=(0.05, 0.0, 0.0))
    model = mdh.build_model("torso_pair", rows, tips)
    arms = (Arm(name="a", tip="a_tip"), Arm(name="b", tip="b_tip"))
    robot = RobotModel(name="torso_pair", model=model, arms=arms)
    q = np.concatenate([[0.2], np.linspace(0.4, 0.9, 6), np.linspace(-0.5, 0.8, 6)])
    return ClosedChain.attach(robot, q, Rigid(), HeldObject())


def test_torso_that_is_actuated_turns_everything() -> None:
    chain = torso_pair()
    actuated = ("torso", *(f"a{i}" for i in range(1, 7)))
    for q, v in regular_states(chain, actuated, 3):
        found = constraint_equations(chain, q, v, actuated=actuated)
        check_motion(chain, found, q, v)
        check_object(chain, found, q)


@pytest.mark.parametrize(
    ("actuated", "cut"),
    [
        (("a1", "a2", "a3", "a4", "a5", "a6", "b1"), []),
        (("b1", "b2", "b3", "b4", "b5", "b6", "a1"), []),
        (("a1", "a2", "a3", "a4", "a5", "a6", "b1"), ["torso"]),
    ],
)
def test_torso_that_is_not_actuated_is_left_undecided(
    actuated: tuple[str, ...], cut: list[str]
) -> None:
    """No loop decides it, so that no scheme without it is regular; a refusal would do as well."""
    chain = torso_pair()
    try:
        found = constraint_equations(chain, chain.q_start, np.zeros(13), actuated=actuated, cut=cut)
    except InvalidValueError:
        return
    assert found.singular


@pytest.mark.parametrize(
    ("actuated", "message"),
    [
        (PAPER_SCHEME[:3], "found 3 joints, needs 4, the degrees of freedom"),
        ((*PAPER_SCHEME, "LElbowYaw"), "found 5 joints, needs 4, the degrees of freedom"),
        ((), "found 0 joints, needs 4"),
        ((*PAPER_SCHEME[:3], "RElbowYaw"), "actuated: RElbowYaw given more than once"),
        ((*PAPER_SCHEME[:3], "LElbowYwa"), "unknown joint 'LElbowYwa'; did you mean 'LElbowYaw'"),
    ],
)
def test_choice_of_joints_that_is_no_scheme(
    chain: ClosedChain, actuated: tuple[str, ...], message: str
) -> None:
    with pytest.raises((InvalidValueError, UnknownNameError), match=message) as caught:
        constraint_equations(chain, chain.q_start, np.zeros(10), actuated=actuated)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("cut", "message"),
    [
        (["LShoulderRoll"], "'LShoulderRoll' is actuated; cut the loop elsewhere"),
        (["RWristYaw"], "'RWristYaw' is not on the arm of its loop"),
        (["LWristYwa"], "unknown joint 'LWristYwa'"),
        (["LWristYaw", "LElbowYaw"], "found 2 joints, needs 1, one for each loop"),
    ],
)
def test_cut_that_opens_no_loop(chain: ClosedChain, cut: list[str], message: str) -> None:
    with pytest.raises((InvalidValueError, UnknownNameError), match=message):
        constraint_equations(chain, chain.q_start, np.zeros(10), actuated=PAPER_SCHEME, cut=cut)


def test_arm_whose_joints_are_all_actuated_cannot_be_cut() -> None:
    robot = PlanarPair().build()
    start = robot.configuration({"right": [-0.3, 1.2, -0.9], "left": [0.3, -1.2, 0.9]})
    pair = ClosedChain.attach(robot, start, Rigid(), HeldObject())
    left = ("left_1", "left_2", "left_3")
    with pytest.raises(InvalidValueError, match="leaves no joint of an arm"):
        constraint_equations(pair, pair.q_start, np.zeros(6), actuated=left)
