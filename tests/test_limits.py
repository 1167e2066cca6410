"""Limits hold after integration, alone and in closed-loop runs; distances against closed forms."""

from __future__ import annotations

import itertools
import math
import tracemalloc
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
import pytest
import qpsolvers
from numpy.typing import NDArray

from coopqp.checked import Pose as PoseSpec
from coopqp.closed_chain import ClosedChain
from coopqp.controller import ControlProblem
from coopqp.controllers import QPController
from coopqp.errors import InvalidValueError, UnknownNameError
from coopqp.grasps import Rigid, Spherical
from coopqp.held_object import HeldObject
from coopqp.limit import SHALLOW, Limit, LimitRows, damp
from coopqp.limits import (
    JointAcceleration,
    JointPosition,
    JointVelocity,
    ObjectSpeed,
    SelfCollision,
    Workspace,
)
from coopqp.profile import Profile
from coopqp.robot import Capsule, RobotModel
from coopqp.robots import PlanarPair
from coopqp.solvers import Daqp
from coopqp.state import State
from coopqp.task import Task
from coopqp.tasks import JointCentering, PointOnPoint, Pose

Array = NDArray[np.float64]

DT = 0.01  # [s]
TABLE = Workspace(name="table", normal=(0, 0, 1), through=(0, 0, -0.02), frames=("RHand", "LHand"))
ALL = (
    JointPosition(),
    JointVelocity(),
    JointAcceleration(max=60.0),
    ObjectSpeed(linear=0.15, angular=1.0),
    TABLE,
    SelfCollision(),
)

#: What a limit may be off by after a step: second order in the step for curved things.
TOLERANCE = {"table": 1e-6, "self_collision": 1e-6, "object_speed": 1e-6, "acceleration": 1e-6}


@dataclass(frozen=True)
class Run:
    """What a closed-loop run did: shapes (T + 1, n), (T, n) and T statuses."""

    q: Array
    v: Array
    fallback: list[str]


def run(chain: ClosedChain, tasks: Sequence[Task], limits: Sequence[Limit], ticks: int) -> Run:
    """A loop of one's own around the QP."""
    problem = ControlProblem(
        chain=chain, tasks=tasks, limits=limits, solver=Daqp(), dt=DT, kappa=1.0 / DT,
        secondary=[JointCentering(gain=0.5)],
    )  # fmt: skip
    law = QPController().build(problem)
    state = law.start()
    q, v, fallback = [state.q.copy()], [], []
    for _ in range(ticks):
        state.update()
        command = law.tick(state)
        if not command.status.usable or command.status.fallback:
            fallback.append(command.status.name)
        v.append(command.v.copy())
        state.v[:] = command.v
        state.q += command.v * DT
        state.t += DT
        q.append(state.q.copy())
    return Run(np.array(q), np.array(v), fallback)


def least(limit: Limit, chain: ClosedChain, done: Run) -> float:
    """Least margin of a limit over a run."""
    return min(float(m.min()) for m in limit.margins(chain, done.q, done.v, DT).values())


def empty_rows(chain: ClosedChain, limit: Limit) -> LimitRows:
    n, p = chain.n, len(limit.rows(chain))
    return LimitRows(np.full(n, -8.0), np.full(n, 8.0), np.full((p, n), np.nan), np.full(p, np.nan))


@pytest.fixture(scope="module")
def held_box(nao: RobotModel) -> ClosedChain:
    q = nao.configuration(
        {"right": [0.7, -0.2, 1.2, 0.9, 0.1], "left": [0.7, 0.2, -1.2, -0.9, -0.1]}
    )
    return ClosedChain.take_hold(nao, q, Rigid(), HeldObject(size=(0.08, 0.19, 0.08)))


# ---- all limits -------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(5))
def test_every_limit_holds_in_random_runs(held_box: ClosedChain, seed: int) -> None:
    rng = np.random.default_rng(seed)
    place = State(held_box).p_WO + rng.uniform(-0.15, 0.15, 3)
    profile = Profile(duration=float(rng.uniform(0.3, 1.0)))
    goal = PoseSpec(position=tuple(place), rpy=tuple(rng.uniform(-0.8, 0.8, 3)))
    done = run(held_box, [Pose(goal=goal, profile=profile)], ALL, 150)
    given_up = "ACCELERATION_GIVEN_UP" in done.fallback
    for limit in ALL:
        if given_up and isinstance(limit, JointAcceleration):
            continue
        for name, margin in limit.margins(held_box, done.q, done.v, DT).items():
            kind = name.removeprefix("limit.").split(".")[0].split("[")[0]
            assert margin.shape == (150,)
            assert margin.min() >= -TOLERANCE.get(kind, 1e-9), name


def test_rows_and_margins_have_names_of_their_own(held_box: ClosedChain) -> None:
    rows = [name for limit in ALL for name in limit.rows(held_box)]
    assert len(set(rows)) == len(rows)
    assert {"object_speed.x.upper", "object_speed.rot_z.lower"} <= set(rows)
    assert {"table.object[0]", "table.object[7]", "table.RHand"} <= set(rows)
    assert "self_collision[RForearm|torso]" in rows
    q = np.vstack([held_box.q_start] * 2)
    margins = [
        name for limit in ALL for name in limit.margins(held_box, q, np.zeros((1, held_box.n)), DT)
    ]
    assert len(set(margins)) == len(margins)
    assert {f"limit.{name}" for name in rows} <= set(margins)
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
    position = JointPosition().margins(held_box, q, v, DT)["limit.position[RElbowRoll].upper"]
    velocity = JointVelocity().margins(held_box, q, v, DT)["limit.velocity[RElbowRoll].upper"]
    assert position[0] > 0.0
    assert position[1] == pytest.approx(-0.1)
    assert velocity.tolist() == pytest.approx([held_box.velocity[i], -1.0])
    limit = JointAcceleration(max=20.0)
    change = limit.margins(held_box, q, v, DT)["limit.acceleration[RElbowRoll].upper"]
    assert change.tolist() == pytest.approx([20.0, 20.0 - (held_box.velocity[i] + 1.0) / DT])
    assert limit.margins(held_box, q, v, DT)["limit.braking[RElbowRoll].upper"][1] < 0.0


def test_unlimited_sides_have_no_margin(nao: RobotModel, held_box: ClosedChain) -> None:
    loose = ClosedChain.take_hold(nao, held_box.q_start, Spherical(), HeldObject())
    q, v = np.vstack([loose.q_start] * 2), np.zeros((1, loose.n))
    passive = loose.joint_names[loose.passive[0]]
    assert f"limit.velocity[{passive}].upper" not in JointVelocity().margins(loose, q, v, DT)
    for limit in (JointPosition(), JointAcceleration(max=10.0), JointVelocity()):
        assert all(np.isfinite(m).all() for m in limit.margins(loose, q, v, DT).values())


@pytest.mark.parametrize("limit", ALL, ids=lambda limit: type(limit).__name__)
def test_a_tick_keeps_no_memory(held_box: ClosedChain, limit: Limit) -> None:
    state, rows = State(held_box), empty_rows(held_box, limit)
    tighten = limit.bind(held_box, DT)
    for _ in range(5):
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


@pytest.mark.parametrize("limit", ALL, ids=lambda limit: type(limit).__name__)
def test_rows_may_be_part_of_a_larger_matrix(held_box: ClosedChain, limit: Limit) -> None:
    plain, p = empty_rows(held_box, limit), len(limit.rows(held_box))
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
    tighten, names = limit.bind(held_box, DT), limit.rows(held_box)
    deep = 0
    for q in held_box.sample(rng, 200):  # many with bodies in each other or under the table
        state.q[:] = q
        state.update()
        tighten(state, rows)
        assert np.isfinite(rows.G).all()
        margins = limit.margins(held_box, np.vstack([q, q]), np.zeros((1, held_box.n)), DT)
        room = np.array([margins[f"limit.{name}"][0] for name in names])
        assert (rows.h[(room >= 0.0) | (room < -SHALLOW)] >= 0.0).all()
        assert rows.h.min() >= -10.0 * SHALLOW  # what is asked back, at the default gain
        deep += int((room < -SHALLOW).sum())
    assert deep > 30 or isinstance(limit, ObjectSpeed)


def test_what_sank_in_a_little_is_asked_back_and_what_started_deep_is_not() -> None:
    room, h = np.array([0.02, 0.0, -0.5 * SHALLOW, -2.0 * SHALLOW]), np.zeros(4)
    damp(room, np.full(4, 10.0), np.zeros(4, bool), h)
    assert h.tolist() == pytest.approx([0.2, 0.0, -5.0 * SHALLOW, 0.0])


# ---- acceleration -----------------------------------------------------------------------------


def bounds_alone(chain: ClosedChain, limit: Limit, state: State, dt: float) -> LimitRows:
    rows = LimitRows(-chain.velocity, chain.velocity.copy(), np.zeros((0, chain.n)), np.zeros(0))
    JointPosition().bind(chain, dt)(state, rows)
    limit.bind(chain, dt)(state, rows)
    return rows


@pytest.mark.parametrize(("a", "dt"), [(5.0, 0.01), (40.0, 0.01), (37.3, 0.004), (120.0, 0.02)])
@pytest.mark.parametrize("side", [1.0, -1.0])
def test_full_speed_against_the_stop_brakes_in_time(
    held_box: ClosedChain, a: float, dt: float, side: float
) -> None:
    limit, state = JointAcceleration(max=a), State(held_box)
    end = held_box.upper if side > 0 else held_box.lower
    fastest = np.zeros(held_box.n)
    for _ in range(int(3.0 / dt)):
        rows = bounds_alone(held_box, limit, state, dt)
        assert (rows.lb <= rows.ub).all()
        v = rows.ub if side > 0 else rows.lb
        assert (np.abs(v - state.v) <= a * dt * (1 + 1e-9)).all()
        fastest = np.maximum(fastest, np.abs(v))
        state.v[:] = v
        state.q += v * dt
        assert (side * (end - state.q) >= -1e-12).all()
    assert (fastest > 1.5).all()  # they did run
    assert np.allclose(state.q, end, atol=1e-9)
    assert np.allclose(state.v, 0.0, atol=1e-7)


def test_the_braking_bound_is_the_closed_form_at_whole_ticks(held_box: ClosedChain) -> None:
    a, limit, state = 40.0, JointAcceleration(max=40.0), State(held_box)
    for ticks in range(1, 12):
        v = ticks * a * DT
        room = v**2 / (2.0 * a) + v * DT / 2.0
        state.q[:], state.v[:] = held_box.upper - room, v
        bound = -a * DT / 2.0 + math.sqrt((a * DT / 2.0) ** 2 + 2.0 * a * room)
        rows = LimitRows(
            np.full(held_box.n, -99.0), np.full(held_box.n, 99.0),
            np.zeros((0, held_box.n)), np.zeros(0),
        )  # fmt: skip
        limit.bind(held_box, DT)(state, rows)
        assert np.allclose(rows.ub, bound)
        assert bound == pytest.approx(v)


def test_joints_may_have_accelerations_of_their_own(held_box: ClosedChain) -> None:
    limit = JointAcceleration(max=10.0, joints={"LWristYaw": 3.0})
    state, rows = State(held_box), empty_rows(held_box, limit)
    limit.bind(held_box, DT)(state, rows)
    slow = held_box.joint_names.index("LWristYaw")
    assert rows.ub[slow] == pytest.approx(0.03)
    assert np.delete(rows.ub, slow) == pytest.approx(0.1)
    with pytest.raises(UnknownNameError, match="did you mean 'LWristYaw'"):
        JointAcceleration(max=10.0, joints={"LWristYow": 3.0}).bind(held_box, DT)


def test_acceleration_gives_way_to_the_other_limits(held_box: ClosedChain) -> None:
    limit, state = JointAcceleration(max=1.0), State(held_box)
    state.q[:] = held_box.upper - 1e-4
    state.v[:] = 5.0  # too fast to stop in time
    rows = bounds_alone(held_box, limit, state, DT)
    assert (rows.lb <= rows.ub).all()
    assert (rows.ub * DT <= 1e-4 + 1e-12).all()
    assert JointAcceleration.sacrificed_first
    assert not JointPosition.sacrificed_first


def test_acceleration_holds_over_a_whole_run(held_box: ClosedChain) -> None:
    limit = JointAcceleration(max=20.0)
    reach = PointOnPoint(goal=(0.13, 0.05, -0.05), profile=Profile(duration=0.3))
    done = run(held_box, [reach], [JointPosition(), JointVelocity(), limit], 200)
    assert not done.fallback
    change = np.diff(done.v, axis=0, prepend=np.zeros((1, held_box.n))) / DT
    assert np.abs(change).max() <= 20.0 + 1e-6
    assert np.abs(change).max() > 19.9


# ---- object -----------------------------------------------------------------------------------


def test_the_object_keeps_its_speed(held_box: ClosedChain) -> None:
    limit = ObjectSpeed(linear=0.06, angular=0.3)
    goal = PoseSpec(position=(0.14, 0.04, 0.1), rpy=(0.3, 0.2, 0.3))
    done = run(held_box, [Pose(goal=goal, profile=Profile(duration=0.2))], [limit], 150)
    state, places, turns = State(held_box), [], []
    for q in done.q:
        state.q[:] = q
        state.update()
        places.append(state.p_WO.copy())
        turns.append(state.R_WO.copy())
    speed = np.abs(np.diff(places, axis=0)) / DT
    spin = np.abs([pin.log3(b @ a.T) for a, b in itertools.pairwise(turns)]) / DT
    # The mean over a tick differs from the velocity at its start by the curvature of the path.
    assert 0.0599 < speed.max() < 0.0625
    assert 0.299 < spin.max() < 0.31
    assert least(limit, held_box, done) > -1e-6


def test_one_kind_of_speed_has_six_rows(held_box: ClosedChain) -> None:
    assert len(ObjectSpeed(angular=1.0).rows(held_box)) == 6
    state, limit = State(held_box), ObjectSpeed(angular=1.0)
    rows = empty_rows(held_box, limit)
    limit.bind(held_box, DT)(state, rows)
    assert np.array_equal(rows.G, np.vstack([state.J_task[3:], -state.J_task[3:]]))
    with pytest.raises(ValueError, match="needs linear"):
        ObjectSpeed()


# ---- workspace --------------------------------------------------------------------------------


@pytest.mark.parametrize("duration", [0.3, 2.0])
def test_a_box_pushed_through_a_table_stops_on_it(held_box: ClosedChain, duration: float) -> None:
    push = PointOnPoint(goal=(0.15, 0.03, -0.08), profile=Profile(duration=duration))
    done = run(held_box, [push], [JointPosition(), JointVelocity(), TABLE], 250)
    state, lowest = State(held_box), []
    half = 0.5 * np.array(held_box.held.size)
    for q in done.q:
        state.q[:] = q
        state.update()
        lowest.append(state.p_WO[2] - np.abs(state.R_WO[2]) @ half)  # a box's support
    height = np.array(lowest) + 0.02
    assert height.min() >= -1e-6
    assert height[-1] < 1e-4
    assert min(least(TABLE, held_box, done), 0.0) == pytest.approx(
        min(height[1:].min(), 0.0), abs=1e-9
    )


def test_workspace_rows_are_the_rate_of_the_distances(
    held_box: ClosedChain, closed_loop_walk: object
) -> None:
    tilted = Workspace(
        normal=(0.3, -0.4, 1.2), through=(0.1, 0.2, -0.3), frames=("RHand", "LElbowRoll")
    )
    step, state, rows = 1e-6, State(held_box), empty_rows(held_box, tilted)
    for q in closed_loop_walk(held_box, 3):  # type: ignore[operator]
        state.q[:] = q
        state.update()
        tilted.bind(held_box, DT)(state, rows)
        for i in range(held_box.n):
            path = np.vstack([q, q, q])
            path[1, i] += step
            path[2, i] -= step
            margins = tilted.margins(held_box, path, np.zeros((2, held_box.n)), DT)
            slope = [(m[0] - m[1]) / (2 * step) for m in margins.values()]
            # Loops open a little here; the object's mean turn is linear to first order only.
            assert np.allclose(-rows.G[:, i], slope, atol=1e-5)


def test_workspace_refuses_what_it_cannot_watch(held_box: ClosedChain) -> None:
    with pytest.raises(UnknownNameError, match="did you mean 'RHand'"):
        Workspace(normal=(0, 0, 1), through=(0, 0, 0), frames=("RHnd",)).rows(held_box)
    with pytest.raises(InvalidValueError, match="overshoot"):
        Workspace(normal=(0, 0, 1), through=(0, 0, 0), gain=101.0).bind(held_box, DT)
    with pytest.raises(ValueError, match="points of the object or frames"):
        Workspace(normal=(0, 0, 1), through=(0, 0, 0), points=())


def test_points_given_replace_the_corners(held_box: ClosedChain) -> None:
    limit = Workspace(normal=(0, 0, 2), through=(0, 0, 0), points=((0.0, 0.0, -0.1),))
    assert limit.rows(held_box) == ("workspace.object[0]",)
    q = np.vstack([held_box.q_start] * 2)
    margins = limit.margins(held_box, q, np.zeros((1, held_box.n)), DT)
    height = State(held_box).p_WO[2] - 0.1
    assert margins["limit.workspace.object[0]"][0] == pytest.approx(height)


# ---- self-collision ---------------------------------------------------------------------------


def between_segments(a: Array, b: Array, c: Array, d: Array) -> float:
    """Distance of two segments: inside both, or from an end of one to the other."""
    u, w, r = b - a, d - c, a - c
    uu, uw, ww = u @ u, u @ w, w @ w
    det = uu * ww - uw * uw
    found = [to_segment(a, c, d), to_segment(b, c, d), to_segment(c, a, b), to_segment(d, a, b)]
    if det > 1e-12:
        s, t = (uw * (w @ r) - ww * (u @ r)) / det, (uu * (w @ r) - uw * (u @ r)) / det
        if 0.0 <= s <= 1.0 and 0.0 <= t <= 1.0:
            found.append(float(np.linalg.norm(r + s * u - t * w)))
    return min(found)


def to_segment(p: Array, a: Array, b: Array) -> float:
    t = np.clip((p - a) @ (b - a) / ((b - a) @ (b - a)), 0.0, 1.0)
    return float(np.linalg.norm(p - a - t * (b - a)))


def to_box(a: Array, b: Array, X_WO: pin.SE3, size: Array) -> float:
    """Distance from a segment outside a box to it: convex along the segment, so thirds do."""

    def at(t: float) -> float:
        p = X_WO.actInv(a + t * (b - a))
        return float(np.linalg.norm(np.maximum(np.abs(p) - 0.5 * size, 0.0)))

    low, high = 0.0, 1.0
    for _ in range(80):
        one, other = low + (high - low) / 3.0, high - (high - low) / 3.0
        low, high = (low, other) if at(one) < at(other) else (one, high)
    return at(0.5 * (low + high))


class Oracle:
    """Where the capsules and the box are, without coal."""

    def __init__(self, chain: ClosedChain) -> None:
        self.chain, self.data = chain, chain.model.createData()
        self.capsules = {c.name: c for c in chain.robot.capsules}

    def segment(self, capsule: Capsule) -> tuple[Array, Array]:
        joint = self.chain.model.getJointId(capsule.joint) if capsule.joint else 0
        X = self.data.oMi[joint]
        return X.act(np.array(capsule.start)), X.act(np.array(capsule.end))

    def distance(self, pair: str, q: Array) -> float:
        """Of the pair in "self_collision[A|B]", less the radii; not below what touches."""
        pin.framesForwardKinematics(self.chain.model, self.data, q)
        one, other = pair.split("[")[1].rstrip("]").split("|")
        if "object" in (one, other):
            capsule = self.capsules[other if one == "object" else one]
            X_WO = self.data.oMf[self.chain.frames[0]]
            size = np.array(self.chain.held.size)
            return to_box(*self.segment(capsule), X_WO, size) - capsule.radius
        a, b = self.capsules[one], self.capsules[other]
        return between_segments(*self.segment(a), *self.segment(b)) - a.radius - b.radius


def test_distances_are_those_of_closed_forms(held_box: ClosedChain) -> None:
    rng, oracle, limit = np.random.default_rng(3), Oracle(held_box), SelfCollision(distance=0.0)
    q = held_box.sample(rng, 120)
    margins = limit.margins(held_box, q, np.zeros((119, held_box.n)), DT)
    compared = 0
    for name, margin in margins.items():
        for row, d in zip(q[1:], margin, strict=True):
            wanted = oracle.distance(name, row)
            if "object" in name and d < 0.0:  # the closed form ends where the segment goes in
                continue
            assert d == pytest.approx(wanted, abs=2e-6), name
            compared += 1
    assert compared > 1500


def test_collision_rows_are_the_rate_of_the_distances(held_box: ClosedChain) -> None:
    rng, limit, step = np.random.default_rng(4), SelfCollision(distance=0.0), 1e-5
    state, rows = State(held_box), empty_rows(held_box, limit)
    tighten = limit.bind(held_box, DT)
    capsules = [i for i, name in enumerate(limit.rows(held_box)) if "object" not in name]
    off = []
    for q in held_box.sample(rng, 60):
        state.q[:] = q
        state.update()
        tighten(state, rows)
        v = rng.normal(size=held_box.n)
        path = np.vstack([q, q + step * v, q - step * v])
        margins = limit.margins(held_box, path, np.zeros((2, held_box.n)), DT)
        slope = np.array([(m[0] - m[1]) / (2 * step) for m in margins.values()])
        off.append(np.abs(slope + rows.G @ v))
    # Closed form between capsules; to the box, coal iterates to 1e-6 m.
    assert np.max(np.array(off)[:, capsules]) < 1e-4
    assert np.median(off) < 1e-6
    assert np.mean(np.array(off) < 1e-3) > 0.99


def test_no_pair_is_too_close_where_robots_start(held_box: ClosedChain) -> None:
    limit = SelfCollision()
    middle = 0.5 * (held_box.lower + held_box.upper)
    q = np.vstack([held_box.q_start, held_box.q_start, middle, 0.0 * middle])
    assert all(
        m.min() > 0.0 for m in limit.margins(held_box, q, np.zeros((3, held_box.n)), DT).values()
    )


@pytest.mark.parametrize(
    ("goal", "blocked"),
    [((0.02, 0.0, 0.05), "object|torso"), ((0.02, -0.05, 0.05), "LForearm|torso")],
)
@pytest.mark.parametrize("gain", [10.0, 50.0])
def test_what_is_pulled_into_the_torso_stops_before_it(
    held_box: ClosedChain, goal: tuple[float, float, float], blocked: str, gain: float
) -> None:
    limit, oracle = SelfCollision(gain=gain), Oracle(held_box)
    pull = PointOnPoint(goal=goal, profile=Profile(duration=0.5))
    done = run(held_box, [pull], [JointPosition(), JointVelocity(), limit], 250)
    distances = {
        name: [oracle.distance(name, q) for q in done.q[::5]] for name in limit.rows(held_box)
    }
    assert min(map(min, distances.values())) >= limit.distance - 1e-4
    assert least(limit, held_box, done) >= -1e-4
    if gain == 10.0:
        assert min(distances[f"self_collision[{blocked}]"]) < limit.distance + 1e-3


def test_forearms_and_hands_driven_together_stop_apart(held_box: ClosedChain) -> None:
    """Without loops: elbows bend in while shoulders press the arms together."""
    pairs = tuple(itertools.product(("RForearm", "RHand"), ("LForearm", "LHand")))
    limit = SelfCollision(pairs=pairs)
    state, oracle, robot = State(held_box), Oracle(held_box), held_box.robot
    inward = robot.configuration({"right": [0, 1, 0, 2, 0.3], "left": [0, -1, 0, -2, 0.2]})
    state.q[:] = robot.configuration({"right": [0, -0.3, 0, 0.2, 0], "left": [0, 0.1, 0, -0.3, 0]})
    rows = empty_rows(held_box, limit)
    tighten, stay, nearest = limit.bind(held_box, DT), JointPosition().bind(held_box, DT), []
    for _ in range(200):
        state.update()
        rows.lb[:], rows.ub[:] = -held_box.velocity, held_box.velocity
        stay(state, rows)
        tighten(state, rows)
        v = qpsolvers.solve_qp(
            np.eye(held_box.n), -inward, rows.G, rows.h, lb=rows.lb, ub=rows.ub, solver="daqp"
        )
        assert v is not None
        state.q += v * DT
        nearest.append(min(oracle.distance(name, state.q) for name in limit.rows(held_box)))
    assert nearest[0] > 0.05
    assert min(nearest) >= limit.distance - 1e-4
    assert min(nearest) < limit.distance + 1e-3


def test_bodies_in_each_other_give_finite_rows(nao: RobotModel, held_box: ClosedChain) -> None:
    def robot(*capsules: Capsule) -> RobotModel:
        return RobotModel(name="nao", model=nao.model, arms=nao.arms, capsules=capsules)

    def at(name: str, joint: str | None, start: tuple[float, float, float], z: float) -> Capsule:
        end = (start[0], start[1], start[2] + z)
        return Capsule(name=name, joint=joint, start=start, end=end, radius=0.03)

    here = (0.0, 0.0, 0.0)
    shoulder = (0.0, -0.098, 0.1)  # where joint RShoulderPitch is
    same = robot(at("a", None, shoulder, 0.0), at("b", "RShoulderPitch", here, 0.0))
    along = robot(at("a", None, shoulder, 0.1), at("b", "RShoulderPitch", here, 0.1))
    for model in (same, along):
        chain = ClosedChain.take_hold(model, held_box.q_start, Rigid(), HeldObject())
        limit = SelfCollision(pairs=(("b", "a"), ("object", "a")))
        rows = empty_rows(chain, limit)
        limit.bind(chain, DT)(State(chain), rows)
        assert np.isfinite(rows.G).all()
        assert (rows.h[:1] == 0.0).all()


def test_bodies_that_the_grasps_fix_to_each_other_are_no_pair(
    nao: RobotModel, held_box: ClosedChain
) -> None:
    hands = "self_collision[RHand|LHand]"
    assert hands not in SelfCollision().rows(held_box)
    loose = ClosedChain.take_hold(nao, held_box.q_start, Spherical(), HeldObject())
    assert hands in SelfCollision().rows(loose)
    assert not any("Hand" in n for n in SelfCollision().rows(loose) if "object" in n)


def test_self_collision_refuses_what_it_cannot_watch(held_box: ClosedChain) -> None:
    with pytest.raises(UnknownNameError, match="did you mean 'torso'"):
        SelfCollision(pairs=(("RHand", "torsoo"),)).rows(held_box)
    for pairs in ((("RHand", "RHand"),), (("RHand", "torso"), ("torso", "RHand"))):
        with pytest.raises(ValueError, match="given before"):
            SelfCollision(pairs=pairs)
    with pytest.raises(InvalidValueError, match="overshoot"):
        SelfCollision(gain=101.0).bind(held_box, DT)
    pair = PlanarPair().build()
    q = pair.configuration({"right": [0.5, -1.0, 0.5], "left": [-0.5, 1.0, -0.5]})
    bare = ClosedChain.take_hold(pair, q, Rigid(), HeldObject())
    with pytest.raises(InvalidValueError, match="has no capsules"):
        SelfCollision().rows(bare)


def test_a_capsule_on_an_unknown_joint_is_refused(nao: RobotModel) -> None:
    lost = Capsule(name="x", joint="Elbow", start=(0, 0, 0), end=(0, 0, 0), radius=0.1)
    with pytest.raises(UnknownNameError, match="capsule x"):
        RobotModel(name="nao", model=nao.model, arms=nao.arms, capsules=(lost,))
