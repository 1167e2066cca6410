"""Closed loops: their rank and rows, the object's Jacobians, and grasps that do not fit."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pinocchio as pin
import pytest
from chains import Walk, planar_pair, short_pair, spherical_pair, three_arms

from coopqp.base.errors import GraspError, InvalidValueError, UnknownNameError
from coopqp.base.qp import names_of
from coopqp.base.rank import matrix_rank
from coopqp.base.spec import Array, Pose
from coopqp.grasps import Rigid
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.grasp_configuration import HeldObject
from coopqp.model.state import PointOfObject, State
from coopqp.robot import RobotModel

H = 1e-5  # step of the central differences [rad]
CHAINS: dict[str, Callable[[], ClosedChain]] = {
    "planar": planar_pair,
    "spherical": spherical_pair,
    "three arms": three_arms,
}


@pytest.fixture(params=["nao", "hinged", *CHAINS])
def any_chain(
    request: pytest.FixtureRequest, chain: ClosedChain, hinged: ClosedChain
) -> ClosedChain:
    of_nao = {"nao": chain, "hinged": hinged}
    return of_nao[request.param] if request.param in of_nao else CHAINS[request.param]()


def object_poses(chain: ClosedChain, q: Array) -> list[pin.SE3]:
    """Where each arm carries the object."""
    data = chain.model.createData()
    pin.framesForwardKinematics(chain.model, data, q)
    return [data.oMf[frame].copy() for frame in chain.frames]


def test_firm_grasp_leaves_four_of_ten_freedoms(
    chain: ClosedChain, closed_loop_walk: Walk, rng: np.random.Generator
) -> None:
    for q in [*chain.sample(rng, 30), *closed_loop_walk(chain, 10)]:
        assert chain.n - matrix_rank(chain.loop_jacobian(q)) == 4
    assert chain.loops.rank == 6


def test_hinged_grasp_leaves_six_of_twelve_freedoms(
    hinged: ClosedChain, closed_loop_walk: Walk
) -> None:
    for q in closed_loop_walk(hinged, 10):
        assert hinged.n - matrix_rank(hinged.loop_jacobian(q)) == 6


def test_passive_joints_come_after_their_arm(hinged: ClosedChain, nao: RobotModel) -> None:
    right, left = nao.joint_names[:5], nao.joint_names[5:]
    assert hinged.joint_names == (*right, "right.hinge", *left, "left.hinge")
    np.testing.assert_array_equal(hinged.passive, [5, 11])
    np.testing.assert_array_equal(hinged.q_start[hinged.passive], [0, 0])
    np.testing.assert_array_equal(hinged.upper[hinged.passive], [np.inf, np.inf])


def test_loop_rows_are_named_by_arm_and_axis(chain: ClosedChain) -> None:
    axes = ("x", "y", "z", "rot_x", "rot_y", "rot_z")
    assert chain.loops.names == tuple(f"loop[left].{axis}" for axis in axes)
    assert chain.loops.kept_rows == chain.loops.rows
    assert chain.loops.dropped == ()
    assert not chain.loops.varying


def test_each_further_arm_closes_a_loop_of_its_own() -> None:
    loops = three_arms().loops
    assert [loops.names[0], loops.names[6]] == ["loop[left].x", "loop[middle].x"]
    assert (len(loops.names), loops.rank) == (12, 12)


def test_object_starts_midway_between_the_hands_with_all_loops_closed(
    any_chain: ClosedChain,
) -> None:
    state, data = State(any_chain), any_chain.model.createData()
    pin.framesForwardKinematics(any_chain.model, data, any_chain.q_start)
    tips = [data.oMf[any_chain.model.getFrameId(arm.tip)].translation for arm in any_chain.arms]
    np.testing.assert_allclose(state.p_WO, np.mean(tips, axis=0), atol=1e-15)
    np.testing.assert_allclose(state.R_WO, np.eye(3), atol=1e-14)
    np.testing.assert_allclose(state.loop_error, 0, atol=1e-14)


def test_object_pose_lies_midway_between_two_arms_that_disagree(
    chain: ClosedChain, rng: np.random.Generator
) -> None:
    for q in chain.sample(rng, 20):
        state, (right, left) = State(chain, q), object_poses(chain, q)
        half = pin.exp3(0.5 * pin.log3(right.rotation.T @ left.rotation))
        np.testing.assert_allclose(state.p_WO, (right.translation + left.translation) / 2)
        np.testing.assert_allclose(state.R_WO, right.rotation @ half, atol=1e-12)
        gap = np.linalg.norm(left.translation - right.translation)
        assert state.loop_position_error == pytest.approx(gap)
        angle = pin.AngleAxis(left.rotation @ right.rotation.T).angle
        assert state.loop_orientation_error == pytest.approx(angle)


def test_object_keeps_its_grasp_while_carried(
    any_chain: ClosedChain, closed_loop_walk: Walk
) -> None:
    """With the loops closed every hand, or its hinge, sees the object where it took hold of it."""
    holders = [f"{a.name}.grasp" if len(any_chain.passive) else a.tip for a in any_chain.arms]
    ids = [any_chain.model.getFrameId(name) for name in holders]

    def seen_from_hands(q: Array) -> list[Array]:
        state, data = State(any_chain, q), any_chain.model.createData()
        pin.framesForwardKinematics(any_chain.model, data, q)
        X_WO = pin.SE3(state.R_WO, state.p_WO)
        return [data.oMf[i].actInv(X_WO).homogeneous for i in ids]

    start = seen_from_hands(any_chain.q_start)
    for q in closed_loop_walk(any_chain, 5):
        assert np.abs(q - any_chain.q_start).max() > 0.02  # it has moved
        np.testing.assert_allclose(seen_from_hands(q), start, atol=1e-11)


def test_object_twist_is_the_rate_of_the_averaged_pose(
    any_chain: ClosedChain, closed_loop_walk: Walk
) -> None:
    for q in closed_loop_walk(any_chain, 5):
        J = State(any_chain, q).J_task
        for joint, unit in enumerate(np.eye(any_chain.n)):
            before, after = State(any_chain, q - H * unit), State(any_chain, q + H * unit)
            speed = (after.p_WO - before.p_WO) / (2 * H)
            omega = pin.log3(after.R_WO @ before.R_WO.T) / (2 * H)
            np.testing.assert_allclose(J[:, joint], [*speed, *omega], atol=1e-8)


def test_relative_jacobian_is_the_rate_of_the_loop_error(
    any_chain: ClosedChain, closed_loop_walk: Walk
) -> None:
    for q in closed_loop_walk(any_chain, 5):
        state = State(any_chain, q)
        for joint, unit in enumerate(np.eye(any_chain.n)):
            before, after = State(any_chain, q - H * unit), State(any_chain, q + H * unit)
            rate = (after.loop_error - before.loop_error) / (2 * H)
            np.testing.assert_allclose(state.J_rel[:, joint], rate, atol=1e-8)
        np.testing.assert_allclose(any_chain.loop_jacobian(q), state.J_rel, atol=1e-14)


def test_object_point_moves_with_its_jacobian(chain: ClosedChain, closed_loop_walk: Walk) -> None:
    point = np.array([0.03, -0.02, 0.05])
    for q in closed_loop_walk(chain, 5):
        tracked = PointOfObject(point, chain.n)
        tracked.update(State(chain, q))
        for joint, unit in enumerate(np.eye(chain.n)):
            before, after = State(chain, q - H * unit), State(chain, q + H * unit)
            rate = (after.point(point) - before.point(point)) / (2 * H)
            np.testing.assert_allclose(tracked.J[:, joint], rate, atol=1e-8)


def test_planar_arms_have_three_loop_rows_and_name_the_rest() -> None:
    pair = planar_pair()
    assert pair.loops.rank == 3
    assert names_of(pair.loops.kept_rows) == ("loop[left].x", "loop[left].y", "loop[left].rot_z")
    assert pair.loops.dropped == ("loop[left].z", "loop[left].rot_x", "loop[left].rot_y")
    assert not pair.loops.varying


@pytest.mark.parametrize("build", [planar_pair, short_pair, three_arms])
def test_rows_for_the_solver_are_independent_and_lose_nothing(
    build: Callable[[], ClosedChain], rng: np.random.Generator
) -> None:
    chain = build()
    for q in chain.sample(rng, 20):
        state = State(chain, q)
        rank = matrix_rank(state.J_rel)
        assert matrix_rank(state.J_loop) == len(state.J_loop) == len(state.e_loop) == rank
        assert matrix_rank(np.vstack([state.J_rel, state.J_loop])) == rank


def test_rows_for_the_solver_come_with_their_own_errors(rng: np.random.Generator) -> None:
    pair = planar_pair()
    for q in pair.sample(rng, 5):
        state = State(pair, q)
        np.testing.assert_array_equal(state.e_loop, state.loop_error[[0, 1, 5]])
        np.testing.assert_array_equal(state.J_loop, state.J_rel[[0, 1, 5]])


def test_rank_of_a_spatial_loop_too_short_to_move_is_four() -> None:
    loops = short_pair().loops
    assert (loops.rank, loops.varying) == (4, True)


def test_closed_spherical_loop_has_rank_three(closed_loop_walk: Walk) -> None:
    """All joint axes meet in one point, so the object can only turn about it."""
    pair = spherical_pair()
    assert {matrix_rank(pair.loop_jacobian(q)) for q in closed_loop_walk(pair, 5)} == {3}


def test_spherical_arms_have_three_independent_loop_rows() -> None:
    """The rank of an over-constrained loop shows only where the loop is closed."""
    assert spherical_pair().loops.rank == 3


@pytest.mark.parametrize("drift", [0.0, 1e-6])
def test_rows_for_the_solver_stay_well_apart_when_the_loop_drifts(
    drift: float, rng: np.random.Generator
) -> None:
    """A loop open by a micrometre has rank 5 in numbers; the three strong rows must be kept."""
    pair = spherical_pair()
    state = State(pair, pair.q_start + drift * rng.normal(size=pair.n))
    weakest = np.linalg.svd(state.J_loop)[1][-1]
    assert weakest > 0.3 * np.linalg.svd(state.J_rel)[1][2]


def test_grasp_given_for_one_hand_places_the_object(nao: RobotModel, chain: ClosedChain) -> None:
    pose = Pose(position=(0.0, 0.1, 0.02), rpy=(0.3, -0.2, 0.1))
    held = ClosedChain.attach(
        nao, chain.q_start, {"right": Rigid(object_in_hand=pose), "left": Rigid()}, HeldObject()
    )
    data = nao.model.createData()
    pin.framesForwardKinematics(nao.model, data, chain.q_start)
    X_HO = pin.SE3(pin.rpy.rpyToMatrix(np.array([0.3, -0.2, 0.1])), np.array([0.0, 0.1, 0.02]))
    wanted = data.oMf[nao.model.getFrameId("RHand")] * X_HO
    for X in object_poses(held, held.q_start):
        np.testing.assert_allclose(X.homogeneous, wanted.homogeneous, atol=1e-14)


def test_object_pose_in_degrees_is_where_the_object_starts(
    nao: RobotModel, chain: ClosedChain
) -> None:
    held = HeldObject(pose=Pose(position=(0.2, 0.0, 0.05), rpy_deg=(0.0, 0.0, 90.0)))
    state = State(ClosedChain.attach(nao, chain.q_start, Rigid(), held))
    np.testing.assert_allclose(state.p_WO, [0.2, 0, 0.05], atol=1e-15)
    np.testing.assert_allclose(state.R_WO, [[0, -1, 0], [1, 0, 0], [0, 0, 1]], atol=1e-15)


def test_grasps_that_put_the_object_in_two_places_do_not_close(
    nao: RobotModel, chain: ClosedChain
) -> None:
    grasps = {
        arm: Rigid(object_in_hand=Pose(position=(0.0, 0.05, 0.0))) for arm in ("right", "left")
    }
    with pytest.raises(GraspError, match=r"does not close.*'left'.*mm.*degrees.*'right'"):
        ClosedChain.attach(nao, chain.q_start, grasps, HeldObject())


def test_object_pose_that_contradicts_the_grasp_does_not_close(
    nao: RobotModel, chain: ClosedChain
) -> None:
    grasps = {"right": Rigid(object_in_hand=Pose()), "left": Rigid()}
    held = HeldObject(pose=Pose(position=(0.5, 0.0, 0.0)))
    with pytest.raises(GraspError, match=r"object\.pose"):
        ClosedChain.attach(nao, chain.q_start, grasps, held)


def test_grasp_for_an_arm_the_robot_lacks_is_refused(nao: RobotModel, chain: ClosedChain) -> None:
    with pytest.raises(UnknownNameError, match=r"'lefft'; did you mean 'left'"):
        ClosedChain.attach(nao, chain.q_start, {"right": Rigid(), "lefft": Rigid()}, HeldObject())


def test_arm_without_a_grasp_is_named(nao: RobotModel, chain: ClosedChain) -> None:
    with pytest.raises(GraspError, match="left"):
        ClosedChain.attach(nao, chain.q_start, {"right": Rigid()}, HeldObject())


def test_one_arm_cannot_close_a_loop(nao: RobotModel, chain: ClosedChain) -> None:
    single = RobotModel(name="single", model=nao.model, arms=nao.arms[:1])
    with pytest.raises(GraspError, match="needs two"):
        ClosedChain.attach(single, chain.q_start, Rigid(), HeldObject())


def test_start_with_too_few_joints_is_refused(nao: RobotModel) -> None:
    with pytest.raises(InvalidValueError, match=r"\(10,\)"):
        ClosedChain.attach(nao, np.zeros(9), Rigid(), HeldObject())
