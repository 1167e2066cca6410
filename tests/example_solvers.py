"""Every solver, quadratic programs for them, and what an optimum must fulfil."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.optimize
from example_settings import examples

from coopqp.base.qp import QP, Kind, Row, Rows
from coopqp.base.spec import Array
from coopqp.solver import Budget, Solution, Solver, Status, Verifier
from coopqp.solvers import Qpsolvers
from coopqp.solvers.qpsolvers import installed

N, M, P = 10, 6, 3  # variables, equalities, inequalities
PROBLEMS = 60
EXAMPLES: dict[str, Solver] = examples("solvers", qpsolvers={"backend": "quadprog"})
#: With every backend that qpsolvers finds here.
SOLVERS: dict[str, Solver] = {
    **{name: solver for name, solver in EXAMPLES.items() if name != "qpsolvers"},
    **{f"qpsolvers.{name}": Qpsolvers(backend=name) for name in installed()},
}
each_solver = pytest.mark.parametrize(
    "solver", [pytest.param(solver, id=name) for name, solver in SOLVERS.items()]
)


def empty_qp(n: int = N, p: int = P, m: int = M) -> QP:
    return QP(
        Rows(
            variables=rows("joint", n),
            inequalities=rows("limit", p),
            equalities=rows("loop", m),
        )
    )


def rows(kind: Kind, count: int) -> tuple[Row, ...]:
    """Rows of one kind, numbered."""
    return tuple(Row(name=f"{kind}{i}", kind=kind) for i in range(count))


def random_qp(rng: np.random.Generator, p: int = P) -> QP:
    """Strictly convex, feasible, with bounds and rows near enough to bind."""
    qp = empty_qp(p=p)
    root, inside = rng.normal(size=(N, N)), rng.uniform(-0.5, 0.5, N)
    qp.P[:], qp.q[:] = root.T @ root + 0.1 * np.eye(N), rng.normal(scale=3.0, size=N)
    qp.A[:], qp.G[:] = rng.normal(size=(M, N)), rng.normal(size=(p, N))
    qp.b[:] = qp.A @ inside
    qp.h[:] = qp.G @ inside + rng.uniform(0.0, 0.3, p)
    qp.lb[:], qp.ub[:] = inside - rng.uniform(0.01, 0.5, N), inside + rng.uniform(0.01, 0.5, N)
    qp.seal()
    return qp


def problem_set() -> list[QP]:
    """The same problems for every solver, half of them with inequality rows."""
    rng = np.random.default_rng(60)
    return [random_qp(rng, p=P * (i % 2)) for i in range(PROBLEMS)]


def copy_into(qp: QP, other: QP) -> None:
    qp.P[:], qp.q[:], qp.C[:] = other.P, other.q, other.C
    qp.lower[:], qp.upper[:] = other.lower, other.upper


def curvature(qp: QP) -> float:
    return float(np.linalg.eigvalsh(qp.P)[0])


def solved(solver: Solver, qp: QP) -> Solution:
    solution = Solution(qp)
    solver.open(qp, solution)()
    return solution


def checked(solver: Solver, qp: QP) -> tuple[Solution, Status]:
    solution = solved(solver, qp)
    return solution, Verifier(qp, solution, Budget(), curvature(qp)).check()


def active(qp: QP, v: Array) -> tuple[Array, Array]:
    """Which of [-v; v; G v] press on -lb, ub and h, and those rows."""
    rows = np.vstack([-np.eye(N), np.eye(N), qp.G])
    margin = np.concatenate([-qp.lb, qp.ub, qp.h]) - rows @ v
    return margin < 1e-7, rows


def distance_from_optimality(qp: QP, v: Array) -> float:
    """Karush, Kuhn and Tucker by non-negative least squares, with no multipliers of the solver."""
    touching, rows = active(qp, v)
    cone = np.vstack([qp.A, -qp.A, rows[touching]])
    _, residual = scipy.optimize.nnls(cone.T, -(qp.P @ v + qp.q))
    return float(residual)
