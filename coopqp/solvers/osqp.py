"""OSQP: operator splitting (first order), warm-started through its own interface."""

from __future__ import annotations

import numpy as np
import osqp
import scipy.sparse

from coopqp.checked import Positive, spec
from coopqp.qp import QP
from coopqp.solver import Solution, Solve, Solver, Status

STATUS = {
    osqp.SolverStatus.OSQP_SOLVED: Status.OPTIMAL,
    osqp.SolverStatus.OSQP_PRIMAL_INFEASIBLE: Status.INFEASIBLE,
    osqp.SolverStatus.OSQP_DUAL_INFEASIBLE: Status.UNBOUNDED,
    osqp.SolverStatus.OSQP_MAX_ITER_REACHED: Status.ITERATION_LIMIT,
}


@spec
class Osqp(Solver):
    """OSQP: operator splitting, first order; slow to become accurate."""

    eps_abs: Positive = 1e-9
    """Absolute tolerance on the residuals; at 1e-6 v is off by up to 5e-3 rad."""
    eps_prim_inf: Positive = 1e-8
    """Tolerance of the test for infeasible constraints."""
    max_iter: int = 20_000
    """Most iterations."""

    def open(self, qp: QP, solution: Solution) -> Solve:
        """Matrices keep a full pattern, so that each tick only changes their values."""
        n, rows = qp.n, qp.p + qp.m
        upper = np.triu_indices(n)
        order = np.lexsort((upper[0], upper[1]))  # column by column, as CSC stores them
        row, column = upper[0][order], upper[1][order]
        ends = np.cumsum([0, *range(1, n + 1)])
        P = scipy.sparse.csc_matrix((qp.P[row, column], row, ends), shape=(n, n))
        # Column j of [I; C]: a one in row j, then the whole column of C.
        values = np.ones((n, 1 + rows))
        values[:, 1:] = qp.C.T
        index = np.hstack([np.arange(n)[:, None], np.tile(np.arange(n, n + rows), (n, 1))])
        A = scipy.sparse.csc_matrix(
            (values.ravel(), index.ravel(), np.arange(n + 1) * (1 + rows)), shape=(n + rows, n)
        )
        backend = osqp.OSQP()
        least, most = np.minimum(qp.lower, qp.upper), np.maximum(qp.lower, qp.upper)
        backend.setup(  # refuses bounds that cross, which a tick may have
            P, qp.q, A, least, most,
            eps_abs=self.eps_abs, eps_rel=0.0, eps_prim_inf=self.eps_prim_inf,
            max_iter=self.max_iter, verbose=False, polishing=True, warm_starting=True,
        )  # fmt: skip

        def solve() -> None:
            if (qp.lower > qp.upper).any():  # osqp would print, and solve the last problem again
                solution.status = Status.INFEASIBLE
                return
            values[:, 1:] = qp.C.T
            backend.update(q=qp.q, l=qp.lower, u=qp.upper, Px=qp.P[row, column], Ax=values.ravel())
            backend.warm_start(x=solution.v, y=solution.multipliers)
            results = backend.solve(raise_error=False)
            solution.status = STATUS.get(results.info.status_val, Status.SOLVER_ERROR)
            if results.x is not None and np.isfinite(results.x).all():
                solution.v[:] = results.x
                solution.multipliers[:] = results.y
            else:
                solution.v[:], solution.multipliers[:] = 0.0, 0.0

        return solve
