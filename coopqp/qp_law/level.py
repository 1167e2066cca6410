"""One QP of a tick: soft tasks as the objective, limits, and equality rows that others fill."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from coopqp.controller import ControlProblem
from coopqp.qp import QP, Rows
from coopqp.qp_law.bounds import Bounds
from coopqp.qp_law.equations import SCALE_WEIGHT, normal_equations
from coopqp.row import Row, joint_rows
from coopqp.solver import Solution, Status, Verifier
from coopqp.task import TaskStack


class Level:
    """A QP with its arrays, its solver and its verification.

    Args:
        problem: budget, solver and sizes.
        tasks: the soft tasks of this level; whoever owns the stack updates it.
        equalities: the equality rows.
        bounds: the limits.
        damping: cost of |v|^2.
        shares: names of what may be done in part only, each with a share s in [0, 1], the largest
            that is possible.

    Attributes:
        qp, solution: of the last tick. qp's variables are v, then s.
        tasks: as given.
        P, q, A: the parts of the QP that belong to v, shapes (n, n), (n,) and (m, n).
        b: right side of the equality rows, shape (m,).
        v: the velocities of the answer, shape (n,).
        curvature: smallest eigenvalue that P has at least, its damping in the last tick.
    """

    def __init__(
        self,
        problem: ControlProblem,
        tasks: TaskStack,
        equalities: tuple[Row, ...],
        bounds: Bounds,
        damping: float,
        shares: Sequence[str] = (),
    ) -> None:
        chain, n = problem.chain, problem.chain.n
        scales = (Row(name=f"scale[{name}]", kind="share", owner=name, unit="1") for name in shares)
        variables = (*joint_rows(chain.joint_names, chain.joint_units), *scales)
        self.tasks, self._damping, self._n = tasks, damping, n
        self.qp = qp = QP(Rows(variables, bounds.rows, equalities))
        self.solution = Solution(qp)
        self.P, self.q, self.A, self.b = qp.P[:n, :n], qp.q[:n], qp.A[:, :n], qp.b
        self.v = self.solution.v[:n]
        if shares:
            qp.lb[n:], qp.ub[n:] = 0.0, 1.0
            np.fill_diagonal(qp.P[n:, n:], SCALE_WEIGHT)
            qp.q[n:] = -SCALE_WEIGHT
        self.curvature = damping
        self._verifier = Verifier(qp, self.solution, problem.budget, damping)
        self._solve = problem.solver.open(qp, self.solution)

    def assemble(self, bounds: Bounds, extra_damping: float = 0.0) -> None:
        """Objective and limits; the caller fills the equality rows.

        Args:
            bounds: the limits at the state.
            extra_damping: beside that of every tick, as the state needs it.
        """
        qp, tasks, n = self.qp, self.tasks, self._n
        self.curvature = self._damping + extra_damping
        normal_equations(tasks.J, tasks.weights, tasks.wanted, self.curvature, self.P, self.q)
        qp.lb[:n], qp.ub[:n] = bounds.lb, bounds.ub
        if qp.p:
            qp.G[:, :n], qp.h[:] = bounds.G, bounds.h

    def solve(self) -> Status:
        """Solve and verify."""
        self.qp.seal()
        self._solve()
        self._verifier.curvature = min(self.curvature, SCALE_WEIGHT)
        self.solution.status = status = self._verifier.check()
        return status

    @property
    def scale(self) -> float:
        """Least share of the answer; 1 without shares."""
        return float(self.solution.v[self._n :].min(initial=1.0))
