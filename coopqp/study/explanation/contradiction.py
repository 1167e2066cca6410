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

from coopqp.checked import Array
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
    """A subset that fails and of which every smaller one holds (deletion filter).

    Args:
        tasks: that fail together, or their names.
        fails: whether a set of them cannot hold.
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
    body, rng = _FreeObject(goal), np.random.default_rng(0)
    for i in range(FREE_STARTS):
        spread = np.repeat([0.3 * goal.chain.reach, 1.0], 3)
        if body.miss(rng.normal(size=6) * spread * min(i, 1)) <= 1.0:
            return False
    return True


class _FreeObject:
    """The tasks of an object that nothing holds."""

    def __init__(self, goal: Goal) -> None:
        self._goal = goal
        goal.look(goal.chain.q_start)
        self._p, self._R = goal.state.p_WO.copy(), goal.state.R_WO.copy()
        self._root = np.sqrt(goal.weights)
        self._steps = BoundedSteps(6)

    def miss(self, x: Array) -> float:
        """Largest error over its tolerance at the end of the way down from x."""
        tolerance = min(p.part.tolerance for p in self._goal.parts)
        small = 0.05 * tolerance * float(self._root.min())
        stop = Stop(FREE_STEPS, FREE_STEP, lambda r: bool(np.abs(r).max() < small))
        far = np.full(6, np.inf)
        self._steps.descend(x, self._residual, (-far, far), stop)
        self._residual(x)
        return self._goal.miss

    def _residual(self, x: Array) -> tuple[Array, Array]:
        goal, state = self._goal, self._goal.state
        state.p_WO[:] = self._p + x[:3]
        state.R_WO[:] = pin.exp3(x[3:]) @ self._R
        state.J_task[:] = 0.0
        state.J_task[:3, :3] = np.eye(3)
        state.J_task[3:, 3:6] = pin.Jexp3(-x[3:])  # the left Jacobian
        goal.stack.update(state)
        return self._root * goal.stack.e, self._root[:, None] * goal.stack.J[:, :6]
