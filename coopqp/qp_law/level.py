"""One QP of a tick: soft tasks as the objective, limits, and equality rows that others fill."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from coopqp.controller import ControlProblem
from coopqp.qp import QP, Rows
from coopqp.qp_law.bounds import Bounds
from coopqp.qp_law.equations import normal_equations
from coopqp.row import Row, joint_rows
from coopqp.solver import Solution, Status, Verifier
from coopqp.task import TaskStack

#: Cost of a scaled task's missing share, far above any soft task.
SCALE_WEIGHT = 1e3


class Level:
    """A QP with its arrays, its solver and its verification.

    Args:
        problem: budget, solver and sizes.
        tasks: the soft tasks of this level; whoever owns the stack updates it.
        equalities: the equality rows.
        bounds: the limits.
        damping: cost of |v|^2.
        scaled: names of the scaled tasks, each of which adds a share s in [0, 1].

    Attributes:
        qp, solution: of the last tick. qp's variables are v, then s.
        tasks: as given.
        P, q, A: the parts of the QP that belong to v, shapes (n, n), (n,) and (m, n).
        b: right side of the equality rows, shape (m,).
        v: the velocities of the answer, shape (n,).
    """

    def __init__(
        self,
        problem: ControlProblem,
        tasks: TaskStack,
        equalities: tuple[Row, ...],
        bounds: Bounds,
        damping: float,
        scaled: Sequence[str] = (),
    ) -> None:
        chain, n = problem.chain, problem.chain.n
        shares = (Row(name=f"scale[{name}]", kind="share", owner=name, unit="1") for name in scaled)
        variables = (*joint_rows(chain.joint_names, chain.joint_units), *shares)
        self.tasks, self._damping, self._n = tasks, damping, n
        self.qp = qp = QP(Rows(variables, bounds.rows, equalities))
        self.solution = Solution(qp)
        self.P, self.q, self.A, self.b = qp.P[:n, :n], qp.q[:n], qp.A[:, :n], qp.b
        self.v = self.solution.v[:n]
        if scaled:
            qp.lb[n:], qp.ub[n:] = 0.0, 1.0
            np.fill_diagonal(qp.P[n:, n:], SCALE_WEIGHT)
            qp.q[n:] = -SCALE_WEIGHT
        self._verifier = Verifier(qp, self.solution, problem.budget, damping)
        self._solve = problem.solver.open(qp, self.solution)

    def assemble(self, bounds: Bounds) -> None:
        """Objective and limits; the caller fills the equality rows."""
        qp, tasks, n = self.qp, self.tasks, self._n
        normal_equations(tasks.J, tasks.weights, tasks.wanted, self._damping, self.P, self.q)
        qp.lb[:n], qp.ub[:n] = bounds.lb, bounds.ub
        if qp.p:
            qp.G[:, :n], qp.h[:] = bounds.G, bounds.h

    def solve(self) -> Status:
        """Solve and verify."""
        self.qp.seal()
        self._solve()
        self.solution.status = status = self._verifier.check()
        return status

    @property
    def scale(self) -> float:
        """Least share of the answer; 1 without scaled tasks."""
        return float(self.solution.v[self._n :].min(initial=1.0))
