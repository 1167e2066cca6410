"""The chain when a hand lets go or takes hold."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from chains import three_arms

from coopqp.base.errors import UnknownNameError
from coopqp.base.spec import Array
from coopqp.grasps import Revolute, Rigid
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.grasp_configuration import HeldObject
from coopqp.model.state import State
from coopqp.robot import RobotModel


def poses(chain: ClosedChain, q: Array) -> dict[str, pin.SE3]:
    """Where each arm carries the object, by pinocchio alone."""
    data = chain.model.createData()
    pin.framesForwardKinematics(chain.model, data, q)
    return {a.name: data.oMf[f].copy() for a, f in zip(chain.arms, chain.frames, strict=True)}


def moved_left(chain: ClosedChain, rng: np.random.Generator) -> Array:
    """A configuration with the left arm somewhere else."""
    q = chain.q_start.copy()
    left = [i for i, name in enumerate(chain.joint_names) if name.startswith("L")]
    q[left] += rng.uniform(-0.2, 0.2, len(left))
    return q


def test_letting_go_leaves_the_other_hand_and_the_object_where_they_are(
    chain: ClosedChain, rng: np.random.Generator
) -> None:
    alone = chain.handed_over(chain.q_start, ["left"])
    assert [arm.name for arm in alone.arms] == ["right", "left"]
    assert alone.holding == 1
    q = moved_left(alone, rng)
    before, after = poses(chain, chain.q_start), poses(alone, q)
    assert after["right"].isApprox(before["right"], 1e-12)
    assert alone.object_pose(q).isApprox(before["right"], 1e-12)
    state = State(alone, q)
    assert state.loop_position_error == state.loop_orientation_error == 0.0
    assert state.J_loop.shape == (0, chain.n)
    assert np.linalg.norm(state.loop_error[:3]) > 0.01, "the left hand has moved away"
    left = [i for i, name in enumerate(chain.joint_names) if name.startswith("L")]
    assert not state.J_task[:, left].any(), "and no longer moves the object"


def test_the_first_arm_can_let_go_as_well(chain: ClosedChain) -> None:
    alone = chain.handed_over(chain.q_start, ["right"])
    assert [arm.name for arm in alone.arms] == ["left", "right"]
    assert alone.alpha.tolist() == [1.0, 0.0]
    assert all(name.startswith("loop[right]") for name in alone.loops.names)
    right = [i for i, name in enumerate(chain.joint_names) if name.startswith("R")]
    assert not State(alone).J_task[:, right].any()


def test_a_hand_takes_hold_where_it_is(chain: ClosedChain, rng: np.random.Generator) -> None:
    alone = chain.handed_over(chain.q_start, ["left"])
    q = moved_left(alone, rng)
    again = alone.handed_over(q)
    assert [arm.name for arm in again.arms] == ["right", "left"]
    object_pose = alone.object_pose(q)
    for pose in poses(again, q).values():
        assert pose.isApprox(object_pose, 1e-12)
    state = State(again)
    assert state.loop_position_error < 1e-15
    assert again.loops.rank == 6
    # Held otherwise, and so free to move otherwise.
    assert np.abs(state.J_loop - State(chain, q).J_loop).max() > 1e-3


def test_the_velocity_of_the_object_is_that_of_its_pose(
    chain: ClosedChain, rng: np.random.Generator
) -> None:
    for released in (["left"], ["right"]):
        alone, h = chain.handed_over(chain.q_start, released), 1e-6
        v = rng.normal(size=chain.n)
        before, after = State(alone, alone.q_start - h * v), State(alone, alone.q_start + h * v)
        twist = State(alone).J_task @ v
        np.testing.assert_allclose((after.p_WO - before.p_WO) / (2 * h), twist[:3], atol=1e-8)
        turn = pin.log3(after.R_WO @ before.R_WO.T) / (2 * h)
        np.testing.assert_allclose(turn, twist[3:], atol=1e-8)


@pytest.mark.parametrize(
    ("released", "rank", "closed"),
    [((), 12, 12), (("left",), 6, 6), (("right", "middle"), 0, 0)],
)
def test_three_arms_lose_a_loop_for_each_that_lets_go(
    released: tuple[str, ...], rank: int, closed: int
) -> None:
    chain = three_arms().handed_over(three_arms().q_start, released)
    assert (chain.loops.rank, chain.loops.closed) == (rank, closed)
    assert len(chain.loops.names) == 12
    assert State(chain).J_loop.shape == (rank, chain.n)
    assert {arm.name for arm in chain.arms[chain.holding :]} == set(released)


def test_when_the_leader_lets_go_the_others_share_the_object(nao: RobotModel) -> None:
    alpha = {"right": 1.0, "left": 0.0}
    q = nao.configuration({})
    led = ClosedChain.attach(nao, q, Rigid(), HeldObject(), alpha=alpha)
    assert led.handed_over(led.q_start, ["left"]).alpha.tolist() == [1.0, 0.0]
    other = led.handed_over(led.q_start, ["right"])
    assert (other.arms[0].name, other.alpha.tolist()) == ("left", [1.0, 0.0])


def test_a_released_hand_leaves_its_hinge_alone(nao: RobotModel, chain: ClosedChain) -> None:
    hinge = Revolute(axis=(1.0, 0.0, 0.0))
    held = ClosedChain.attach(nao, chain.q_start, hinge, HeldObject())
    turned = held.q_start.copy()
    turned[held.joint_names.index("left.hinge")] = 0.4
    alone = held.moved(turned).handed_over(turned, ["left"])
    state = State(alone)
    column = alone.joint_names.index("left.hinge")
    assert not state.J_ext[:, column].any()
    assert poses(alone, turned)["left"].isApprox(poses(held, turned)["left"], 1e-12)


def test_where_no_arm_holds_the_object_it_stands(
    chain: ClosedChain, rng: np.random.Generator
) -> None:
    there = chain.object_pose(chain.q_start)
    alone = chain.handed_over(chain.q_start, ["left", "right"])
    assert alone.standing
    assert alone.loops.closed == 0
    q = chain.q_start + rng.normal(0.0, 0.2, chain.n)
    state = State(alone, q)
    assert pin.SE3(state.R_WO, state.p_WO).isApprox(there, 1e-12)
    assert not state.J_task.any()
    # Each hand's object frame relative to the object, by pinocchio on the chain that held it.
    relative = [there.actInv(X) for X in poses(chain, q).values()]
    for X, error in zip(relative, state.loop_error.reshape(-1, 6), strict=True):
        assert error[:3] == pytest.approx(there.rotation @ X.translation, abs=1e-12)
        assert error[3:] == pytest.approx(there.rotation @ pin.log3(X.rotation), abs=1e-9)
    again = alone.handed_over(q)
    assert again.object_pose(q).isApprox(there, 1e-12)
    assert np.abs(again.loop_error(q)).max() < 1e-12
    seen = pin.SE3(there.rotation, there.translation + np.array([0.01, 0.0, 0.0]))
    assert alone.handed_over(q, [], seen).object_pose(q).isApprox(seen, 1e-12)
    held = chain.handed_over(chain.q_start, [], seen)  # who holds it knows better
    assert held.object_pose(chain.q_start).isApprox(there, 1e-12)
    with pytest.raises(UnknownNameError, match="unknown arm 'lefft'; did you mean 'left'"):
        chain.handed_over(chain.q_start, ["lefft"])
