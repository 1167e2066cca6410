"""The classical resolved-rate law of the paper, eq. (32)-(34), shared by three controllers.

    v = (H J_ext)^+ [h_dot; V_rel] + P Z,   P = I_n - (H J_ext)^+ (H J_ext)

H J_ext is the stack of the task rows and the loop rows, V_rel = -kappa e (0 in the paper). The
identity is n x n, in joint space. It knows no limits.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coopqp.base.rank import least_squares
from coopqp.base.spec import Array
from coopqp.controller import Command, ControlProblem
from coopqp.kernel.formula import FormulaLaw
from coopqp.model.state import State
from coopqp.solver import Status
from coopqp.task import TaskStack

Invert = Callable[[Array], NDArray[np.floating[Any]]]


class StackedRows:
    """The k rows of ``tasks`` above m loop rows, eq. (32): A = H J_ext, b = [h_dot; V_rel]."""

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
        k, tasks = self.k, self.tasks
        tasks.update(state)
        self.A[:k], self.A[k:] = tasks.J, state.J_loop
        self.b[:k] = tasks.wanted
        np.multiply(state.e_loop, -self._kappa, out=self.b[k:])


class ResolvedRateLaw(FormulaLaw):
    """Eq. (33); ``invert`` maps H J_ext, shape (k + m, n), to its inverse; damping for the kernel.

    Secondary objectives enter as Z where ``null_space`` is true.
    """

    def __init__(
        self, problem: ControlProblem, invert: Invert, *, null_space: bool, damping: float = 0.0
    ) -> None:
        super().__init__(problem, damping=damping, null_space=null_space)
        self._invert, self._rows = invert, StackedRows(problem)
        own = problem.secondary if null_space else ()
        self._secondary = TaskStack(own, State(problem.chain))
        # Several objectives share Z by their weights, as they share the cost of the QP.
        weights = np.array([task.weight for task in self._secondary.tasks])
        self._shares = weights / max(float(weights.sum()), 1e-300)

    def decide(self, state: State) -> Command:
        rows, command = self._rows, self.command
        rows.update(state)
        try:
            inverse = self._invert(rows.A)
            np.dot(inverse, rows.b, out=command.v)
            if np.isfinite(command.v).all():
                self._add_null_space(state, inverse)
        except np.linalg.LinAlgError:  # the singular value decomposition did not converge
            return self.refuse(Status.SOLVER_ERROR)
        return self.settle()

    def _add_null_space(self, state: State, inverse: NDArray[np.floating[Any]]) -> None:
        if not self._secondary.tasks:
            return
        stack, Z = self._secondary, np.zeros(len(state.q))
        stack.update(state)
        for task, part, share in zip(stack.tasks, stack.slices, self._shares, strict=True):
            J, wanted = stack.J[part], stack.wanted[part]
            Z += share * (wanted if task.joint_space else least_squares(J, wanted))
        self.command.v += Z - inverse.dot(self._rows.A.dot(Z))  # dot, unlike @, warns of nothing
