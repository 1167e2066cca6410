"""A task's primitives, evaluated by the kernel, are the rows that it fills in Python."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from chains import closed_states
from example_tasks import EXAMPLES, TIMES, over
from laws import problem
from side_by_side import laws, needs_kernel

from coopqp.model.closed_chain import ClosedChain
from coopqp.model.state import State
from coopqp.task import Task, TaskStack

pytestmark = needs_kernel

#: What is left to Python, because it is no geometry, or for laws that command torques.
PYTHONS = ("MinimumKineticEnergy", "Impedance")


@over(EXAMPLES)
def test_rows_are_those_of_python(task: Task, chain: ClosedChain) -> None:
    """Errors, Jacobians and rates at random states, before, during and after the motions."""
    start = State(chain)
    if task.program(start) is None:
        assert type(task).__name__ in PYTHONS
        return
    if task.joint_space and task.all_joints:
        pytest.skip("a wish for all joints has no rows; tests/kernel/test_agreement.py has it")
    given = problem(chain, replace(task, gain=0.5), kappa=0.0)
    _, law = laws(given)
    stack = TaskStack([task], start)
    for t, (q, _) in zip(TIMES, closed_states(chain, len(TIMES)), strict=True):
        state = State(chain, q, t)
        stack.update(state)
        law.tick(State(chain, q, t))
        found = np.reshape(law.whole.engine.rows(0), (-1, chain.n + 2))
        asked = np.flatnonzero(np.abs(stack.J).sum(axis=1) > 0.0)  # a posture leaves joints out
        np.testing.assert_allclose(found[:, 0], stack.e[asked], atol=1e-12)
        np.testing.assert_allclose(found[:, 1:-1], stack.J[asked], atol=1e-12)
        np.testing.assert_allclose(found[:, -1], stack.rate[asked], atol=1e-12)
