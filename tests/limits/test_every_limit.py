"""What every limit keeps: its bound after a step, names, no memory, room to stand still."""

from __future__ import annotations

import tracemalloc
from functools import partial

import laws
import numpy as np
import pytest
from example_limits import EXAMPLES, TABLE, TOLERANCE, by_name, empty_rows
from laws import DT, run

from coopqp.base.qp import names_of
from coopqp.base.spec import Pose as PoseSpec
from coopqp.controllers import QPController
from coopqp.grasps import Spherical
from coopqp.limit import SHALLOW, Limit, LimitRows, damp
from coopqp.limits import (
    JointAcceleration,
    JointPosition,
    JointVelocity,
    ObjectSpeed,
    SelfCollision,
)
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.grasp_configuration import HeldObject
from coopqp.model.profile import Profile
from coopqp.model.state import State
from coopqp.robot import RobotModel
from coopqp.tasks import JointCentering, Pose

problem = partial(laws.problem, secondary=(JointCentering(gain=0.5),))


@pytest.mark.parametrize("seed", range(5))
def test_every_limit_holds_in_random_runs(held_box: ClosedChain, seed: int) -> None:
    rng = np.random.default_rng(seed)
    place = State(held_box).p_WO + rng.uniform(-0.15, 0.15, 3)
    profile = Profile(duration=float(rng.uniform(0.3, 1.0)))
    goal = PoseSpec(position=tuple(place), rpy=tuple(rng.uniform(-0.8, 0.8, 3)))
    done = run(
        QPController(), problem(held_box, Pose(goal=goal, profile=profile), limits=EXAMPLES), 150
    )
    given_up = "ACCELERATION_GIVEN_UP" in done.status
    for limit in EXAMPLES:
        if given_up and isinstance(limit, JointAcceleration):
            continue
        for name, margin in by_name(limit.margins(held_box, done.q, done.v, DT)).items():
            kind = name.removeprefix("limit.").split(".")[0].split("[")[0]
            assert margin.shape == (150,)
            assert margin.min() >= -TOLERANCE.get(kind, 1e-9), name


def test_rows_and_margins_have_names_of_their_own(held_box: ClosedChain) -> None:
    rows = [name for limit in EXAMPLES for name in names_of(limit.rows(held_box))]
    assert len(set(rows)) == len(rows)
    assert {"limit.object_speed.x.upper", "limit.object_speed.rot_z.lower"} <= set(rows)
    assert {"limit.table.object[0]", "limit.table.object[7]", "limit.table.RHand"} <= set(rows)
    assert "limit.self_collision[RForearm|torso]" in rows
    q = np.vstack([held_box.q_start] * 2)
    margins = [
        name
        for limit in EXAMPLES
        for name in by_name(limit.margins(held_box, q, np.zeros((1, held_box.n)), DT))
    ]
    assert len(set(margins)) == len(margins)
    # Corners belong to whichever pairs are closest; their margins are those of the pairs.
    assert {name for name in rows if ".corner[" not in name} <= set(margins)
    assert {
        "limit.position[RElbowRoll].upper",
        "limit.velocity[RElbowRoll].lower",
        "limit.acceleration[RElbowRoll].upper",
        "limit.braking[RElbowRoll].lower",
    } <= set(margins)


def test_margins_are_negative_where_a_limit_is_broken(held_box: ClosedChain) -> None:
    q = np.vstack([held_box.q_start] * 3)
    i = held_box.joint_names.index("RElbowRoll")
    q[2, i] = held_box.upper[i] + 0.1
    v = np.zeros((2, held_box.n))
    v[1, i] = held_box.velocity[i] + 1.0
    position = by_name(JointPosition().margins(held_box, q, v, DT))[
        "limit.position[RElbowRoll].upper"
    ]
    velocity = by_name(JointVelocity().margins(held_box, q, v, DT))[
        "limit.velocity[RElbowRoll].upper"
    ]
    assert position[0] > 0.0
    assert position[1] == pytest.approx(-0.1)
    assert velocity.tolist() == pytest.approx([held_box.velocity[i], -1.0])
    limit = JointAcceleration(max=20.0)
    change = by_name(limit.margins(held_box, q, v, DT))["limit.acceleration[RElbowRoll].upper"]
    assert change.tolist() == pytest.approx([20.0, 20.0 - (held_box.velocity[i] + 1.0) / DT])
    assert by_name(limit.margins(held_box, q, v, DT))["limit.braking[RElbowRoll].upper"][1] < 0.0


def test_unlimited_sides_have_no_margin(nao: RobotModel, held_box: ClosedChain) -> None:
    loose = ClosedChain.attach(nao, held_box.q_start, Spherical(), HeldObject())
    q, v = np.vstack([loose.q_start] * 2), np.zeros((1, loose.n))
    passive = loose.joint_names[loose.passive[0]]
    assert f"limit.velocity[{passive}].upper" not in by_name(
        JointVelocity().margins(loose, q, v, DT)
    )
    for limit in (JointPosition(), JointAcceleration(max=10.0), JointVelocity()):
        assert all(np.isfinite(m).all() for m in by_name(limit.margins(loose, q, v, DT)).values())


@pytest.mark.parametrize("limit", EXAMPLES, ids=lambda limit: type(limit).__name__)
def test_a_tick_keeps_no_memory(held_box: ClosedChain, limit: Limit) -> None:
    state, rows = State(held_box), empty_rows(held_box, limit)
    tighten = limit.bind(held_box, DT)
    for _ in range(600):  # the allocators keep small blocks of the first ticks
        tighten(state, rows)
    tracemalloc.start()
    try:
        tighten(state, rows)
        before, _ = tracemalloc.get_traced_memory()
        tracemalloc.reset_peak()
        for _ in range(50):
            tighten(state, rows)
        after, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert after - before < 512  # bytes
    assert peak - before < 16_000  # views and the numbers read from coal
    assert np.isfinite(rows.G).all()
    assert np.isfinite(rows.h).all()


@pytest.mark.parametrize("limit", EXAMPLES, ids=lambda limit: type(limit).__name__)
def test_rows_may_be_part_of_a_larger_matrix(held_box: ClosedChain, limit: Limit) -> None:
    plain, p = empty_rows(held_box, limit), len(names_of(limit.rows(held_box)))
    wide = np.zeros((p, held_box.n + 2))
    part = LimitRows(plain.lb.copy(), plain.ub.copy(), wide[:, : held_box.n], np.zeros(p))
    limit.bind(held_box, DT)(State(held_box), plain)
    limit.bind(held_box, DT)(State(held_box), part)
    assert np.array_equal(part.G, plain.G)
    assert not wide[:, held_box.n :].any()


@pytest.mark.parametrize(
    "limit", [TABLE, SelfCollision(), ObjectSpeed(linear=0.1, angular=0.1)], ids=repr
)
def test_standing_still_is_allowed_but_just_below_a_limit(
    held_box: ClosedChain, rng: np.random.Generator, limit: Limit
) -> None:
    state, rows = State(held_box), empty_rows(held_box, limit)
    tighten, names = limit.bind(held_box, DT), names_of(limit.rows(held_box))
    strip = limit.distance if isinstance(limit, SelfCollision) else SHALLOW
    deep = 0
    for q in held_box.sample(rng, 200):  # many with bodies in each other or under the table
        state.q[:] = q
        state.update()
        tighten(state, rows)
        assert np.isfinite(rows.G).all()
        margins = by_name(limit.margins(held_box, np.vstack([q, q]), np.zeros((1, held_box.n)), DT))
        h = rows.h[[name in margins for name in names]]  # without corners
        margin = np.array([margins[name][0] for name in names if name in margins])
        assert (h[(margin >= 0.0) | (margin < -strip)] >= 0.0).all()
        assert rows.h.min() >= -10.0 * strip  # what is asked back, at the default gain
        deep += int((margin < -strip).sum())
    assert deep > 30 or isinstance(limit, ObjectSpeed)


def test_what_sank_in_a_little_is_asked_back_and_what_started_deep_is_not() -> None:
    margin, h = np.array([0.02, 0.0, -0.5 * SHALLOW, -2.0 * SHALLOW]), np.zeros(4)
    damp(margin, np.full(4, 10.0), np.zeros(4, bool), h)
    assert h.tolist() == pytest.approx([0.2, 0.0, -5.0 * SHALLOW, 0.0])


IN_SPACE = [limit for limit in EXAMPLES if type(limit).clearance is not Limit.clearance]


@pytest.mark.parametrize("limit", IN_SPACE, ids=lambda limit: type(limit).__name__)
def test_rows_in_space_are_the_slope_of_what_is_left(limit: Limit, held_box: ClosedChain) -> None:
    """-G against central differences of the margin, at random configurations with closed loops.

    coal ends its search for the distance of what is round with a normal that is 1e-4 off.
    """
    rng = np.random.default_rng(0)
    left = limit.clearance(held_box)
    assert left
    allowed = np.array([2e-4 if "|post]" in row.name else 1e-6 for row in limit.rows(held_box)])
    for _ in range(5):
        state = State(held_box, held_box.q_start + rng.uniform(-0.1, 0.1, held_box.n))
        state.close_loops(20)
        q, rows = state.q.copy(), empty_rows(held_box, limit)
        rows.lb[:] = rows.ub[:] = 0.0  # at rest nothing looks farther ahead than the margin does
        limit.bind(held_box, DT)(state, rows)
        for i in range(held_box.n):
            step = 1e-6 * np.eye(held_box.n)[i]
            ahead, here, behind = (left(State(held_box, q + s * step)) for s in (1, 0, -1))
            # Where an edge takes over from another the distance has a kink.
            smooth = np.abs((ahead - here) - (here - behind)) < 1e-9
            assert smooth.mean() > 0.7
            slope, G = (ahead - behind) / 2e-6, rows.G[: len(here), i]  # others only help
            assert (np.abs(slope + G) <= allowed[: len(here)])[smooth].all()


@pytest.mark.parametrize("limit", IN_SPACE, ids=lambda limit: type(limit).__name__)
def test_an_eased_limit_leaves_so_much_more_and_nothing_else(
    limit: Limit, held_box: ClosedChain
) -> None:
    relaxed = limit.relaxed(0.004)
    assert relaxed
    assert type(relaxed) is type(limit)
    before, after = limit.clearance(held_box), relaxed.clearance(held_box)
    assert before
    assert after
    state = State(held_box)
    np.testing.assert_allclose(after(state) - before(state), 0.004, atol=1e-12)
    assert limit.rows(held_box) == relaxed.rows(held_box)


def test_limits_that_are_not_in_space_cannot_be_eased() -> None:
    assert {limit.relaxed(0.01) for limit in EXAMPLES if limit not in IN_SPACE} == {None}
    assert SelfCollision(distance=0.01).relaxed(0.02) is None


def test_rows_have_words_for_people(held_box: ClosedChain) -> None:
    corners = [row.label for row in TABLE.rows(held_box)]
    assert corners[0] == "the table, corner -x -y -z of the object"
    assert corners[7] == "the table, corner +x +y +z of the object"
    assert corners[8] == "the table, RHand"
    margins = JointPosition().margins(
        held_box, np.vstack([held_box.q_start] * 2), np.zeros((1, held_box.n)), DT
    )
    assert "RElbowRoll (upper)" in {row.label for row in margins}
