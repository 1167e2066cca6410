"""DAQP: dual active set, exact; the default.

An active-set method lands on the optimum itself, not near it. That matters here: the damping that
keeps self-motion quiet is so small that the cost is nearly flat along it, and first-order methods
stop anywhere on the flat.
"""

from typing import ClassVar

import daqp
import numpy as np

from coopqp.base.qp import QP
from coopqp.base.spec import Positive, spec
from coopqp.solver import Solution, Solve, Solver, Status

EQUALITY = 5  # daqp's sense of a row that must hold with equality

STATUS = {
    1: Status.OPTIMAL,
    2: Status.OPTIMAL,
    -1: Status.INFEASIBLE,
    -3: Status.UNBOUNDED,
    -4: Status.ITERATION_LIMIT,
    -6: Status.INFEASIBLE,  # equality rows contradict each other
}

INFEASIBLE, CYCLING = -1, -2
WORTH_ANOTHER_TRY = (INFEASIBLE, CYCLING)


@spec
class Daqp(Solver):
    """DAQP: dual active set, exact and the fastest here; the default."""

    kernel_instead: ClassVar[bool] = True

    primal_tol: Positive = 1e-9
    """Largest violation of a constraint [rad/s, m/s]; daqp's own 1e-6 would show in the limits."""
    sing_tol: Positive = 1e-15
    """Square of what is left of a row that depends on others, in the first try; daqp's own 1e-13
    finds no motion where limits and rows leave one, decided by 3e-7 of what they see of it."""
    second_tol: Positive = 1e-7
    """The same for a second try, when the first found no feasible point."""
    last_tol: Positive = 3e-7
    """The same for a last try, with proximal steps."""
    prox: Positive = 1e-3
    """Curvature that a proximal step adds about the last iterate [s2/rad2]."""
    dual_tol: Positive = 1e-12
    """Smallest multiplier that counts as negative."""
    iter_limit: int = 1000
    """Most changes of the active set."""

    def open(self, qp: QP, solution: Solution) -> Solve:
        """Nothing is kept between ticks: starting cold is as fast at this size.

        daqp fails on some feasible programs: where bounds and rows touch in one point, by the tight
        tolerance, and where the cost is ill-conditioned (recovering joints), by rounding. It gets
        up to three tries, the last with proximal steps, less accurate and prone to cycle: then the
        second answer stands. Violations are clipped and checked before use.
        """
        clean = np.zeros(qp.n + qp.p + qp.m, dtype=np.intc)
        clean[qp.n + qp.p :] = EQUALITY
        sense = clean.copy()
        common = {"dual_tol": self.dual_tol, "iter_limit": self.iter_limit}
        tries = (
            {**common, "primal_tol": self.primal_tol, "sing_tol": self.sing_tol},
            {**common, "primal_tol": self.second_tol},
            {**common, "primal_tol": self.last_tol, "eps_prox": self.prox},
        )

        def solve() -> None:
            flag = CYCLING
            for settings in tries:
                before = flag
                sense[:] = clean
                v, _, flag, info = daqp.solve(
                    qp.P, qp.q, qp.C, qp.upper, qp.lower, sense, **settings
                )
                if flag not in WORTH_ANOTHER_TRY:
                    break
            if flag == CYCLING and before == INFEASIBLE:
                flag = INFEASIBLE
            solution.v[:] = v
            solution.multipliers[:] = info["lam"]
            solution.status = STATUS.get(flag, Status.SOLVER_ERROR)

        return solve
