"""What a QP solver is, what it answers, and how the answer is checked before it is used."""

from __future__ import annotations

import enum
import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from typing import ClassVar

import numpy as np

from coopqp.base.qp import QP
from coopqp.base.rank import null_space
from coopqp.base.spec import Array, Positive, spec


class Status(enum.Enum):
    """Status of a tick, with its message; ``relaxed``: a constraint was relaxed."""

    usable: bool
    relaxed: bool

    def __new__(cls, message: str, usable: bool = False, relaxed: bool = False) -> Status:
        """A member whose value is the message alone."""
        status = object.__new__(cls)
        status._value_ = message
        status.usable, status.relaxed = usable, relaxed
        return status

    OPTIMAL = "optimal", True
    INACCURATE = "feasible, but not optimal to the declared accuracy", True
    INFEASIBLE = "the solver found the constraints infeasible"
    UNBOUNDED = "the solver found the problem unbounded"
    ITERATION_LIMIT = "the solver ran out of iterations"
    SOLVER_ERROR = "the solver reported a numerical error"
    NOT_FINITE = "the state or the answer has NaN or infinite values"
    EQUALITY_RESIDUAL = "the answer violates the loop closure"
    BOUND_RESIDUAL = "the answer violates a limit"
    TASKS_RELAXED = (
        "hard or scaled tasks are not met in full: limits, loops or damping leave no such motion",
        True,
        True,
    )
    ACCELERATION_GIVEN_UP = "an acceleration limit was relaxed: no motion keeps it", True, True
    CONTACT_GIVEN_UP = "friction cannot bear it: a hand that presses may slip", True, True
    DRIFT_SLOWED = "the Baumgarte correction was reduced: no motion does all of it", True, True
    SOLVER_FAILED = (
        "the solver failed on the whole problem; a smaller one had an answer",
        True,
        True,
    )
    STEP_SHORTENED = "the step was shortened: it would have opened a loop too far", True, True
    LOOP_BUDGET = "stands still: the loop budget is used up"
    WRONG_STATE = "the state belongs to a chain with other joints or arms"
    OVERWRITTEN = "state.q is not what was commanded; write measurements to q_measured", True
    RAISED = "stands still: code of a task, a limit, a solver or the controller raised an error"
    PLANT_FAILED = "stands still: what is controlled broke down, or its simulation did"
    OBJECT_LOST = "the run ends: the hands have lost the object"
    NOT_MEASURED = "the measured joints are no finite numbers, or not one for each joint", True
    FORCE_NOT_MEASURED = "nobody says what the hands do to the object, in usable numbers", True
    SQUEEZE_GIVEN_UP = "the hands may come no closer for a squeeze that is not there", True, True
    OFFSET_AT_BOUND = "the model's error has changed more than it may; the rest is pulled at", True
    INPUT_STALE = "nothing new has arrived at an input in time", True
    INPUT_REFUSED = "what arrived at an input cannot be used", True
    ROBOT_SILENT = "comes to rest: the robot does not say where it is", True, True
    MEASURED_JUMPED = (
        "comes to rest: the measured joints are farther from the last than they can have gone",
        True,
        True,
    )
    JOINT_DOUBTED = (
        "brakes: a joint may not follow its commands, as the next samples will show",
        True,
        True,
    )
    CLOCK_WRONG = "comes to rest: the loop's clock does not say the time", True, True
    STOPPED = "comes to rest, and stays there until it is told to go on", True, True
    NOT_BEGUN = "stands still: the loop cannot begin where the robot is"
    LATE = "the tick came late; references have waited for it", True
    EARLY = "the tick came before its period was over; the last command holds until then", True
    FAULT = "a sensor or a motor of the robot is wrong, as it seems; the note names it", True
    RECOVERING = "a joint outside its limits is recovering", True, True


HALTS = frozenset({
    Status.ROBOT_SILENT, Status.MEASURED_JUMPED, Status.CLOCK_WRONG, Status.JOINT_DOUBTED,
    Status.STOPPED,
})  # fmt: skip
"""What the loop for robots says of a tick in which it brakes and asks its law for nothing; it does
so for ``NOT_MEASURED``, too, with which others go on."""
STANDS = HALTS | {Status.NOT_MEASURED, Status.NOT_BEGUN, Status.RAISED}
"""After what a loop for robots comes to rest, or its joints are not known."""


def written(causes: Sequence[Status]) -> str:
    """All causes of a tick in one word, the gravest first, such as "TASKS_RELAXED+RECOVERING"."""
    return "+".join(cause.name for cause in causes)


def causes_of(word: str) -> tuple[Status, ...]:
    """The causes behind what :func:`written` wrote."""
    return tuple(Status[name] for name in word.split("+"))


class Solution:
    """A solver's answer to a QP, in preallocated arrays.

    Attributes:
        v: shape (n,).
        y: multipliers of A v = b, shape (m,).
        z: multipliers of G v <= h, shape (p,), positive when active.
        z_box: multipliers of the bounds, shape (n,), positive at ub, negative at lb.
        multipliers: [z_box; z; y], of which these are views. answer: [v; multipliers].
        status: as the solver says; after :meth:`Verifier.check`, as verified.
        primal_residual: violation of rows or bounds (Euclidean norm).
        dual_residual: mu |v - clip(v - g/mu, lb, ub)| with g = P v + q + A'y + G'z and mu the least
            curvature: |g| where no bound is active, zero at the optimum, whatever multipliers the
            solver gives for the bounds.
    """

    def __init__(self, qp: QP) -> None:
        n, p = qp.n, qp.p
        self.answer = np.zeros(2 * n + p + qp.m)
        self.v, self.multipliers = np.split(self.answer, [n])
        self.z_box, self.z, self.y = np.split(self.multipliers, [n, n + p])
        self.status = Status.SOLVER_ERROR
        self.primal_residual = np.inf
        self.dual_residual = np.inf


Solve = Callable[[], None]


@spec
class Solver(ABC):
    """A plug-in in ``solvers/``: settings, and how to open it on a QP's arrays."""

    kernel_instead: ClassVar[bool] = False
    """Whether the compiled kernel may take its place: it lands on the optimum itself too."""

    @abstractmethod
    def open(self, qp: QP, solution: Solution) -> Solve:
        """Set up once; the returned function solves what qp then holds and raises nothing.

        It writes v, multipliers and status. MissingDependencyError: the solver is not installed.
        """


@spec
class Budget:
    """What a solution may be off by and still be used."""

    equality: Positive = 1e-6
    """Largest residual of a loop row [m/s, rad/s]."""
    bound: Positive = 1e-6
    """Largest violation of a bound before clipping [rad/s, m/s]."""
    accuracy: Positive = 1e-6
    """Largest estimated distance from the optimum [rad/s]; beyond it a tick is inaccurate."""
    loop_position: Positive = 1e-3
    """Largest loop error after the step [m]; a step that opens it farther is shortened."""
    loop_orientation: Positive = 1e-2
    """The same for orientations [rad]."""


#: Most of a distance from the optimum that rounding excuses [rad/s].
ROUNDING = 1e-4
EPSILON = float(np.finfo(float).eps)
#: By which rows may not hold from rounding alone, and the least singular value of rows, over the
#: largest, that is not rounding itself.
LAST_DIGITS, DEPENDENT = 1e-14, 1e-12
#: Length up to which such a step is not worth making, and by which solvers take a limit for kept
#: that is exceeded [rad/s].
IDLE = 1e-12
#: Share of a limit's row that others leave of it where its last digits may matter.
NEARLY = 1e-4
#: An answer beyond this is as good as infinite: its products could overflow [rad/s].
BEYOND = 1e150


class Verifier:
    """Checks each solution against the QP itself, whatever solver it came from.

    The distance of v from the optimum is estimated by a projected gradient step of length 1/mu, mu
    being the smallest eigenvalue that P can have (``curvature``, the damping): v - clip(v - g/mu,
    lb, ub) vanishes at the optimum alone, and where no bound is active its norm bounds |v - v*|.

    Dividing by mu magnifies rounding as well: where limits and loop rows nearly contradict each
    other, multipliers reach 1e5 and their last digits make a step of 1e-5 rad/s at the optimum. So
    a step counts as none up to eps | |P| |v| + |q| + |C'| |[z; y]| | / mu, at most ``ROUNDING``:
    within it v is the optimum of a problem that differs in the last digits.

    Rows that nearly depend on each other, or on active limits, hold almost as well far from the
    optimum. Their residual therefore counts by the length of the step that removes it. A NaN stays
    one, and all comparisons are written so that it fails them.
    """

    def __init__(self, qp: QP, solution: Solution, budget: Budget, curvature: float) -> None:
        self.qp, self.solution, self.budget = qp, solution, budget
        self.curvature = curvature
        self._correction: Array | None = None

    def check(self) -> Status:
        """Clip v to the bounds and return what it is worth, from its own residuals."""
        qp, solution, budget = self.qp, self.solution, self.budget
        if not solution.status.usable:
            return self._refuse(Status.NOT_FINITE if self._lacks_numbers() else solution.status)
        if not norm(solution.v) + norm(solution.multipliers) < BEYOND:
            return self._refuse(Status.NOT_FINITE)
        raised = np.maximum(solution.v, qp.lb)
        violation = norm(raised - np.minimum(solution.v, qp.ub))
        solution.v[:] = np.minimum(raised, qp.ub)
        slack = qp.h - qp.G.dot(solution.v)
        above = norm(np.minimum(slack, 0.0))
        gap = norm(qp.A.dot(solution.v) - qp.b)
        off = self._distance() + self._idle(slack)
        astray = self._astray(slack, gap)
        solution.primal_residual = max(violation, gap, above)
        solution.dual_residual = off * self.curvature
        if not gap + off < math.inf:
            return Status.NOT_FINITE
        if not (violation <= budget.bound and above <= budget.bound):
            return Status.BOUND_RESIDUAL
        if gap > budget.equality:
            return Status.EQUALITY_RESIDUAL
        enough = budget.accuracy
        sure = astray <= enough and (off <= enough or off <= enough + self._rounding())
        return Status.OPTIMAL if sure and self._unsure(slack) <= enough else Status.INACCURATE

    def polish(self, checked: Status) -> Status:
        """After a check let equalities and active limits hold, where the answer is as good then."""
        if self._correction is None or not checked.usable:
            return checked
        kept = self.solution.answer.copy()
        self.solution.answer += self._correction
        if self.check() is Status.OPTIMAL:
            return Status.OPTIMAL
        self.solution.answer[:] = kept
        return self.check()

    def _lacks_numbers(self) -> bool:
        """Whether a number of the QP is none, whatever the solver's status."""
        qp = self.qp
        finite = all(np.isfinite(part).all() for part in (qp.P, qp.q, qp.C, qp.b))
        return not finite or any(np.isnan(part).any() for part in (qp.h, qp.lb, qp.ub))

    def _refuse(self, status: Status) -> Status:
        """There are no residuals to report."""
        self.solution.primal_residual = self.solution.dual_residual = math.inf
        return status

    def _idle(self, slack: Array) -> float:
        """How far z is from belonging to active rows only, those without slack."""
        z, step = self.solution.z, self.solution.z / self.curvature
        return norm(np.where(z < 0.0, step, np.maximum(np.minimum(slack, step), -z)))

    def _astray(self, slack: Array, gap: float) -> float:
        """Length of the cheapest step after which all equalities and active limits hold."""
        qp, solution, mu, self._correction = self.qp, self.solution, self.curvature, None
        if gap <= LAST_DIGITS and not solution.multipliers[: qp.n + qp.p].any():
            return 0.0
        to_bound = np.where(solution.z_box > 0.0, qp.ub, qp.lb) - solution.v
        lacks = np.concatenate([to_bound, slack, qp.b - qp.A.dot(solution.v)])
        pulls = np.concatenate([np.abs(solution.z_box), solution.z, np.full(qp.m, np.inf)])
        active = np.abs(lacks) < pulls / mu
        active[qp.n : qp.n + qp.p] |= slack < -LAST_DIGITS  # by what solvers tolerate
        lacks, C = lacks[active], np.concatenate([np.eye(qp.n), qp.C])[active]
        if norm(lacks) <= LAST_DIGITS:
            return 0.0
        if not math.isfinite(norm(C.ravel()) + norm(qp.P.ravel()) + norm(lacks)):
            return math.inf
        root = np.linalg.cholesky(qp.P)
        C = np.linalg.solve(root, C.T).T  # over steps in which the cost bends by one
        sizes = np.maximum(np.linalg.norm(C, axis=1), EPSILON)
        inverse = np.linalg.pinv(C / sizes[:, None], rcond=DEPENDENT) / sizes
        bent, pulls = inverse.dot(lacks), np.zeros(len(active))
        pulls[active] = -bent.dot(inverse)  # with which the gradient stays
        step = np.linalg.solve(root.T, bent)
        self._correction = np.concatenate([step, pulls]) if norm(step) > IDLE else None
        return norm(step)

    def _unsure(self, slack: Array) -> float:
        """How far v may be off because limits are reached to the last digits.

        Whether one is may matter much where its row nearly depends on others that hold. Without
        equalities limits that do give way (:class:`coopqp.qp_law.level.Step`).
        """
        qp, solution, n, worst = self.qp, self.solution, self.qp.n, 0.0
        pushes = np.abs(solution.multipliers[: n + qp.p]) > IDLE * self.curvature
        if not qp.m or not pushes.any():
            return worst
        margin = np.concatenate([np.minimum(solution.v - qp.lb, qp.ub - solution.v), slack])
        reached = margin <= IDLE
        on, held = pushes | reached, np.concatenate([pushes, np.ones(qp.m, bool)])
        C = qp.C[np.concatenate([on[n:], held[n + qp.p :]])]
        values = np.linalg.svd(C[:, ~on[:n]], compute_uv=False)  # of rows but bounds
        values /= max(np.abs(C).max(), EPSILON)
        if not ((values > DEPENDENT) & (values < NEARLY)).any():
            return worst
        root = np.linalg.cholesky(qp.P)
        rows = np.linalg.solve(root, np.concatenate([np.eye(n), qp.C]).T).T  # as :meth:`_astray`
        sizes, holds = np.maximum(np.linalg.norm(rows, axis=1), EPSILON), np.flatnonzero(held)
        rows /= sizes[:, None]
        for i in np.flatnonzero(reached).tolist():
            free = null_space(rows[holds[holds != i]])
            part = rows[i] @ free
            left = norm(part)
            if DEPENDENT < left < NEARLY:
                step = np.linalg.solve(root.T, free @ part)
                worst = max(worst, IDLE / sizes[i] * norm(step) / left**2)
        return worst

    def _distance(self) -> float:
        """Norm of a projected gradient step, an estimate of |v - v*|."""
        qp, solution = self.qp, self.solution
        g = qp.P.dot(solution.v) + qp.q + solution.multipliers[qp.n :].dot(qp.C)
        step = g / self.curvature
        free = norm(step)
        if free <= self.budget.accuracy:  # no bound holds v back
            return free
        there = np.minimum(np.maximum(solution.v - step, qp.lb), qp.ub)
        return norm(solution.v - there)

    def _rounding(self) -> float:
        """How much of the distance rounding can explain."""
        qp, solution = self.qp, self.solution
        sizes = np.abs(qp.P) @ np.abs(solution.v) + np.abs(qp.q)
        sizes += np.abs(solution.multipliers[qp.n :]) @ np.abs(qp.C)
        return min(EPSILON * norm(sizes) / self.curvature, ROUNDING)


def norm(x: Array) -> float:
    """Euclidean; NaN where a number is none, infinite where squares overflow."""
    return math.sqrt(x.dot(x))
