"""The loop does not begin where joints cannot be, and says what a driver may have wrong."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from online_loops import follows

import coopqp
from coopqp.base.errors import CoopqpError, GraspError, InvalidValueError
from coopqp.base.spec import Array, Pose
from coopqp.online.beginning import likely_mistake
from coopqp.online.loop import OnlineLoop
from coopqp.scenario.scenario import Scenario
from coopqp.solver import Status


@pytest.fixture(scope="module")
def nao() -> Scenario:
    return coopqp.load("point_on_point")


def _said(scenario: Scenario, q: Array, **settings: str) -> str:
    loop = OnlineLoop(scenario, clock=None, **settings)  # type: ignore[arg-type]
    with pytest.raises(CoopqpError) as raised:
        loop.begin(q)
    command = loop.tick(q)
    assert command.causes == (Status.NOT_BEGUN,)
    assert not command.v.any()
    assert loop.note == str(raised.value)
    return loop.note


def test_joints_in_degrees_are_named_with_reading_and_range(nao: Scenario) -> None:
    said = _said(nao, np.degrees(nao.chain.q_start))
    assert said.startswith("RElbowYaw reads 68.8 rad, 67 rad above its range: degrees? ")
    assert "Its range is -2.09 to 2.09 rad, and 9 other joints outside theirs" in said
    assert said.endswith("theirs")  # the mistake is known: it is not to be let pass


def test_a_joint_may_be_off_by_what_servos_are_and_anywhere_if_one_says_so(nao: Scenario) -> None:
    chain, q = nao.chain, nao.chain.q_start.copy()
    i = chain.joint_names.index("RElbowRoll")
    q[i] = chain.upper[i] + 0.049
    OnlineLoop(nao, clock=None).begin(q)
    q[i] = chain.upper[i] + 0.3
    assert _said(nao, q).startswith("RElbowRoll reads 1.84 rad, 0.3 rad above its range. Its range")
    OnlineLoop(replace(nao, start_outside=True), clock=None).begin(q)


def _swap(a: slice | int, b: slice | int) -> Callable[[Array], Array]:
    def swapped(q: Array) -> Array:
        other = q.copy()
        other[a], other[b] = q[b], q[a]
        return other

    return swapped


def _joint(i: int, change: Callable[[float], float]) -> Callable[[Array], Array]:
    def changed(q: Array) -> Array:
        other = q.copy()
        other[i] = change(q[i])
        return other

    return changed


MISTAKES = {
    "degrees": np.degrees,
    "arms swapped": _swap(slice(0, 5), slice(5, 10)),
    "RElbowYaw and RElbowRoll swapped": _swap(2, 3),
    "sign of RShoulderRoll": _joint(1, lambda x: -x),
    "sign of LElbowRoll": _joint(8, lambda x: -x),
    "LShoulderPitch off by 90 degrees": _joint(5, lambda x: x - np.pi / 2.0),
    "RWristYaw off by a turn": _joint(4, lambda x: x + 2.0 * np.pi),
}


@pytest.mark.parametrize("grasp", ["as_held", "as_written"])
@pytest.mark.parametrize("name", MISTAKES)
def test_the_one_mistake_is_named_that_puts_the_hands_where_they_belong(
    nao: Scenario, name: str, grasp: str
) -> None:
    said = _said(nao, MISTAKES[name](nao.chain.q_start), grasp=grasp)
    # Both shoulders turn about one line, so that either of them may be off.
    assert f": {name}?" in said or f"RShoulderPitch off by 90 degrees or {name}?" in said


def test_where_the_object_has_a_place_hands_far_off_are_refused_with_the_mistake_or_without() -> (
    None
):
    given = follows()
    here = given.chain.object_pose(given.chain.q_start).translation
    placed = replace(given, held=replace(given.held, pose=Pose(position=tuple(here.tolist()))))
    q = given.chain.q_start
    with pytest.raises(GraspError, match=r"more than a model's error: sign of RElbowYaw\? Else"):
        OnlineLoop(placed, clock=None).begin(_joint(2, lambda x: -x)(q))
    with pytest.raises(GraspError, match=r"more than a model's error; bring the robot near"):
        OnlineLoop(placed, clock=None).begin(_joint(2, lambda x: x - 0.7)(q))
    OnlineLoop(given, clock=None).begin(_joint(2, lambda x: x - 0.7)(q))  # may be held otherwise


def test_a_robot_that_it_cannot_begin_with_is_sent_to_where_it_is(nao: Scenario) -> None:
    loop, q = OnlineLoop(nao, clock=None), MISTAKES["arms swapped"](nao.chain.q_start)
    for off in (0.0, 0.01):
        assert loop.tick(q + off).status is Status.NOT_BEGUN
        np.testing.assert_array_equal(loop.setpoint, q + off)
    assert loop.tick(np.full_like(q, np.nan)).status is not Status.OPTIMAL
    np.testing.assert_array_equal(loop.setpoint, q + 0.01)


def test_it_begins_with_the_object_where_it_was_measured(nao: Scenario) -> None:
    q, middle = nao.chain.q_start, nao.chain.object_pose(nao.chain.q_start)
    loop = OnlineLoop(nao, clock=None)
    turned, by = pin.rpy.rpyToMatrix(0.0, 0.0, 0.1), np.array([0.0, 0.01, 0.02])
    here = pin.SE3ToXYZQUAT(pin.SE3(turned, middle.translation + by))
    loop.begin(q, object_pose=here)
    assert loop.state.p_WO == pytest.approx(here[:3])
    assert pin.log3(loop.state.R_WO) == pytest.approx([0.0, 0.0, 0.1])
    assert np.abs(loop.state.closed_error).max() < 1e-12
    placed = replace(nao, held=replace(nao.held, pose=Pose(position=tuple(middle.translation))))
    with pytest.raises(GraspError, match=r"object_pose: 153 mm and 0 mrad from where the hands"):
        OnlineLoop(placed, clock=None).begin(q, [*middle.translation[:2], 0.2, 0, 0, 0, 1])


@pytest.mark.parametrize("name", ["point_on_point", "two_pandas", "three_ur", "two_so101"])
def test_every_sign_is_named_and_sound_joints_never(name: str, rng: np.random.Generator) -> None:
    chain = coopqp.load(name).chain
    q = chain.q_start
    own = np.setdiff1d(np.arange(chain.n), chain.passive)
    for i in own[np.abs(q[own]) > 0.2]:
        assert f"sign of {chain.joint_names[i]}" in likely_mistake(
            chain, _joint(i, lambda x: -x)(q)
        )
    for scale in (0.01, 0.1, 0.3):
        for _ in range(20):
            near = np.clip(q + scale * rng.normal(size=chain.n), chain.lower, chain.upper)
            if chain.loop_error(near)[:3].dot(chain.loop_error(near)[:3]) > 0.03**2:
                assert not likely_mistake(chain, near)


def test_what_is_no_joint_is_refused_as_before(nao: Scenario) -> None:
    with pytest.raises(InvalidValueError, match="q: found shape"):
        OnlineLoop(nao, clock=None).begin([0.0])
