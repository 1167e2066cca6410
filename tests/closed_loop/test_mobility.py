"""What a grasp allows: ranks, impossible motions, and what the motors decide."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
import scipy.linalg
from chains import Hinge, closed_states, planar_pair, ring, stretched_pair
from scenario_files import needs_robots

import coopqp
from coopqp.base.spec import Array
from coopqp.closed_loop.mobility import LENGTH, Mobility, Screw, mobility
from coopqp.closed_loop.screw import screw_of
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.grasp_configuration import HeldObject
from coopqp.model.state import State
from coopqp.report.mobility import study
from coopqp.robot import RobotModel
from coopqp.tasks import Orientation, PointOnPoint

SCALE = np.array([1.0, 1.0, 1.0, LENGTH, LENGTH, LENGTH])


@pytest.fixture(scope="module")
def skewered(nao: RobotModel, chain: ClosedChain) -> ClosedChain:
    """Section 5.3: both passive axes on the line through both hands."""
    data = nao.model.createData()
    pin.framesForwardKinematics(nao.model, data, chain.q_start)
    right, left = (data.oMf[nao.model.getFrameId(arm.tip)] for arm in nao.arms)
    line = left.translation - right.translation
    hinges = {
        arm.name: Hinge(axis=tuple(hand.rotation.T @ line / np.linalg.norm(line)))
        for arm, hand in zip(nao.arms, (right, left), strict=True)
    }
    return ClosedChain.attach(nao, chain.q_start, hinges, HeldObject())


def object_twists(chain: ClosedChain, q: Array) -> Array:
    """The object's twists that the closed loops allow, by the arm 0 that carries it, (6, f)."""
    model, data = chain.model, chain.model.createData()
    pin.computeJointJacobians(model, data, q)
    pin.updateFramePlacements(model, data)
    J = [pin.getFrameJacobian(model, data, f, pin.LOCAL_WORLD_ALIGNED).copy() for f in chain.frames]
    N = scipy.linalg.null_space(np.vstack([J_i - J[0] for J_i in J[1:]]), rcond=1e-8)
    return np.asarray(J[0] @ N)


def test_firm_grasp_has_rank_six_and_mobility_four(firm: Mobility) -> None:
    assert (firm.rank, firm.rank_start, firm.ranks) == (6, 6, (6,))
    assert (firm.freedom, firm.freedom_start) == (4, 4)
    assert (firm.object_freedom, firm.object_freedom_start) == (4, 4)
    assert (firm.motor_freedom, firm.motor_freedom_start) == (4, 4)
    assert len(firm.joints) == 10
    assert firm.passive == firm.dropped == firm.uncontrolled == ()


def test_report_depends_on_the_seed_alone(chain: ClosedChain) -> None:
    first, second = mobility(chain, seed=3), mobility(chain, seed=3)
    assert first == second
    other = mobility(chain, seed=4)
    assert (other.inadmissible, other.inadmissible_start) == (71, 91)
    assert other.schemes[0].condition != first.schemes[0].condition


def test_planar_pair_names_its_three_redundant_rows() -> None:
    found = mobility(planar_pair())
    assert (found.rank, found.rank_start, found.freedom, found.freedom_start) == (3, 3, 3, 3)
    assert found.dropped == ("loop[left].z", "loop[left].rot_x", "loop[left].rot_y")
    assert found.object_freedom == found.motor_freedom == 3
    assert found.schemes_total == 20
    assert (
        "6 joints and loop rows of rank 3 leave 3 degrees of freedom; "
        "the object can move in 3 of 6 directions"
    ) in found.verdict()


def test_impossible_motions_of_the_planar_pair_leave_the_plane() -> None:
    words = {screw.describe() for screw in mobility(planar_pair()).impossible}
    assert "translation along z" in words
    assert len(words) == 3
    for screw in mobility(planar_pair()).impossible:
        np.testing.assert_allclose(np.array(screw.twist)[[0, 1, 5]], 0, atol=1e-9)


def test_hinges_along_the_wrists_give_six_freedoms_that_the_motors_decide(
    hinged: ClosedChain,
) -> None:
    found = mobility(hinged)
    assert (found.rank, found.freedom, found.freedom_start) == (6, 6, 6)
    assert (found.object_freedom, found.object_freedom_start) == (6, 6)
    assert (found.motor_freedom, found.motor_freedom_start) == (6, 6)
    assert found.passive == ("right.hinge", "left.hinge")
    assert found.impossible == found.uncontrolled == ()
    assert found.schemes_total == math.comb(10, 6)
    assert "by itself" not in found.verdict()


def test_hinges_on_one_line_leave_the_object_free_to_spin_about_it(
    skewered: ClosedChain,
) -> None:
    """Mobility six all the same: mobility does not tell."""
    found = mobility(skewered)
    assert (found.rank, found.freedom, found.freedom_start) == (6, 6, 6)
    assert found.object_freedom_start == 6
    assert found.motor_freedom_start == 5
    (spin,) = found.uncontrolled
    state = State(skewered)
    np.testing.assert_allclose(np.abs(spin.axis), [0, 1, 0], atol=1e-9)
    assert spin.pitch == pytest.approx(0, abs=1e-9)
    lever = np.array(spin.point) - state.p_WO
    np.testing.assert_allclose(np.cross(lever, spin.axis), 0, atol=1e-9)
    assert spin.describe().startswith("rotation about y through")


def test_motors_of_hinges_on_one_line_decide_five_motions_in_every_pose(
    skewered: ClosedChain,
) -> None:
    """The line stays with the object: what the motors leave free at the start they never decide."""
    for q, _ in closed_states(skewered, 10):
        N = scipy.linalg.null_space(skewered.loop_jacobian(q), rcond=1e-8)
        active = np.setdiff1d(np.arange(skewered.n), skewered.passive)
        locked = scipy.linalg.null_space(N[active], rcond=1e-8)
        assert locked.shape[1] == 1
        assert np.linalg.matrix_rank(object_twists(skewered, q), tol=1e-7) == 6


def test_verdict_tells_of_the_motion_that_no_motor_decides(skewered: ClosedChain) -> None:
    assert "motors decide only 5" in mobility(skewered).verdict()


def test_object_freedom_is_the_rank_of_its_twists(
    chain: ClosedChain, hinged: ClosedChain, skewered: ClosedChain
) -> None:
    for held in (chain, hinged, skewered):
        twists = SCALE[:, None] * object_twists(held, held.q_start)
        found = mobility(held)
        assert found.object_freedom_start == np.linalg.matrix_rank(twists, tol=1e-7)
        assert len(found.impossible) == 6 - found.object_freedom_start


def test_impossible_motions_cannot_happen(chain: ClosedChain, firm: Mobility) -> None:
    """Orthogonal to all possible twists when a radian counts as a length, and independent."""
    twists = SCALE[:, None] * object_twists(chain, chain.q_start)
    impossible = np.array([screw.twist for screw in firm.impossible]).T
    assert impossible.shape == (6, 2)
    np.testing.assert_allclose((SCALE[:, None] * impossible).T @ twists, 0, atol=1e-9)
    both = np.hstack([twists, SCALE[:, None] * impossible])
    assert np.linalg.matrix_rank(both, tol=1e-7) == 6


def test_no_velocity_of_the_closed_loop_makes_an_impossible_motion(
    chain: ClosedChain, firm: Mobility, rng: np.random.Generator
) -> None:
    """Not even nearly: the best try leaves the whole twist undone."""
    twists = SCALE[:, None] * object_twists(chain, chain.q_start)
    for weights in rng.normal(size=(5, 2)):
        wanted = SCALE * sum(
            w * np.array(s.twist) for w, s in zip(weights, firm.impossible, strict=True)
        )
        best = np.linalg.lstsq(twists, wanted, rcond=None)[0]
        assert np.linalg.norm(twists @ best - wanted) == pytest.approx(np.linalg.norm(wanted))


def test_screws_are_their_twists(chain: ClosedChain, firm: Mobility) -> None:
    """Axis, point and pitch give back the twist at the object's origin."""
    origin = State(chain).p_WO
    for screw in firm.impossible:
        v, omega = np.array(screw.twist[:3]), np.array(screw.twist[3:])
        axis, point = np.array(screw.axis), np.array(screw.point)
        assert np.linalg.norm(axis) == pytest.approx(1)
        turn = omega @ axis
        np.testing.assert_allclose(omega, turn * axis, atol=1e-12)
        rotated = turn * np.cross(axis, origin - point) + turn * screw.pitch * axis
        np.testing.assert_allclose(v, rotated, atol=1e-9)
        assert (point - origin) @ axis == pytest.approx(0, abs=1e-12)


def test_words_of_screws() -> None:
    def screw(twist: tuple[float, ...], axis: tuple[float, ...], pitch: float) -> str:
        return Screw(twist=twist, axis=axis, point=(0.1, 0.0, 0.2), pitch=pitch).describe()

    zero = (0.0,) * 6
    assert screw(zero, (0.0, 0.0, -1.0), math.inf) == "translation along z"
    assert screw(zero, (0.0, 1.0, 0.0), 0.0) == ("rotation about y through (0.100, 0.000, 0.200) m")
    assert screw(zero, (0.6, 0.8, 0.0), 0.02) == (
        "screw about (0.600, 0.800, 0.000) through (0.100, 0.000, 0.200) m, 20.0 mm per radian"
    )


def test_a_screw_about_a_far_axis_reads_as_the_way_that_it_goes() -> None:
    """The bar of two SO-101: an axis 1.27 m below, which no owner can picture."""
    far = screw_of(np.array([0.0, 1.0, 0.0, 0.79, 0.0, 0.0]), np.array([0.36, 0.0, 0.147]))
    assert far.describe() == "sideways (y), with a little turning about x (4.5 degrees per 100 mm)"
    oblique = screw_of(np.array([0.6, 0.8, 0.0, 0.0, 0.0, 0.5]), np.zeros(3)).describe()
    assert oblique.startswith("translation along (0.600, 0.800, 0.000), with a little turning ab")
    near = screw_of(np.array([0.0, 1.0, 0.0, 3.0, 0.0, 0.0]), np.zeros(3)).describe()
    assert near == "rotation about x through (0.000, 0.000, 0.333) m"


def test_a_motion_below_what_typed_digits_mean_is_none_and_a_small_one_is_weak() -> None:
    """Rows of a task count by the same size as motions of the object."""
    chain = planar_pair()
    N = scipy.linalg.null_space(chain.loop_jacobian(chain.q_start), rcond=1e-8)
    unit = N[:, 0] / np.linalg.norm(N[:, 0])  # a row whose only singular value is one
    for size, rank in ((3.9e-7, 0), (0.0056, 1), (0.5, 1)):
        found = mobility(chain, task_rows=[("yaw", size * unit[None])], samples=4)
        (task,) = found.tasks
        assert (task.rank, found.tasks_rank) == (rank, rank)
        assert task.weakest == pytest.approx(size if rank else np.inf)
        said = found.verdict()
        assert ("can all be met" in said) is bool(rank)
        assert ("One direction is weak: a unit of joint motion brings about 0.0056" in said) is (
            size == 0.0056
        )


@needs_robots
def test_two_so101_cannot_turn_the_bar_about_the_vertical_and_hardly_move_it_sideways(
    tmp_path: Path,
) -> None:
    """Singular values 0.71, 0.21 and 3.9e-7 were said to be three rows that can all be met."""
    shipped = (Path(__file__).parents[2] / "scenarios" / "two_so101.yaml").read_text("utf-8")
    file = tmp_path / "without_meshes.yaml"  # which take seconds to read
    file.write_text(re.sub("(?m)^ *- self_collision.*$", "", shipped), "utf-8")
    like = replace(coopqp.load(file), duration=0.05)
    turn = study(replace(like, tasks=(Orientation(name="turn", rpy_deg=(0, 0, 20)),))).mobility
    assert turn.tasks_rank == 2
    assert "ask 3 rows, of which only 2 can be met" in turn.verdict()
    to = PointOnPoint(name="aside", goal=(0.36, 0.06, 0.2))
    aside = study(replace(like, tasks=(to,))).mobility
    assert aside.tasks_weakest == pytest.approx(0.0056, abs=1e-4)
    words = {screw.describe() for screw in aside.impossible}
    assert any(line.startswith("sideways (y), with a little turning about x") for line in words)
    assert any(line.startswith("rotation about z") for line in words)


def test_three_rigid_arms_of_seven_joints() -> None:
    """Rank 12, mobility 9; too many schemes to try them all."""
    found = mobility(ring(3, 7))
    assert (found.rank, found.rank_start) == (12, 12)
    assert (found.freedom, found.freedom_start) == (9, 9)
    assert found.object_freedom == found.motor_freedom == 6
    assert found.schemes_total == math.comb(21, 9)
    assert not found.schemes_complete
    assert found.schemes
    assert all(len(set(s.joints)) == 9 for s in found.schemes)
    assert found.schemes[0].admissible
    assert any(s.admissible_start for s in found.schemes)
    assert "3 degrees of freedom move the joints and not the object" in found.verdict()


def test_singular_start_is_told_apart_from_generic_poses() -> None:
    """A stretched arm cannot follow along its line."""
    chain = stretched_pair()
    found = mobility(chain)
    assert (found.freedom, found.freedom_start) == (3, 3)
    assert (found.object_freedom, found.object_freedom_start) == (3, 2)
    assert "The start is singular: rank 3 there, 2 directions." in found.verdict()
