"""Distances of bodies against closed forms, and that they stay."""

from __future__ import annotations

import itertools
from dataclasses import replace
from functools import partial

import laws
import numpy as np
import pinocchio as pin
import pytest
import qpsolvers
from chains import HANDS
from example_limits import by_name, empty_rows, least
from laws import DT, LIMITS, run

from coopqp.base.errors import InvalidValueError, UnknownNameError
from coopqp.base.qp import names_of
from coopqp.base.spec import Array
from coopqp.controllers import QPController
from coopqp.grasps import Rigid, Spherical
from coopqp.limits import JointPosition, SelfCollision
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.grasp_configuration import HeldObject
from coopqp.model.profile import Profile
from coopqp.model.state import State
from coopqp.robot import Capsule, RobotModel
from coopqp.robots import NaoT14, PlanarPair
from coopqp.tasks import JointCentering, PointOnPoint

problem = partial(laws.problem, secondary=(JointCentering(gain=0.5),))


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
        """Of the pair in "limit.self_collision[A|B]", less the radii; not below what touches."""
        pin.framesForwardKinematics(self.chain.model, self.data, q)
        one, other = pair.split("[")[1].rstrip("]").split("|")
        if "object" in (one, other):
            capsule = self.capsules[other if one == "object" else one]
            X_WO = self.data.oMf[self.chain.frames[0]]
            size = np.array(self.chain.held.size)
            return to_box(*self.segment(capsule), X_WO, size) - capsule.radius
        a, b = self.capsules[one], self.capsules[other]
        return between_segments(*self.segment(a), *self.segment(b)) - a.radius - b.radius


def _of_pairs(limit: SelfCollision, chain: ClosedChain) -> list[str]:
    """Rows without those of corners, which belong to whichever pairs are closest."""
    return [name for name in names_of(limit.rows(chain)) if ".corner[" not in name]


def test_distances_are_those_of_closed_forms(held_box: ClosedChain) -> None:
    rng, oracle, limit = np.random.default_rng(3), Oracle(held_box), SelfCollision(distance=0.0)
    q = held_box.sample(rng, 120)
    margins = by_name(limit.margins(held_box, q, np.zeros((119, held_box.n)), DT))
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
    limit = SelfCollision(distance=0.0, within=10.0)  # pairs that are far have no rate
    rng, step = np.random.default_rng(4), 1e-5
    state, rows = State(held_box), empty_rows(held_box, limit)
    tighten = limit.bind(held_box, DT)
    capsules = [i for i, name in enumerate(_of_pairs(limit, held_box)) if "object" not in name]
    off = []
    for q in held_box.sample(rng, 60):
        state.q[:] = q
        state.update()
        tighten(state, rows)
        v = rng.normal(size=held_box.n)
        path = np.vstack([q, q + step * v, q - step * v])
        margins = by_name(limit.margins(held_box, path, np.zeros((2, held_box.n)), DT))
        slope = np.array([(m[0] - m[1]) / (2 * step) for m in margins.values()])
        off.append(np.abs(slope + rows.G[: len(slope)] @ v))
    # Closed form between capsules; to the box, coal iterates to 1e-6 m.
    assert np.max(np.array(off)[:, capsules]) < 1e-4
    assert np.median(off) < 1e-6
    assert np.mean(np.array(off) < 1e-3) > 0.99


def test_no_pair_is_too_close_where_robots_start(held_box: ClosedChain) -> None:
    limit = SelfCollision()
    middle = 0.5 * (held_box.lower + held_box.upper)
    q = np.vstack([held_box.q_start, held_box.q_start, middle, 0.0 * middle])
    assert all(
        m.min() > 0.0
        for m in by_name(limit.margins(held_box, q, np.zeros((3, held_box.n)), DT)).values()
    )


@pytest.mark.few(2)
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
    done = run(QPController(), problem(held_box, pull, limits=[*LIMITS, limit]), 250)
    distances = {
        name: [oracle.distance(name, q) for q in done.q[::5]] for name in _of_pairs(limit, held_box)
    }
    assert min(map(min, distances.values())) >= limit.distance - 1e-4
    assert least(limit, held_box, done) >= -1e-4
    if gain == 10.0:
        assert min(distances[f"limit.self_collision[{blocked}]"]) < limit.distance + 1e-3


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
        nearest.append(min(oracle.distance(name, state.q) for name in _of_pairs(limit, held_box)))
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
        chain = ClosedChain.attach(model, held_box.q_start, Rigid(), HeldObject())
        limit = SelfCollision(pairs=(("b", "a"), ("object", "a")))
        rows = empty_rows(chain, limit)
        limit.bind(chain, DT)(State(chain), rows)
        assert np.isfinite(rows.G).all()
        assert (rows.h[:1] == 0.0).all()


def test_bodies_that_the_grasps_fix_to_each_other_are_no_pair(
    nao: RobotModel, held_box: ClosedChain
) -> None:
    hands = "limit.self_collision[RHand|LHand]"
    assert hands not in names_of(SelfCollision().rows(held_box))
    loose = ClosedChain.attach(nao, held_box.q_start, Spherical(), HeldObject())
    assert hands in names_of(SelfCollision().rows(loose))
    assert not any("Hand" in n for n in names_of(SelfCollision().rows(loose)) if "object" in n)


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
    bare = ClosedChain.attach(pair, q, Rigid(), HeldObject())
    with pytest.raises(InvalidValueError, match="has no collision geometry"):
        SelfCollision().rows(bare)


def test_a_capsule_on_an_unknown_joint_is_refused(nao: RobotModel) -> None:
    lost = Capsule(name="x", joint="Elbow", start=(0, 0, 0), end=(0, 0, 0), radius=0.1)
    with pytest.raises(UnknownNameError, match="capsule x"):
        RobotModel(name="nao", model=nao.model, arms=nao.arms, capsules=(lost,))


def test_a_released_hand_is_watched_against_the_one_that_holds(chain: ClosedChain) -> None:
    alone = chain.handed_over(chain.q_start, ["left"])
    assert "limit.self_collision[RHand|LHand]" in names_of(SelfCollision().rows(alone))


def test_a_waist_that_arms_share_is_watched_against_both() -> None:
    """A lift carries both arms: its capsule is base, not a part of the last arm."""
    robot = NaoT14().build()
    model = pin.Model()
    one_of = np.ones(1)
    lift = model.addJoint(
        0, pin.JointModelPZ(), pin.SE3.Identity(), "lift", one_of, one_of, -one_of, one_of
    )
    model.addFrame(pin.Frame("waist", lift, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
    whole = pin.appendModel(model, robot.model, model.getFrameId("waist"), pin.SE3.Identity())
    one, other = robot.arms
    waist = replace(robot.capsules[0], name="waist", joint="lift")
    lifted = RobotModel(
        name="lifted", model=whole, arms=(one, other), capsules=(waist, *robot.capsules[1:])
    )
    q = lifted.configuration({"right": [0, *HANDS["right"]], "left": [0, *HANDS["left"]]})
    chain = ClosedChain.attach(lifted, q, Rigid(), HeldObject())
    names = _of_pairs(SelfCollision(), chain)
    for arm in "RL":
        assert any(f"{arm}Hand" in name and "waist" in name for name in names)
        assert not any(f"{arm}UpperArm" in name and "waist" in name for name in names)
