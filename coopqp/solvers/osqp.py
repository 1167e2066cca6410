"""OSQP: operator splitting (first order), warm-started through its own interface."""

import math

import numpy as np
import osqp
import scipy.sparse

from coopqp.base.qp import QP
from coopqp.base.spec import Positive, spec
from coopqp.solver import Solution, Solve, Solver, Status, norm

STATUS = {
    osqp.SolverStatus.OSQP_SOLVED: Status.OPTIMAL,
    osqp.SolverStatus.OSQP_PRIMAL_INFEASIBLE: Status.INFEASIBLE,
    osqp.SolverStatus.OSQP_DUAL_INFEASIBLE: Status.UNBOUNDED,
    osqp.SolverStatus.OSQP_MAX_ITER_REACHED: Status.ITERATION_LIMIT,
}

#: How hard the variable that leans on its bound does; as little as other costs.
LEAN = 1e-2


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
        """Matrices keep a full pattern, so that each tick only changes their values.

        One more variable leans on its bound, min LEAN (w^2/2 - w) with w <= 0. Without any active
        constraint osqp would print that there is nothing to polish, whatever its verbosity.
        """
        n, rows = qp.n, qp.p + qp.m
        half = np.triu_indices(n)
        order = np.lexsort((half[0], half[1]))  # column by column, as CSC stores them
        row, column = half[0][order], half[1][order]
        ends = np.cumsum([0, *range(1, n + 1), 1])
        cost = np.append(qp.P[row, column], LEAN)
        P = scipy.sparse.csc_matrix((cost, np.append(row, n), ends), shape=(n + 1, n + 1))
        # Column j of [I; C]: a one in row j, then the whole column of C.
        values = np.ones((n, 1 + rows))
        values[:, 1:] = qp.C.T
        index = np.hstack([np.arange(n)[:, None], np.tile(np.arange(n, n + rows), (n, 1))])
        starts = np.append(np.arange(n + 1) * (1 + rows), n * (1 + rows) + 1)
        A = scipy.sparse.csc_matrix(
            (np.append(values, 1.0), np.append(index, n + rows), starts),
            shape=(n + rows + 1, n + 1),
        )
        backend = osqp.OSQP()
        lower, upper = np.minimum(qp.lower, qp.upper), np.maximum(qp.lower, qp.upper)
        backend.setup(  # refuses bounds that cross, which a tick may have
            P, np.append(qp.q, -LEAN), A, np.append(lower, -np.inf), np.append(upper, 0.0),
            eps_abs=self.eps_abs, eps_rel=0.0, eps_prim_inf=self.eps_prim_inf,
            max_iter=self.max_iter, verbose=False, polishing=True, warm_starting=True,
        )  # fmt: skip

        def solve() -> None:
            if (qp.lower > qp.upper).any():  # osqp would print, and solve the last problem again
                solution.status = Status.INFEASIBLE
                return
            if not math.isfinite(norm(qp.P.ravel()) + norm(qp.q) + norm(qp.C.ravel())):
                solution.status = Status.SOLVER_ERROR  # likewise
                return
            values[:, 1:] = qp.C.T
            backend.update(
                q=np.append(qp.q, -LEAN),
                l=np.append(qp.lower, -np.inf),
                u=np.append(qp.upper, 0.0),
                Px=np.append(qp.P[row, column], LEAN),
                Ax=np.append(values, 1.0),
            )
            backend.warm_start(
                x=np.append(solution.v, 0.0), y=np.append(solution.multipliers, LEAN)
            )
            results = backend.solve(raise_error=False)
            solution.status = STATUS.get(results.info.status_val, Status.SOLVER_ERROR)
            if results.x is not None and np.isfinite(results.x).all():
                solution.v[:] = results.x[:n]
                solution.multipliers[:] = results.y[: n + rows]
            else:
                solution.v[:], solution.multipliers[:] = 0.0, 0.0

        return solve
