"""The rows of eq. (32), H J_ext and [h_dot; V_rel], which the classical laws invert."""

from __future__ import annotations

import numpy as np

from coopqp.base.spec import Array
from coopqp.controller import ControlProblem
from coopqp.model.state import State
from coopqp.task import TaskStack


class StackedRows:
    """Task rows above loop rows, V_rel = -kappa e (0 in the paper).

    Args:
        problem: tasks and closed chain.

    Attributes:
        tasks: the task rows alone.
        A: H J_ext, shape (k + m, n).
        b: [h_dot; V_rel], shape (k + m,).
        k: number of task rows.
    """

    def __init__(self, problem: ControlProblem) -> None:
        start = State(problem.chain)
        self.tasks = TaskStack(problem.tasks, start)
        self.k = len(self.tasks.e)
        rows = self.k + len(start.e_loop)
        self.A, self.b = np.zeros((rows, problem.chain.n)), np.zeros(rows)
        self._kappa = problem.kappa

    @property
    def loops(self) -> tuple[Array, Array]:
        """The loop rows alone: J_c, shape (m, n), and -kappa e, shape (m,)."""
        return self.A[self.k :], self.b[self.k :]

    def update(self, state: State) -> None:
        """Fill all rows for a state."""
        k, tasks = self.k, self.tasks
        tasks.update(state)
        self.A[:k], self.A[k:] = tasks.J, state.J_loop
        self.b[:k] = tasks.wanted
        np.multiply(state.e_loop, -self._kappa, out=self.b[k:])
