"""A primal-dual active set in numpy (Hintermueller, Ito and Kunisch 2002).

All constraints are rows of lower <= M v <= upper with M = [I; G; A]. Those taken for active turn
the QP into a linear system in v and the multipliers m, positive at upper bounds:

    [P  M_a'] [v]   [-q ]
    [M_a  0 ] [m] = [b_a]

solved by least squares, since active rows may depend on each other. A row is active next where
m + c (M v - bound) has the bound's sign. When nothing changes, the answer is the optimum. That is
not proven to happen for every QP, so the number of rounds is limited.
"""

from __future__ import annotations

import numpy as np

from coopqp import QP, Solution, Solve, Solver, Status, spec


@spec
class ActiveSet(Solver):
    """Primal-dual active set in numpy: for reading, not for speed."""

    rounds: int = 50
    """Most linear systems in a tick."""
    c: float = 1.0
    """How much a bound's violation counts against its multiplier."""

    def open(self, qp: QP, solution: Solution) -> Solve:
        """Nothing is kept between ticks."""
        equal = np.arange(len(qp.lower)) >= qp.n + qp.p

        def solve() -> None:
            M = np.vstack([np.eye(qp.n), qp.C])
            high, low = equal.copy(), np.zeros(len(M), bool)
            solution.status = Status.ITERATION_LIMIT
            for _ in range(self.rounds):
                active = high | low
                bound = np.where(high, qp.upper, qp.lower)[active]
                k = len(bound)
                system = np.block([[qp.P, M[active].T], [M[active], np.zeros((k, k))]])
                try:
                    answer = np.linalg.lstsq(system, np.concatenate([-qp.q, bound]))[0]
                except np.linalg.LinAlgError:
                    solution.status = Status.SOLVER_ERROR
                    return
                v, m = answer[: qp.n], np.zeros(len(M))
                m[active] = answer[qp.n :]
                above = equal | (m + self.c * (M @ v - qp.upper) > 0.0)
                below = ~equal & (m + self.c * (M @ v - qp.lower) < 0.0)
                if (above == high).all() and (below == low).all():
                    solution.v[:], solution.multipliers[:] = v, m
                    solution.status = Status.OPTIMAL
                    return
                high, low = above, below

        return solve
