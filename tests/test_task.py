"""Tasks stacked: order, gains, weights."""

from __future__ import annotations

import numpy as np
from example_tasks import SMOOTH, THROUGH, at

from coopqp.base.qp import names_of
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.state import State
from coopqp.task import TaskStack
from coopqp.tasks import PointOnPlane, PointOnPoint


def test_stack_keeps_tasks_in_order_with_their_gains_and_weights(chain: ClosedChain) -> None:
    tasks = [
        PointOnPoint(goal=(0.2, 0, 0.1), name="reach", gain=4.0, weight=2.0, profile=SMOOTH),
        PointOnPlane(normal=(0, 0, 1), through=THROUGH, name="lay", gain=3.0, weight=0.5),
    ]
    stack = TaskStack(tasks, State(chain))
    stack.update(at(chain, chain.q_start, 1.2))
    assert names_of(stack.rows) == (
        "task[reach].x",
        "task[reach].y",
        "task[reach].z",
        "task[lay].normal",
    )
    assert stack.slices == (slice(0, 3), slice(3, 4))
    np.testing.assert_array_equal(stack.weights, [2, 2, 2, 0.5])
    np.testing.assert_allclose(stack.wanted, stack.rate - np.array([4, 4, 4, 3]) * stack.e)
