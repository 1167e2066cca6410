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
    """What became of a tick; the value is the message.

    Attributes:
        usable: whether the velocity may be used.
        fallback: whether something was given up to have an answer.
    """

    usable: bool
    fallback: bool

    def __new__(cls, message: str, usable: bool = False, fallback: bool = False) -> Status:
        """A member whose value is the message alone."""
        status = object.__new__(cls)
        status._value_ = message
        status.usable, status.fallback = usable, fallback
        return status

    OPTIMAL = "optimal", True
    INACCURATE = "feasible, but not optimal to the declared accuracy", True
    INFEASIBLE = "the solver found the constraints infeasible"
    UNBOUNDED = "the solver found the problem unbounded"
    ITERATION_LIMIT = "the solver ran out of iterations"
    SOLVER_ERROR = "the solver reported a numerical error"
    NOT_FINITE = "the answer has NaN or infinite values"
    EQUALITY_RESIDUAL = "the answer breaks the loop closure"
    BOUND_RESIDUAL = "the answer breaks a limit"
    TASKS_GIVEN_UP = "hard and scaled tasks became soft: they left no motion", True, True
    ACCELERATION_GIVEN_UP = "an acceleration limit was given up: it left no motion", True, True
    DRIFT_GIVEN_UP = "the drift correction was given up: it left no motion", True, True
    STEP_SHORTENED = "the step was shortened: it would have opened a loop too far", True, True
    RECOVERING = "a joint outside its limits is on its way back", True, True


class Solution:
    """A solver's answer to a QP, in preallocated arrays.

    Attributes:
        v: shape (n,).
        y: multipliers of A v = b, shape (m,).
        z: multipliers of G v <= h, shape (p,), positive when active.
        z_box: multipliers of the bounds, shape (n,), positive at ub, negative at lb.
        status: as the solver says; after :meth:`Verifier.check`, as verified.
        primal_residual: violation of rows or bounds (Euclidean norm).
        dual_residual: mu |v - clip(v - g/mu, lb, ub)| with g = P v + q + A'y + G'z and mu the
            least curvature: |g| where no bound is active, zero at the optimum, whatever
            multipliers the solver gives for the bounds.
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
    """Largest estimated distance from the optimum [rad/s]; beyond it a tick is inaccurate."""
    loop_position: Positive = 1e-3
    """Largest loop error after the step [m]; a step that opens it farther is shortened."""
    loop_orientation: Positive = 1e-2
    """The same for orientations [rad]."""


#: Clipping v by more than this changes its products noticeably [rad/s].
CLIPPED = 1e-10


class Verifier:
    """Checks each solution against the QP itself, whatever solver it came from.

    How far v is from the optimum is told by a projected gradient step of length 1/mu, mu being the
    least curvature of the cost (the damping): v - clip(v - g/mu, lb, ub) vanishes at the optimum
    alone, and where no bound is active its norm bounds |v - v*|.

    Args:
        qp: the problem.
        solution: the answer.
        budget: what it may be off by.
        curvature: smallest eigenvalue that P can have, mu.
    """

    def __init__(self, qp: QP, solution: Solution, budget: Budget, curvature: float) -> None:
        self.qp, self.solution, self.budget = qp, solution, budget
        self._curvature = curvature
        self._per_curvature = np.full(qp.n, 1.0 / curvature)
        self._box, self._change = np.zeros(qp.n), np.zeros(qp.n)
        self._products = np.zeros(qp.n + qp.p + qp.m)
        self._gradient, rows = self._products[: qp.n], self._products[qp.n :]
        self._gap, self._slack = rows[qp.p :], rows[: qp.p]
        self._of_rows = solution.multipliers[qp.n :]

    def check(self) -> Status:
        """Clip v to the bounds and return what it is worth, from its own residuals."""
        qp, solution, budget, v = self.qp, self.solution, self.budget, self.solution.v
        if not solution.status.usable:
            return solution.status
        gap = self._multiply(v)
        if not gap < math.inf:  # written so that a NaN in v fails: even 0 times inf is NaN
            return Status.NOT_FINITE
        overrun = self._clip()
        if overrun > CLIPPED:
            gap = self._multiply(v)
        above, idle = self._inequalities() if qp.p else (0.0, 0.0)
        off = self._distance() + idle
        solution.primal_residual = max(overrun, gap, above)
        solution.dual_residual = off * self._curvature
        if overrun <= budget.bound and above <= budget.bound and gap <= budget.equality:
            if off <= budget.accuracy:
                return Status.OPTIMAL
            return Status.INACCURATE if off < math.inf else Status.NOT_FINITE
        if not off < math.inf:
            return Status.NOT_FINITE
        inside = overrun <= budget.bound and above <= budget.bound
        return Status.EQUALITY_RESIDUAL if inside else Status.BOUND_RESIDUAL

    def _multiply(self, v: Array) -> float:
        """Products of P and C with v; returns how far A v is from b."""
        self.qp.products.dot(v, self._products)
        return _norm(np.subtract(self._gap, self.qp.b, self._gap))

    def _clip(self) -> float:
        """Put v into the bounds; returns how far it was outside."""
        qp, v, box = self.qp, self.solution.v, self._box
        np.minimum(np.maximum(v, qp.lb, out=box), qp.ub, out=box)
        # Once more from below: where the bounds cross, no v is inside.
        np.maximum(box, qp.lb, out=self._change)
        overrun = _norm(np.subtract(v, self._change, self._change))
        v[:] = box
        return overrun

    def _inequalities(self) -> tuple[float, float]:
        """How far G v is above h, and how far z is from belonging to active rows only."""
        slack = np.subtract(self.qp.h, self._slack, self._slack)
        idle = np.minimum(slack, self.solution.z / self._curvature)
        return max(0.0, -float(slack.min())), _norm(np.maximum(idle, -np.abs(self.solution.z)))

    def _distance(self) -> float:
        """Norm of a projected gradient step, an estimate of |v - v*|."""
        qp, v, g = self.qp, self.solution.v, self._gradient
        np.add(g, qp.q, g)
        np.add(g, self._of_rows.dot(qp.C, self._change), g)
        free = _norm(g) / self._curvature
        if free <= self.budget.accuracy:  # no bound holds v back
            return free
        np.multiply(g, self._per_curvature, g)
        np.subtract(v, g, g)
        np.minimum(np.maximum(g, qp.lb, out=g), qp.ub, out=g)
        return _norm(np.subtract(v, g, g))


def _norm(values: Array) -> float:
    """Euclidean norm; it bounds the largest entry and keeps a NaN."""
    return math.sqrt(values.dot(values))
