"""Hard and scaled tasks: equality rows of the first level.

J_j v = rate_j - gain_j e_j                                hard
J_k v - s_k (rate_k - gain_k e_k) = 0,  0 <= s_k <= 1      scaled
"""

from __future__ import annotations

from coopqp.checked import Array
from coopqp.controller import ControlProblem
from coopqp.state import State
from coopqp.task import TaskStack


class ExactTasks:
    """The tasks of a problem that are not soft.

    Args:
        problem: whose tasks.
        start: the state from which references set out.

    Attributes:
        hard, scaled: their stacks.
        rows: of both.
    """

    def __init__(self, problem: ControlProblem, start: State) -> None:
        self.hard = TaskStack([task for task in problem.tasks if task.mode == "hard"], start)
        self.scaled = TaskStack([task for task in problem.tasks if task.mode == "scaled"], start)
        self.rows = (*self.hard.rows, *self.scaled.rows)
        self._n = problem.chain.n

    @property
    def scaled_names(self) -> tuple[str, ...]:
        """Names of the scaled tasks."""
        return tuple(task.name for task in self.scaled.tasks)

    def update(self, state: State) -> None:
        """Evaluate the tasks."""
        self.hard.update(state)
        self.scaled.update(state)

    def fill(self, A: Array, b: Array) -> None:
        """Write the rows, shapes (k, n + shares) and (k,)."""
        n, k = self._n, len(self.hard.e)
        A[:k, :n], b[:k] = self.hard.J, self.hard.wanted
        A[k:, :n], b[k:] = self.scaled.J, 0.0
        for share, part in enumerate(self.scaled.slices):
            A[k + part.start : k + part.stop, n + share] = -self.scaled.wanted[part]
