"""What a QP solver is, what it answers, and how the answer is checked before it is used."""

from __future__ import annotations

import enum
import math
from abc import abstractmethod
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from coopqp.qp import QP
from coopqp.spec import Positive, spec

Array = NDArray[np.float64]


class Status(enum.Enum):
    """What became of a tick; the value is the message."""

    OPTIMAL = "optimal"
    INACCURATE = "feasible, but not optimal to the declared accuracy"
    INFEASIBLE = "the solver found the constraints infeasible"
    UNBOUNDED = "the solver found the problem unbounded"
    ITERATION_LIMIT = "the solver ran out of iterations"
    SOLVER_ERROR = "the solver reported a numerical error"
    NOT_FINITE = "the answer has NaN or infinite values"
    EQUALITY_RESIDUAL = "the answer breaks the loop closure"
    BOUND_RESIDUAL = "the answer breaks a limit"

    @property
    def usable(self) -> bool:
        """Whether the velocity may be used."""
        return self in (Status.OPTIMAL, Status.INACCURATE)


class Solution:
    """A solver's answer to a QP, in preallocated arrays.

    Attributes:
        v: shape (n,).
        y: multipliers of A v = b, shape (m,).
        z: multipliers of G v <= h, shape (p,), positive when active.
        z_box: multipliers of the bounds, shape (n,), positive at ub, negative at lb.
        status: as the solver says; after :meth:`Verifier.check`, as verified.
        primal_residual: violation of rows or bounds (Euclidean norm).
        dual_residual: norm of v - clip(v - g, lb, ub) with g = P v + q + A'y + G'z: zero
            at the optimum, whatever multipliers the solver gives for the bounds.

    """

    def __init__(self, qp: QP) -> None:
        self.v = np.zeros(qp.n)
        self.multipliers = np.zeros(qp.n + qp.p + qp.m)
        self.z_box = self.multipliers[: qp.n]
        self.z = self.multipliers[qp.n : qp.n + qp.p]
        self.y = self.multipliers[qp.n + qp.p :]
        self.status = Status.SOLVER_ERROR
        self.primal_residual = np.inf
        self.dual_residual = np.inf


Solve = Callable[[], None]


@spec
class Solver:
    """A plug-in in ``solvers/``: settings, and how to open it on a QP's arrays."""

    @abstractmethod
    def open(self, qp: QP, solution: Solution) -> Solve:
        """Set the solver up once; the returned function solves what qp then holds.

        It writes v, multipliers and status of the solution, and raises nothing.

        Raises:
            MissingDependencyError: the solver is not installed.

        """
        raise NotImplementedError


@spec
class Budget:
    """What a solution may be off by and still be used."""

    equality: Positive = 1e-6
    """Largest residual of a loop row [m/s, rad/s]."""
    bound: Positive = 1e-6
    """Largest overrun of a bound before it is clipped to the bound [rad/s, m/s]."""
    accuracy: Positive = 1e-6
    """Largest distance of v from the optimum [rad/s]; beyond it a tick counts as inaccurate."""


class Verifier:
    """Checks each solution against the QP itself, whatever solver it came from.

    The distance to the optimum is bounded by the dual residual over the QP's curvature: with
    curvature mu (at least the damping), |v - v*| <= |residual| / mu.

    Args:
        qp: the problem.
        solution: the answer.
        budget: what it may be off by.
        curvature: smallest eigenvalue that P can have, mu.

    """

    def __init__(self, qp: QP, solution: Solution, budget: Budget, curvature: float) -> None:
        self.qp, self.solution, self.budget = qp, solution, budget
        self._dual = budget.accuracy * curvature
        self._box, self._change = np.zeros(qp.n), np.zeros(qp.n)
        self._rows, self._gradient = np.zeros(qp.p + qp.m), np.zeros(qp.n)
        self._gap, self._above = self._rows[qp.p :], self._rows[: qp.p]
        self._of_rows = solution.multipliers[qp.n :]

    def check(self) -> Status:
        """Clip v to the bounds and return what it is worth, from its own residuals."""
        qp, solution, budget = self.qp, self.solution, self.budget
        if not solution.status.usable:
            return solution.status
        overrun = self._clip()
        qp.C.dot(solution.v, self._rows)
        gap = _norm(np.subtract(self._gap, qp.b, self._gap))
        above = max(0.0, float(np.subtract(self._above, qp.h).max())) if qp.p else 0.0
        solution.primal_residual = max(overrun, gap, above)
        solution.dual_residual = dual = self._dual_residual()
        # Written so that a NaN anywhere fails.
        if not overrun < math.inf:
            return Status.NOT_FINITE
        if not (overrun <= budget.bound and above <= budget.bound):
            return Status.BOUND_RESIDUAL
        if not gap <= budget.equality:
            return Status.EQUALITY_RESIDUAL
        return Status.OPTIMAL if dual <= self._dual else Status.INACCURATE

    def _clip(self) -> float:
        """Put v into the bounds; returns how far it was outside, NaN if v has one."""
        qp, v, box = self.qp, self.solution.v, self._box
        np.minimum(np.maximum(v, qp.lb, out=box), qp.ub, out=box)
        overrun = _norm(np.subtract(v, box, self._change))
        v[:] = box
        return overrun

    def _dual_residual(self) -> float:
        qp, v, gradient = self.qp, self.solution.v, self._gradient
        qp.P.dot(v, gradient)
        np.add(gradient, qp.q, gradient)
        np.add(gradient, self._of_rows.dot(qp.C, self._change), gradient)
        free = _norm(gradient)
        if free <= self._dual:  # no bound holds v back
            return free
        np.subtract(v, gradient, gradient)
        np.minimum(np.maximum(gradient, qp.lb, out=gradient), qp.ub, out=gradient)
        return _norm(np.subtract(v, gradient, gradient))


def _norm(values: Array) -> float:
    """Euclidean norm; it bounds the largest entry and keeps a NaN."""
    return math.sqrt(values.dot(values))
