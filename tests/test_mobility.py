"""What a grasp allows: ranks, impossible motions, schemes, and what the motors decide."""

from __future__ import annotations

import itertools
import json
import math

import numpy as np
import pinocchio as pin
import pytest
import scipy.linalg
from click.testing import CliRunner, Result
from numpy.typing import NDArray
from test_closed_chain import planar_pair
from test_dynamics import Hinge, closed_states, ring

from coopqp.cli import main
from coopqp.closed_chain import ClosedChain
from coopqp.closed_loop.mobility import LENGTH, Mobility, Screw, manipulability, mobility
from coopqp.errors import InvalidValueError, UnknownNameError
from coopqp.grasps import Rigid
from coopqp.held_object import HeldObject
from coopqp.robot import RobotModel
from coopqp.state import State

Array = NDArray[np.float64]

PAPER_SCHEME = ["RShoulderPitch", "RShoulderRoll", "RElbowYaw", "LShoulderRoll"]  # q1 q2 q3 q7
SCALE = np.array([1.0, 1.0, 1.0, LENGTH, LENGTH, LENGTH])


@pytest.fixture(scope="module")
def firm(chain: ClosedChain) -> Mobility:
    return mobility(chain, asked=PAPER_SCHEME)


@pytest.fixture(scope="module")
def hinged(nao: RobotModel, chain: ClosedChain) -> ClosedChain:
    """Table 2: each passive axis along that arm's wrist axis."""
    return ClosedChain.take_hold(nao, chain.q_start, Hinge(), HeldObject())


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
    return ClosedChain.take_hold(nao, chain.q_start, hinges, HeldObject())


def object_twists(chain: ClosedChain, q: Array) -> Array:
    """The object's twists that the closed loops allow, by the arm 0 that carries it, (6, f)."""
    model, data = chain.model, chain.model.createData()
    pin.computeJointJacobians(model, data, q)
    pin.updateFramePlacements(model, data)
    J = [pin.getFrameJacobian(model, data, f, pin.LOCAL_WORLD_ALIGNED).copy() for f in chain.frames]
    N = scipy.linalg.null_space(np.vstack([J_i - J[0] for J_i in J[1:]]), rcond=1e-8)
    return np.asarray(J[0] @ N)


def rows_of_object(chain: ClosedChain) -> Array:
    """The object's Jacobian at the start, (6, n)."""
    return State(chain).J_task.copy()


def test_firm_grasp_has_rank_six_and_mobility_four(firm: Mobility) -> None:
    assert (firm.rank, firm.rank_start, firm.ranks) == (6, 6, (6,))
    assert (firm.freedom, firm.freedom_start) == (4, 4)
    assert (firm.object_freedom, firm.object_freedom_start) == (4, 4)
    assert (firm.motor_freedom, firm.motor_freedom_start) == (4, 4)
    assert len(firm.joints) == 10
    assert firm.passive == firm.dropped == firm.uncontrolled == ()


def test_seventy_one_of_210_schemes_never_work_and_ninety_one_not_at_the_start(
    firm: Mobility,
) -> None:
    assert firm.schemes_complete
    assert firm.schemes_total == len(firm.schemes) == 210
    assert firm.inadmissible == 71
    assert firm.inadmissible_start == 91
    assert len({s.joints for s in firm.schemes}) == 210


def test_schemes_are_judged_as_the_free_motions_say(chain: ClosedChain, firm: Mobility) -> None:
    """A scheme works where its joints' rows of the null-space basis are regular."""
    poses = [q for q, _ in closed_states(chain, 10)]
    at_start = scipy.linalg.null_space(chain.loop_jacobian(chain.q_start))
    bases = [scipy.linalg.null_space(chain.loop_jacobian(q)) for q in poses]
    for scheme in firm.schemes:
        joints = [chain.joint_names.index(name) for name in scheme.joints]
        smallest = [np.linalg.svd(N[joints], compute_uv=False)[-1] for N in bases]
        assert scheme.admissible == (max(smallest) > 1e-7)
        smallest_at_start = np.linalg.svd(at_start[joints], compute_uv=False)[-1]
        assert scheme.admissible_start == (smallest_at_start > 1e-7)


def test_papers_scheme_is_lost_at_the_start(firm: Mobility) -> None:
    assert firm.asked is not None
    assert list(firm.asked.joints) == PAPER_SCHEME
    assert firm.asked.admissible
    assert not firm.asked.admissible_start
    assert 50 < firm.asked.condition < 5000
    assert firm.asked in firm.lost_at_start
    assert len(firm.lost_at_start) == 20
    assert "admissible at generic poses" in firm.verdict()
    assert "singular at the start" in firm.verdict()


def test_schemes_come_best_first(firm: Mobility) -> None:
    conditions = [s.condition for s in firm.schemes]
    assert conditions == sorted(conditions)
    assert firm.schemes[0].admissible
    assert firm.schemes[0].admissible_start


def test_verdict_on_an_inadmissible_and_on_a_good_scheme(
    chain: ClosedChain, firm: Mobility
) -> None:
    bad = mobility(chain, asked=firm.schemes[-1].joints).verdict()
    assert "is inadmissible: it is singular at every pose" in bad
    good = mobility(chain, asked=firm.schemes[0].joints).verdict()
    assert "is admissible (condition" in good


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
    words = {screw.words() for screw in mobility(planar_pair()).impossible}
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
    assert spin.words().startswith("rotation about y through")


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
        return Screw(twist=twist, axis=axis, point=(0.1, 0.0, 0.2), pitch=pitch).words()

    zero = (0.0,) * 6
    assert screw(zero, (0.0, 0.0, -1.0), math.inf) == "translation along z"
    assert screw(zero, (0.0, 1.0, 0.0), 0.0) == ("rotation about y through (0.100, 0.000, 0.200) m")
    assert screw(zero, (0.6, 0.8, 0.0), 0.02) == (
        "screw about (0.600, 0.800, 0.000) through (0.100, 0.000, 0.200) m, 20.0 mm per radian"
    )


def test_tasks_that_cannot_be_met_together(chain: ClosedChain, firm: Mobility) -> None:
    """Three rows for the position, one along what is impossible: four rows, three of them free."""
    J = rows_of_object(chain)
    along = SCALE**2 * np.array(firm.impossible[0].twist)
    found = mobility(chain, task_rows=[("reach", J[:3]), ("twist", along[None] @ J)])
    assert [(t.name, t.rows, t.rank) for t in found.tasks] == [("reach", 3, 3), ("twist", 1, 0)]
    assert (found.tasks_rows, found.tasks_rank) == (4, 3)
    assert "ask 4 rows, of which only 3 can be met" in found.verdict()


def test_each_task_can_be_met_but_not_both(chain: ClosedChain) -> None:
    """A position and an orientation: three rows each, four free motions."""
    J = rows_of_object(chain)
    found = mobility(chain, task_rows=[("reach", J[:3]), ("turn", J[3:])])
    assert [t.rank for t in found.tasks] == [3, 3]
    assert (found.tasks_rows, found.tasks_rank) == (6, 4)
    assert "only 4 can be met" in found.verdict()


def test_tasks_that_can_be_met_say_what_is_left(chain: ClosedChain) -> None:
    found = mobility(chain, task_rows=[("reach", rows_of_object(chain)[:3])])
    assert (found.tasks_rows, found.tasks_rank) == (3, 3)
    assert "can all be met: 3 rows, 1 degrees of freedom left" in found.verdict()


def test_tasks_rank_does_not_depend_on_the_unit_of_the_task(chain: ClosedChain) -> None:
    """In micrometres or in kilometres, the same motions are free."""
    J = rows_of_object(chain)[:3]
    for unit in (1e6, 1e-3):
        assert mobility(chain, task_rows=[("reach", unit * J)]).tasks_rank == 3


def test_largest_task_is_the_object_freedom(chain: ClosedChain, firm: Mobility) -> None:
    """Any choice of rows of the object's twist: never more than four together."""
    J = rows_of_object(chain)
    ranks = [
        mobility(chain, task_rows=[("rows", J[list(rows)])], samples=1).tasks_rank
        for rows in itertools.combinations(range(6), 5)
    ]
    assert max(ranks) == firm.object_freedom == 4


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


def stretched_pair() -> ClosedChain:
    """The planar pair with its right arm stretched out."""
    robot = planar_pair().robot
    q = np.array([1.2, 0.0, 0.0, 1.1, 0.9, 0.4])
    return ClosedChain.take_hold(robot, q, Rigid(), HeldObject())


@pytest.mark.parametrize("rows", [[0, 1, 2], [2], [0, 2, 4], [3, 4, 5], [0, 1, 2, 4]])
def test_manipulability_by_hand(chain: ClosedChain, rows: list[int]) -> None:
    """sqrt(det(M M')) with M the twists along an orthonormal basis of the free motions."""
    for q, _ in closed_states(chain, 10):
        J = State(chain, q).J_task[rows].copy()
        M = J @ scipy.linalg.null_space(chain.loop_jacobian(q))
        determinant = max(np.linalg.det(M @ M.T), 0.0)
        assert manipulability(chain, q, J) == pytest.approx(math.sqrt(determinant), rel=1e-6)


def test_manipulability_is_zero_at_a_singular_pose() -> None:
    """And of more rows than there are freedoms."""
    pair, stretched = planar_pair(), stretched_pair()
    planar = [0, 1, 5]
    good = manipulability(pair, pair.q_start, rows_of_object(pair)[planar])
    lost = manipulability(stretched, stretched.q_start, rows_of_object(stretched)[planar])
    assert good > 1e-3
    assert lost < 1e-12
    assert manipulability(pair, pair.q_start, rows_of_object(pair)) == pytest.approx(0, abs=1e-15)


@pytest.mark.parametrize(
    ("asked", "message"),
    [
        (PAPER_SCHEME[:3], "found 3 joints, needs 4"),
        ([*PAPER_SCHEME, "LElbowYaw"], "found 5 joints, needs 4"),
        ([*PAPER_SCHEME[:3], "RElbowYaw"], "RElbowYaw given more than once"),
        ([*PAPER_SCHEME[:3], "LElbowYwa"], "unknown joint 'LElbowYwa'; did you mean 'LElbowYaw'"),
        ([], "found 0 joints, needs 4"),
    ],
)
def test_asked_for_scheme_that_is_none(chain: ClosedChain, asked: list[str], message: str) -> None:
    with pytest.raises((InvalidValueError, UnknownNameError), match=message):
        mobility(chain, asked=asked)


def test_passive_joint_is_no_part_of_a_scheme(hinged: ClosedChain) -> None:
    with pytest.raises(InvalidValueError, match="passive"):
        mobility(hinged, asked=[*hinged.joint_names[:5], "right.hinge"])


def coopqp_command(*words: str) -> Result:
    return CliRunner().invoke(main, ["mobility", *words], catch_exceptions=False)


def test_command_prints_json_alone() -> None:
    result = coopqp_command("point_on_point", "--json", "--actuated", "q1,q2,q3,q7")
    assert result.exit_code == 0
    found = json.loads(result.stdout)
    assert (found["rank"], found["freedom"], found["object_freedom"]) == (6, 4, 4)
    assert (found["inadmissible"], found["inadmissible_start"]) == (71, 91)
    assert found["schemes_total"] == len(found["schemes"]) == 210
    assert found["asked"]["joints"] == PAPER_SCHEME
    assert found["asked"]["admissible"]
    assert not found["asked"]["admissible_start"]
    assert len(found["lost_at_start"]) == 20
    assert [(t["name"], t["rows"], t["rank"]) for t in found["tasks"]] == [("reach", 3, 3)]
    assert len(found["impossible"]) == 2
    assert all(np.isfinite(found["manipulability"]["value"]))
    assert "4 degrees of freedom" in found["verdict"]


def test_command_prints_tables_and_a_verdict() -> None:
    result = coopqp_command("point_on_point")
    assert result.exit_code == 0
    text = " ".join(result.output.split())
    assert "71 of 210" in text
    assert "91 of 210" in text
    assert "can all be met" in text


@pytest.mark.parametrize(
    ("actuated", "message"),
    [
        ("q1,q2,q3", "found 3 joints, needs 4"),
        ("q1,q2,q3,q7,q8", "found 5 joints, needs 4"),
        ("q1,q2,q3,q3", "RElbowYaw given more than once"),
        ("q1,q2,q3,RElbowYaw", "RElbowYaw given more than once"),
        ("q1,q2,q3,q11", "unknown joint 'q11'"),
        ("RShoulderPich,q2,q3,q7", "did you mean 'RShoulderPitch'"),
        ("", "actuated"),
    ],
)
def test_wrong_schemes_end_with_one_message_and_exit_code_2(actuated: str, message: str) -> None:
    result = coopqp_command("point_on_point", "--actuated", actuated)
    assert result.exit_code == 2
    (line,) = result.stderr.strip().splitlines()
    assert line.startswith("error: ")
    assert message in line
    assert result.stdout == ""
