"""Tasks that cannot hold together: a smallest set of them, by leaving out one after the other.

On an object that nothing holds the verdict is about any robot; else about this one, without limits.
A free object has six coordinates, x = (translation, rotation vector) from where it is now, and the
tasks see it with J_task = [1 0] in a state whose pose is overwritten.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
import pinocchio as pin

from coopqp.base.spec import Array
from coopqp.scenario.bounded_steps import BoundedSteps, Stop
from coopqp.study.explanation.goal import Goal
from coopqp.study.explanation.search import Search
from coopqp.task import Task

T = TypeVar("T")

#: Random beginnings of a free object, and how far they lie off [rad; m times the reach].
FREE_STARTS, FREE_STEPS, FREE_STEP = 6, 80, 0.5
#: Rows belong to the object where J is a combination of the rows of J_task to this share.
OF_OBJECT = 1e-6


@dataclass(frozen=True)
class Contradiction:
    """Two tasks or more that cannot hold together, on any robot if a free object cannot either."""

    tasks: tuple[Task, ...]
    any_robot: bool


def irreducible(tasks: Sequence[T], fails: Callable[[tuple[T, ...]], bool]) -> tuple[T, ...]:
    """A subset that fails, and of which every smaller one holds (deletion filter).

    All of these tasks, or names of tasks, fail together.
    """
    kept = tuple(tasks)
    for task in tasks:
        rest = tuple(other for other in kept if other is not task)
        if rest and fails(rest):
            kept = rest
    return kept


def contradicting(tasks: Sequence[T], fails: Callable[[tuple[T, ...]], bool]) -> tuple[T, ...]:
    """Such a subset of two or more; none where all hold, or one alone fails."""
    found = irreducible(tasks, fails) if len(tasks) > 1 and fails(tuple(tasks)) else ()
    return found if len(found) > 1 else ()


def on_a_free_object(goal: Goal) -> tuple[Task, ...]:
    """Tasks of the object that contradict each other on any robot; empty where none do."""
    if goal.chain.n < 6:
        return ()
    own = tuple(task for task in goal.tasks if _of_object(goal.only([task])))
    return contradicting(own, lambda some: _free_fails(goal.only(some)))


def on_this_robot(goal: Goal, q: Array) -> tuple[Task, ...]:
    """A smallest set of tasks that cannot hold on the robot without limits, maybe one alone."""
    return irreducible(goal.tasks, lambda some: not Search(goal.only(some)).best(q).reached)


def _of_object(goal: Goal) -> bool:
    """Whether a task sees the object alone."""
    chain = goal.chain
    goal.look(chain.q_start + 0.1 * np.sin(1.0 + np.arange(chain.n)))
    J, J_task = goal.stack.J, goal.state.J_task
    left = J.T - J_task.T @ np.linalg.lstsq(J_task.T, J.T, rcond=None)[0]
    return bool(np.linalg.norm(left) <= OF_OBJECT * np.linalg.norm(J))


def _free_fails(goal: Goal) -> bool:
    """Whether no pose of a free object that was found fulfils the tasks."""
    state, root, rng = goal.state, np.sqrt(goal.weights), np.random.default_rng(0)
    goal.look(goal.chain.q_start)
    p, R = state.p_WO.copy(), state.R_WO.copy()

    def residual(x: Array) -> tuple[Array, Array]:
        state.p_WO[:] = p + x[:3]
        state.R_WO[:] = pin.exp3(x[3:]) @ R
        state.J_task[:] = 0.0
        state.J_task[:3, :3] = np.eye(3)
        state.J_task[3:, 3:6] = pin.Jexp3(-x[3:])  # the left Jacobian
        goal.stack.update(state)
        return root * goal.stack.e, root[:, None] * goal.stack.J[:, :6]

    small = 0.05 * min(part.part.tolerance for part in goal.parts) * float(root.min())
    stop = Stop(FREE_STEPS, FREE_STEP, lambda r: bool(np.abs(r).max() < small))
    steps, far = BoundedSteps(6), np.full(6, np.inf)
    for i in range(FREE_STARTS):
        x = rng.normal(size=6) * np.repeat([0.3 * goal.chain.reach, 1.0], 3) * min(i, 1)
        steps.descend(x, residual, (-far, far), stop)
        residual(x)
        if goal.miss <= 1.0:
            return False
    return True
