"""How hard hands can squeeze at rest, against the notes' figures and closed forms."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from pads import pressing, scenario_pads
from scenario_files import HEAD, LOADABLE, PHASES, TAIL, needs_robots, write
from scipy.linalg import block_diag
from scipy.optimize import linprog

import coopqp
from coopqp.base.errors import ScenarioError
from coopqp.base.spec import Array
from coopqp.closed_loop.forces import (
    Bound,
    Squeeze,
    StaticHold,
    contact_faults,
    contact_notes,
    forces,
)
from coopqp.closed_loop.grasp_matrix import grasp_matrix, section, walker
from coopqp.grasp import Contact
from coopqp.grasps import PointContact
from coopqp.model.closed_chain import ClosedChain
from coopqp.scenario.scenario import Scenario

G = 9.81  # [m/s2]

#: Scenario, mass [kg], half-lengths [m]: least and most squeeze [N] with whole pads; None where it
#: falls.
PADS = [
    ("point_on_point", 0.2, 0.02, (4.16, 12.1)),
    ("point_on_point", 0.5, 0.02, (10.4, 11.6)),
    ("point_on_point", 0.7, 0.02, None),
    ("two_pandas", 2.0, 0.03, (41.6, 226.0)),
    ("two_pandas", 8.0, 0.03, (166.0, 198.0)),
    ("two_pandas", 12.0, 0.03, None),
    ("baxter_tray", 2.0, 0.03, (41.6, 82.5)),
]


@pytest.mark.parametrize(("name", "mass", "half", "squeeze"), PADS)
def test_the_range_of_squeeze_of_the_notes(
    name: str, mass: float, half: float, squeeze: tuple[float, float] | None
) -> None:
    if name not in LOADABLE:
        pytest.skip("needs coopqp[robots]")
    found = forces(scenario_pads(name, mass, half, reach=1.0, least=0.0))
    (between,) = found.squeezes
    if squeeze is None:
        assert between.lower is between.upper is None
        assert found.load.value < 1.0
        assert "cannot hold the object" in " ".join(found.sentences())
        return
    assert between.lower
    assert between.upper
    assert between.lower.value == pytest.approx(squeeze[0], rel=5e-3)
    assert between.upper.value == pytest.approx(squeeze[1], rel=5e-3)
    assert {*between.lower.by} == {f"friction of {arm}" for arm in found.contacts}
    assert any(name.startswith("motor") for name in between.upper.by)


def at_corners(pad: Contact) -> tuple[Array, Array, Array]:
    """Wrench of forces at the corners that are counted on, (6, 12); rows <= most that they keep."""
    X, Y = (pad.reach * x for x in pad.half_lengths)
    m = pad.friction / 1.5 / math.sqrt(2.0)
    places = [(X, Y), (X, -Y), (-X, Y), (-X, -Y)]
    does = np.hstack([np.vstack([np.eye(3), pin.skew(np.array([*p, 0.0]))]) for p in places])
    square = np.array([[1, 0, -m], [-1, 0, -m], [0, 1, -m], [0, -1, -m]])
    _, _, fz, tx, ty, _ = does
    tilts = [tx - Y * fz, -tx - Y * fz, ty - X * fz, -ty - X * fz]
    rows = np.vstack([np.kron(np.eye(4), square), *tilts, -fz])
    return does, rows, -pad.min_force * np.array([0.0] * 16 + [Y, Y, X, X, 1.0])


def squeezed(chain: ClosedChain, hinged: Array | None = None) -> float:
    """The hardest squeeze by another program: torques, and forces at corners or whole wrenches.

    By pinocchio's Jacobians of the tips, which are the contacts' origins here.

    Args:
        chain: two hands.
        hinged: torques of the hands at passive joints; as gravity asks if omitted.
    """
    model, q, n = chain.model, chain.q_start, chain.n
    data, motors = model.createData(), [i for i in range(n) if i not in chain.passive]
    pin.computeJointJacobians(model, data, q)
    pin.framesForwardKinematics(model, data, q)
    tips = [data.oMf[model.getFrameId(arm.tip)].copy() for arm in chain.arms]
    way = tips[1].translation - tips[0].translation
    columns, cost = [np.vstack([np.eye(n)[:, motors], np.zeros((6, len(motors)))])], []
    kept: list[Array] = []
    most: list[Array] = []
    for frame, tip, arm, sign in zip(chain.frames, tips, chain.arms, (1.0, -1.0), strict=True):
        does, pad = np.eye(6), chain.grasps[arm.name].contact
        if pad:
            local, rows, right = at_corners(pad)
            does = np.kron(np.eye(2), tip.rotation @ pad.placement.rotation) @ local
            kept, most = [*kept, rows], [*most, right]
        J = pin.getFrameJacobian(model, data, frame, pin.LOCAL_WORLD_ALIGNED)
        J[:3] -= pin.skew(tip.translation - data.oMf[frame].translation) @ J[3:]
        to_origin = np.eye(6)
        to_origin[3:, :3] = pin.skew(tip.translation - chain.object_pose(q).translation)
        columns.append(np.vstack([-J.T @ does, to_origin @ does]))
        cost.append(-0.5 * sign * way / np.linalg.norm(way) @ does[:3])
    weight = [0.0, 0.0, chain.held.mass * G, 0.0, 0.0, 0.0]
    effort, k = model.effortLimit[motors], len(motors)
    own = pin.computeGeneralizedGravity(model, model.createData(), q)
    if hinged is not None:
        own[chain.passive] = -hinged
    limits = block_diag(np.zeros((0, k)), *kept), np.concatenate([*most, np.zeros(0)])
    found = linprog(
        np.concatenate([np.zeros(k), *cost]),
        A_ub=limits[0] if kept else None, b_ub=limits[1] if kept else None,
        A_eq=np.hstack(columns), b_eq=np.concatenate([own, weight]),
        bounds=[(-x, x) for x in effort] + [(None, None)] * sum(map(len, cost)), method="highs",
    )  # fmt: skip
    assert found.status == 0
    return -float(found.fun)


@pytest.mark.parametrize(
    ("name", "mass", "half"), [("point_on_point", 0.2, 0.02), ("two_pandas", 2.0, 0.03)]
)
@pytest.mark.parametrize("reach", [1.0, 0.95, 0.5])
def test_the_hardest_squeeze_is_that_of_forces_at_the_corners_that_are_counted_on(
    name: str, mass: float, half: float, reach: float
) -> None:
    if name not in LOADABLE:
        pytest.skip("needs coopqp[robots]")
    chain = scenario_pads(name, mass, half, reach=reach)
    (between,) = forces(chain).squeezes
    assert between.upper
    assert between.upper.value == pytest.approx(squeezed(chain), rel=1e-6)


def test_naos_hinges_bear_no_torque_of_the_weight_either() -> None:
    """20.1 N; 17.0 N where what is internal alone is free of them, and Walker's share is not."""
    chain = coopqp.load("passive_grasp_pose").chain
    hold = StaticHold(chain)
    row = section(*hold.points).rows[0]
    most = hold.extreme(row, 1.0)
    assert most
    assert most.value == pytest.approx(squeezed(chain), rel=1e-6)
    assert most.value == pytest.approx(20.1, abs=0.05)
    assert set(most.by) == {"motor RWristYaw", "motor LWristYaw"}
    origin = chain.object_pose(chain.q_start).translation
    carried = walker(hold.points, origin, np.array([0.5, 0.5])).X @ hold.weight
    J, at = chain.object_jacobians(chain.q_start), grasp_matrix(hold.points, origin)
    hinges = np.hstack([J[i].T @ at[:, 6 * i : 6 * i + 6] for i in range(2)])[chain.passive]
    assert np.abs(hinges @ carried).max() > 0.01  # no hinge bears that [N m]
    assert squeezed(chain, hinges @ carried) == pytest.approx(17.0, abs=0.05)


def test_the_least_squeeze_is_the_closed_form(chain: ClosedChain) -> None:
    """Two pads carry m g / 2 each along a pad's axis: m g / (2 mu / (sqrt(2) SF))."""
    for safety in (1.0, 1.5):
        (between,) = forces(pressing(chain, 0.2, 0.02), safety=safety).squeezes
        assert between.lower
        closed = 0.2 * G / (2.0 * 0.5 / (math.sqrt(2.0) * safety))
        assert between.lower.value == pytest.approx(closed, rel=1e-6)


@pytest.mark.parametrize(
    ("name", "alone", "free"),
    [("point_on_point", 10.1, 37.8), ("two_pandas", 131.0, 476.0), ("baxter_tray", 78.6, 110.0)],
)
def test_what_motors_can_squeeze_with_fastened_hands(name: str, alone: float, free: float) -> None:
    if name not in LOADABLE:
        pytest.skip("needs coopqp[robots]")
    hold = StaticHold(coopqp.load(name).chain)
    rows = section(*hold.points).rows
    most, others_zero = (
        hold.extreme(rows[0], 1.0),
        hold.extreme(rows[0], 1.0, (rows[1:], np.zeros(5))),
    )
    assert most
    assert others_zero
    assert most.value == pytest.approx(free, rel=5e-3)
    assert others_zero.value == pytest.approx(alone, rel=5e-3)


def test_the_wrenches_of_an_extreme_carry_the_object_within_the_motors(chain: ClosedChain) -> None:
    held = pressing(chain, 0.2, 0.02)
    hold = StaticHold(held, safety=1.5)
    found = hold.extreme(section(*hold.points).rows[0], 1.0)
    assert found is not None
    force, torque = found.h[:, :3], found.h[:, 3:]
    origin = held.object_pose(held.q_start).translation
    assert np.allclose(force.sum(axis=0), [0, 0, 0.2 * G], atol=1e-8)
    turned = np.cross(hold.points - origin, force) + torque
    assert np.allclose(turned.sum(axis=0), np.cross(np.zeros(3), force[0]), atol=1e-8)
    for hand, h, normal in zip(hold.hands, found.h, (1.0, -1.0), strict=True):
        assert hand.contact
        assert abs(h[1] * normal) > abs(h[0])  # it presses along the line between the hands


def test_a_contact_that_points_away_is_refused(chain: ClosedChain) -> None:
    good = pressing(chain, 0.2, 0.02)
    away = {
        name: type(grasp)(**{**_fields(grasp), "normal": tuple(-x for x in grasp.normal)})
        for name, grasp in good.grasps.items()
    }
    bad = ClosedChain.attach(chain.robot, chain.q_start, away, good.held)
    assert [arm for arm, words in contact_faults(bad) if "points away" in words] == [
        "right",
        "left",
    ]
    assert not [*contact_faults(good)]


def _fields(grasp: object) -> dict[str, object]:
    keys = ("normal", "along", "half_lengths", "friction")
    return {key: getattr(grasp, key) for key in keys}


def test_pads_beyond_the_face_are_told(chain: ClosedChain) -> None:
    """The box is 8 cm high and deep: pads of 2 x 5 cm stand out by a centimetre."""
    notes = [*contact_notes(pressing(chain, 0.2, 0.05))]
    assert any("the pad of right reaches 10.0 mm beyond the face" in note for note in notes)
    assert not any("reaches" in note for note in contact_notes(pressing(chain, 0.2, 0.02)))


PADDED = """\
robot: nao_t14
grasps:
  right: {surface_contact: {normal: [SIGN0.0323, SIGN0.0591, SIGN-0.1975], friction: MU,
                            half_lengths: [0.02, 0.02], along: [0.13, 0.944, 0.304]}}
  left: {surface_contact: {normal: [0.0323, -0.0591, -0.1975], half_lengths: [0.02, 0.02],
                           along: [0.13, -0.944, 0.304]}}
"""

TASKS = """\
tasks:
  - point_on_point: {name: reach, goal: [0.17, 0.01, 0.06], gain: 5, profile: {duration: 0.4}}
duration: 0.6
"""


def padded(mass: float, rest: str, sign: str = "", mu: str = "0.5") -> str:
    """A scenario of NAO with pads."""
    head = HEAD.split("grasp: {rigid: {}}\n")[1].replace("mass: 0.2", f"mass: {mass}")
    numbers = PADDED.replace("SIGN-", "-" if not sign else "").replace("SIGN", sign)
    return numbers.replace("MU", mu) + head + rest + TAIL


@pytest.mark.parametrize(
    ("sign", "mu", "mass", "words"),
    [
        ("", "0.5", 1.7, "grasps: cannot hold the object at rest: the hands carry "),
        ("-", "0.5", 0.2, "grasps.right: the contact's normal points away from the object"),
        ("", "0", 0.2, "friction: found 0; needs greater than 0"),
        ("", "-0.5", 0.2, "friction: found -0.5; needs greater than 0"),
    ],
)
def test_grasps_that_cannot_hold_are_refused_with_their_line(
    sign: str, mu: str, mass: float, words: str, tmp_path: Path
) -> None:
    with pytest.raises(ScenarioError) as error:
        coopqp.load(write(tmp_path, padded(mass, TASKS, sign, mu)))
    assert words in str(error.value)
    if "weight" in words:
        assert "motor RShoulderRoll" in str(error.value)


def test_a_pad_cannot_hold_alone(tmp_path: Path) -> None:
    """In the second phase the left hand lets go."""
    with pytest.raises(ScenarioError, match="one hand alone holds nothing by pressing"):
        coopqp.load(write(tmp_path, padded(0.2, PHASES)))
    assert coopqp.load(write(tmp_path, padded(0.2, TASKS))).chain.holding == 2


def refusal(**contact: object) -> str:
    """Of ``press_and_lift`` with other contacts."""
    scenario = coopqp.load("press_and_lift")
    grasps = {arm: replace(grasp, **contact) for arm, grasp in scenario.grasps.items()}  # type: ignore[attr-defined]
    return " ".join(words for _, words in contact_faults(replace(scenario, grasps=grasps).chain))


@needs_robots
def test_a_least_force_that_no_motor_bears_is_blamed_itself() -> None:
    """219 N is the most that the motors do."""
    assert "the least force of left/arm and least force of right/arm is more" in refusal(
        least=300.0
    )
    assert refusal(least=30.0) == ""


@needs_robots
def test_hands_that_carry_next_to_nothing_do_not_carry_less_than_that() -> None:
    assert "the hands carry 0 % of its weight; friction of" in refusal(friction=1e-9)


def fingertips(start: Scenario, turned: float) -> str:
    """Two fingertips instead of the pads, each turned about y by so many degrees."""
    tips = {
        arm: PointContact(
            friction=0.5,
            normal=(float(np.sin(np.radians(turned))), 0.0, float(np.cos(np.radians(turned)))),
            object_in_hand=grasp.object_in_hand,
        )
        for arm, grasp in start.grasps.items()  # type: ignore[attr-defined]
    }
    return " ".join(words for _, words in contact_faults(replace(start, grasps=tips).chain))


@needs_robots
def test_two_fingertips_are_told_what_they_do_not_hold() -> None:
    scenario = coopqp.load("press_and_lift")
    aside = replace(scenario, held=replace(scenario.held, com=(0.0, 0.02, 0.0)))
    said = "a turn about the line between the two fingertips, 20 mm beside its mass"
    assert said in fingertips(aside, 0.0)
    assert "points 40 degrees away from the other hand" in fingertips(scenario, 40.0)
    assert "of 0.5 allows 27" in fingertips(scenario, 40.0)


@pytest.mark.parametrize(
    ("least", "most", "words"),
    [
        (4.0, 12.0, "4 to 12 N (least by friction of left; most by motor a)"),
        (4.0, np.inf, "from 4 N (by friction of left), unlimited above"),
        (-np.inf, 12.0, "up to 12 N (by motor a), unlimited below"),
        (-np.inf, np.inf, "unlimited"),
    ],
)
def test_words_of_a_squeeze(least: float, most: float, words: str) -> None:
    ends = Bound(least, ("friction of left",), np.zeros(0)), Bound(most, ("motor a",), np.zeros(0))
    assert Squeeze(("right", "left"), *ends).summary == words


def test_motors_that_bound_a_squeeze_from_both_sides_are_named_once() -> None:
    ends = (Bound(end, by, np.zeros(0)) for end, by in ((-9.0, ("a", "b")), (9.0, ("b", "a"))))
    assert Squeeze(("right", "left"), *ends).summary == "-9 to 9 N (both by a and b)"
