"""One QP of a tick: soft tasks as the objective, limits, and equality rows."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from coopqp.controller import ControlProblem
from coopqp.qp import QP, Rows
from coopqp.qp_law.bounds import Bounds
from coopqp.qp_law.equations import SCALE_WEIGHT, Damping
from coopqp.row import Row, joint_rows
from coopqp.solver import Solution, Status, Verifier
from coopqp.state import State
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
        slows: whether the drift correction is that, and nothing else.

    Attributes:
        qp, solution: of the last tick. qp's variables are v, then s.
        tasks: as given.
        v: the velocities of the answer, shape (n,).
        curvature: smallest eigenvalue that P has at least, its damping in the last tick.
        certified: curvature by which the answer is judged at least.
    """

    def __init__(
        self,
        problem: ControlProblem,
        tasks: TaskStack,
        equalities: Sequence[Row],
        bounds: Bounds,
        damping: Damping,
        shares: Sequence[str] = (),
        *,
        slows: bool = False,
    ) -> None:
        chain, n = problem.chain, problem.chain.n
        shares = ["drift correction"] if slows else shares
        scales = (Row(name=f"scale[{name}]", kind="share", owner=name, unit="1") for name in shares)
        variables = (*joint_rows(chain.joint_names, chain.joint_units), *scales)
        self.tasks, self._least, self._slows = tasks, damping.least, slows
        self._n, self._eye = n, np.eye(n)
        self.qp = qp = QP(Rows(variables, bounds.rows, tuple(equalities)))
        self.solution = Solution(qp)
        self.v, self._shares = self.solution.v[:n], self.solution.v[n:]
        qp.lb[n:], qp.ub[n:] = 0.0, 1.0
        np.fill_diagonal(qp.P[n:, n:], SCALE_WEIGHT)
        qp.q[n:] = -SCALE_WEIGHT
        self.curvature = self.certified = damping.least
        self._verifier = Verifier(qp, self.solution, problem.budget, damping.least)
        self._solve = problem.solver.open(qp, self.solution)

    def assemble(self, bounds: Bounds, damping: float = 0.0) -> None:
        """Objective and limits, for which tasks and bounds are up to date.

        The caller fills the equality rows.

        Args:
            bounds: the limits.
            damping: cost of |v|^2 beside the least one.
        """
        qp, n, J, wanted = self.qp, self._n, self.tasks.J, self.tasks.wanted
        self.curvature = self._least + damping
        JW = J.T * self.tasks.weights
        qp.P[:n, :n] = JW.dot(J) + self.curvature * self._eye
        qp.q[:n] = -JW.dot(wanted)
        qp.lb[:n], qp.ub[:n] = bounds.lb, bounds.ub
        qp.G[:, :n], qp.h[:] = bounds.G, bounds.h

    def close_loops(self, state: State, kappa: float) -> None:
        """Write J_c v = -kappa e, eq. (14) with the drift correction, as the first equality rows.

        Or J_c v = -s kappa e where a share s of the correction is a variable, the first after v.
        """
        A, b, n, m = self.qp.A, self.qp.b, self._n, len(state.e_loop)
        A[:m, :n], b[:m] = state.J_loop, -kappa * state.e_loop
        if self._slows:
            A[:m, n], b[:m] = kappa * state.e_loop, 0.0

    def solve(self) -> Status:
        """Solve and verify."""
        self.qp.seal()
        self._solve()
        self._verifier.curvature = min(max(self.curvature, self.certified), SCALE_WEIGHT)
        self.solution.status = status = self._verifier.check()
        return status

    @property
    def scale(self) -> float:
        """Least share of the answer; 1 without shares."""
        return float(self._shares.min(initial=1.0))
