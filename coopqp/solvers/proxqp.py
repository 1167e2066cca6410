"""ProxQP of proxsuite: proximal augmented Lagrangian, dense, through its own warm interface."""

import numpy as np
from proxsuite import proxqp

from coopqp.base.qp import QP
from coopqp.base.spec import Positive, spec
from coopqp.solver import Solution, Solve, Solver, Status

STATUS = {
    proxqp.PROXQP_SOLVED: Status.OPTIMAL,
    proxqp.PROXQP_MAX_ITER_REACHED: Status.ITERATION_LIMIT,
    proxqp.PROXQP_PRIMAL_INFEASIBLE: Status.INFEASIBLE,
    proxqp.PROXQP_DUAL_INFEASIBLE: Status.UNBOUNDED,
}


@spec
class Proxqp(Solver):
    """ProxQP: proximal augmented Lagrangian, dense, warm-started."""

    eps_abs: Positive = 1e-9
    """Absolute tolerance on the residuals."""
    eps_primal_inf: Positive = 1e-8
    """Below its default of 1e-4: with small numbers, feasible problems were called infeasible."""
    max_iter: int = 100
    """Most outer iterations."""
    max_iter_in: int = 20
    """Most inner iterations of each; its own 1,500 let one tick take half a minute."""

    def open(self, qp: QP, solution: Solution) -> Solve:
        """The warm start is the previous solution, which is all that is kept between ticks."""
        backend = proxqp.dense.QP(qp.n, qp.m, qp.p, True)
        backend.settings.eps_abs = self.eps_abs
        backend.settings.eps_rel = 0.0
        backend.settings.eps_primal_inf = self.eps_primal_inf
        backend.settings.max_iter = self.max_iter
        backend.settings.max_iter_in = self.max_iter_in
        backend.settings.initial_guess = proxqp.InitialGuess.WARM_START_WITH_PREVIOUS_RESULT
        unbounded = np.full(qp.p, -np.inf)
        problem = qp.P, qp.q, qp.A, qp.b, qp.G, unbounded, qp.h, qp.lb, qp.ub
        backend.init(*problem)

        def solve() -> None:
            backend.update(*problem)
            backend.solve()
            if backend.results.info.status != proxqp.PROXQP_SOLVED:
                # A far warm start makes it call feasible problems infeasible: ask again, cold.
                backend.cleanup()
                backend.update(*problem)
                backend.solve()
            results = backend.results
            solution.v[:] = results.x
            solution.y[:] = results.y
            solution.z[:] = results.z[: qp.p]
            solution.z_box[:] = results.z[qp.p :]
            solution.status = STATUS.get(results.info.status, Status.SOLVER_ERROR)

        return solve
