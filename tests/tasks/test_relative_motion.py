"""One arm's object against the other's."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from chains import three_arms
from example_tasks import EXAMPLES, H, at, error, rows

from coopqp.base.errors import CoopqpError
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.state import State
from coopqp.task import TaskStack
from coopqp.tasks import RelativeMotion


def test_relative_motion_holds_with_the_loop_open(
    chain: ClosedChain, rng: np.random.Generator
) -> None:
    """Its error is that of pinocchio's frames, and its rows are exact wherever the arms are."""
    task = EXAMPLES["relative motion"]
    model, data = chain.model, chain.model.createData()
    goal = pin.SE3(pin.rpy.rpyToMatrix(*np.radians([20, -10, 30])), np.array([0.02, -0.05, 0.01]))
    for q in chain.sample(rng, 5):
        stack = rows(task, at(chain, q, 9.0))
        pin.framesForwardKinematics(model, data, q)
        X = data.oMf[chain.frames[0]].actInv(data.oMf[chain.frames[1]])
        np.testing.assert_allclose(stack.e[:3], X.translation - goal.translation, atol=1e-13)
        np.testing.assert_allclose(stack.e[3:], pin.log3(X.rotation @ goal.rotation.T), atol=1e-12)
        v = rng.normal(size=chain.n)
        after, before = (error(task, at(chain, q + h * v, 9.0)) for h in (H, -H))
        np.testing.assert_allclose(stack.J @ v, (after - before) / (2 * H), atol=1e-6)


def test_relative_motion_knows_its_arms(chain: ClosedChain) -> None:
    left = RelativeMotion(arm=chain.arms[1].name)
    np.testing.assert_array_equal(
        rows(left, State(chain)).J, rows(RelativeMotion(), State(chain)).J
    )
    for wrong in (chain.arms[0].name, "lft"):
        with pytest.raises(CoopqpError, match=r"relative_motion\.arm"):
            rows(RelativeMotion(arm=wrong), State(chain))


@pytest.mark.xfail(
    strict=True, reason="with three arms the default is an arm that holds, not the one that let go"
)
def test_relative_motion_moves_the_arm_that_let_go_when_none_is_named() -> None:
    three = three_arms()
    chain = three.handed_over(three.q_start, ["right"])
    state = State(chain)
    stack = TaskStack([RelativeMotion(name="reach")], state)
    stack.update(state)
    J = State(chain).J_loop
    free = stack.J - stack.J @ np.linalg.pinv(J) @ J
    assert np.linalg.norm(free) > 1e-6, "the loops leave the motion free"
