"""Any backend of qpsolvers by its name, one cold call a tick: for breadth and cross-checks."""

import warnings
from typing import Any

import numpy as np
import qpsolvers

from coopqp.base.errors import UnknownNameError
from coopqp.base.qp import QP
from coopqp.base.spec import spec
from coopqp.solver import Solution, Solve, Solver, Status

#: Backends stop at loose tolerances by default, which the verification would refuse.
TIGHT: dict[str, dict[str, float]] = {
    "osqp": {"eps_abs": 1e-9, "eps_rel": 0.0, "max_iter": 20_000},
    "proxqp": {"eps_abs": 1e-9, "eps_rel": 0.0, "max_iter": 100},
}


def installed() -> tuple[str, ...]:
    """Backends of qpsolvers that can be used here."""
    return tuple(sorted(qpsolvers.available_solvers))


@spec
class Qpsolvers(Solver):
    """Any backend of qpsolvers: a one-shot call each tick."""

    backend: str
    """Its name in qpsolvers, such as quadprog."""

    def open(self, qp: QP, solution: Solution) -> Solve:
        if self.backend not in installed():
            raise UnknownNameError("qpsolvers backend", self.backend, installed())
        problem = qpsolvers.Problem(
            qp.P, qp.q, qp.G if qp.p else None, qp.h if qp.p else None, qp.A, qp.b, qp.lb, qp.ub
        )

        def solve() -> None:
            solution.v[:], solution.multipliers[:] = 0.0, 0.0
            if (qp.lb > qp.ub).any():  # some backends print when asked that
                solution.status = Status.INFEASIBLE
                return
            answer = _ask(problem, self.backend)
            if answer is None:
                solution.status = Status.SOLVER_ERROR
                return
            solution.status = Status.OPTIMAL if answer.found else Status.INFEASIBLE
            if answer.x is not None:
                solution.v[:] = answer.x
            for mine, theirs in (
                (solution.y, answer.y), (solution.z, answer.z), (solution.z_box, answer.z_box)
            ):  # fmt: skip
                if theirs is not None and np.shape(theirs) == mine.shape:
                    mine[:] = theirs

        return solve


def _ask(problem: qpsolvers.Problem, backend: str) -> Any:
    """The backend's answer; None when it threw, which a tick must never do."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # some backends warn that they convert to sparse
        try:
            return qpsolvers.solve_problem(problem, solver=backend, **TIGHT.get(backend, {}))
        except Exception:  # noqa: BLE001 - each backend has errors of its own
            return None
