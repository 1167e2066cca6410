"""Saturation in the null space, SNS (Flacco, De Luca and Khatib 2015), with the loops first.

Joints that would exceed their bounds are set to the bound, one after the other, and the others take
over the rest of the motion; where they cannot, the tasks are scaled, v keeps their direction:

    J_c v = -kappa e,   J v = s (rate - gain e),   lb <= v <= ub,   0 <= s <= 1

This is the prioritised form of the algorithm with two levels, the loop rows above all tasks
together, so that scaling the tasks leaves the loops unchanged. In each level, with C the rows of
the level above (none for the loops), v_0 its solution, E the rows of the joints that are saturated
and v_E their bounds:

    [C; E] v_h = [C v_0; v_E],   N = null([C; E]),   v = v_h + N (J N)^+ (s wanted - J v_h)

Every joint that exceeds its bounds with s = 1 gives a largest s at which it does not; the joint
with the smallest is saturated next. It ends when no joint exceeds its bounds, or when saturating
one more would cost a task row; then the best s so far is taken.

F. Flacco, A. De Luca and O. Khatib, Control of redundant robots under hard joint constraints:
saturation in the null space, IEEE Trans. Robotics 31(3), 2015. The bounds are the scenario's
limits: position (lower - q)/dt, velocity, and acceleration with braking. The algorithm does not
guarantee the largest s; its "optimal" variant is a QP, see :mod:`coopqp.qp_law`. No step is
verified: near singular poses, where joints move at full speed, loops can open.
"""

from typing import ClassVar, NamedTuple

import numpy as np

from coopqp.base.errors import InvalidValueError
from coopqp.base.rank import least_squares, matrix_rank, null_space
from coopqp.base.spec import Array, spec
from coopqp.controller import Command, Controller, ControlProblem, Features, Law
from coopqp.controllers._resolved_rate import StackedRows
from coopqp.model.state import State
from coopqp.qp_law.bounds import Bounds
from coopqp.solver import Status

#: A bound counts as kept within this [rad/s, m/s]; what is over is cut off.
ROUNDING = 1e-9


class Saturated(NamedTuple):
    """The solution of one level: v, shape (n,) [rad/s, m/s], and its scale s."""

    v: Array
    scale: float


def saturate(
    J: Array, wanted: Array, above: Array, v_above: Array, lb: Array, ub: Array
) -> Saturated | None:
    """One level of the algorithm; None where no scale satisfies the bounds lb, ub on v, (n,).

    J v = wanted are its rows for s = 1, shape (k, n). The rows ``above``, C (m, n), keep what the
    level above has decided, v_above (n,).
    """
    n = J.shape[1]
    joints: list[int] = []
    best: Saturated | None = None
    held, free = v_above, null_space(above)
    values, rank = np.zeros(n), -1
    while True:
        parts = np.column_stack([wanted, -(J @ held)])
        a, b = (free @ least_squares(J @ free, parts)).T
        b = b + held
        v = a + b
        beyond = np.maximum(lb - v, v - ub)
        if beyond.max() <= ROUNDING:
            return Saturated(v, 1.0)
        low, high = _scales(a, b, lb, ub)
        smallest, largest = max(0.0, float(low.max())), min(1.0, float(high.min()))
        if smallest <= largest and (best is None or largest > best.scale):
            best = Saturated(b + largest * a, largest)
        critical = int(np.argmin(np.where(beyond > ROUNDING, high, np.inf)))
        rank = matrix_rank(J @ free) if rank < 0 else rank
        joints.append(critical)
        values[critical] = ub[critical] if v[critical] > ub[critical] else lb[critical]
        settled = np.vstack([above, np.eye(n)[joints]])
        smaller = null_space(settled)
        if smaller.shape[1] == free.shape[1] or matrix_rank(J @ smaller) < rank:
            return best
        change = np.concatenate([np.zeros(len(above)), (values - v_above)[joints]])
        held, free = v_above + least_squares(settled, change), smaller


def _scales(a: Array, b: Array, lb: Array, ub: Array) -> tuple[Array, Array]:
    """For each joint the least and the largest s with lb <= b + s a <= ub."""
    low, high = np.full(len(a), -np.inf), np.full(len(a), np.inf)
    moves = np.abs(a) > ROUNDING
    ends = np.stack([(lb - b)[moves] / a[moves], (ub - b)[moves] / a[moves]])
    low[moves], high[moves] = ends.min(axis=0), ends.max(axis=0)
    outside = ~moves & (np.maximum(lb - b, b - ub) > ROUNDING)
    low[outside], high[outside] = np.inf, -np.inf
    return low, high


class SaturationNullSpaceLaw(Law):
    """The law of one problem; raises InvalidValueError for limits of anything but joints."""

    def __init__(self, problem: ControlProblem) -> None:
        super().__init__(problem)
        chain, start = problem.chain, State(problem.chain)
        self._rows, self._nothing = StackedRows(problem), np.zeros((0, chain.n))
        kept = [limit for limit in problem.limits if not limit.sacrificed_first]
        tries = {Status.OPTIMAL: problem.limits}
        if len(kept) < len(problem.limits):
            tries[Status.ACCELERATION_GIVEN_UP] = kept
        self._tries = [(Bounds(own, start, problem.dt), s) for s, own in tries.items()]
        if rows := self._tries[0][0].rows:
            raise InvalidValueError(
                f"saturation_null_space keeps limits of single joints alone, found "
                f"{rows[0].owner}; take that limit or this controller out"
            )

    def decide(self, state: State) -> Command:
        """Loops, then tasks; without the acceleration limits where they leave no answer."""
        self._rows.update(state)
        self.command.scale = self.command.drift = 0.0  # unless there is an answer
        try:
            for bounds, cause in self._tries:
                bounds.update(state)
                if self._solve(bounds, cause):
                    return self.command
            return self.refuse(Status.INFEASIBLE)
        except np.linalg.LinAlgError:  # a singular value decomposition did not converge
            return self.refuse(Status.SOLVER_ERROR)

    def _solve(self, bounds: Bounds, cause: Status) -> bool:
        """Write the command; False where the bounds leave none."""
        rows, command = self._rows, self.command
        (J_c, drift), lb, ub = rows.loops, bounds.lb, bounds.ub
        loops = saturate(J_c, drift, self._nothing, np.zeros(len(lb)), lb, ub)
        if loops is None:
            return False
        tasks = saturate(rows.tasks.J, rows.tasks.wanted, J_c, loops.v, lb, ub)
        answer = tasks or Saturated(loops.v, 0.0)
        if not np.isfinite(answer.v).all():
            self.refuse(Status.NOT_FINITE)
            return True
        np.clip(answer.v, lb, ub, out=command.v)
        command.scale, command.drift = answer.scale, loops.scale
        slowed = [Status.DRIFT_SLOWED] if loops.scale < 1.0 else []
        given_up = [cause] if cause is not Status.OPTIMAL else []
        command.say(*(given_up + slowed or [Status.OPTIMAL]))
        return True


@spec
class SaturationNullSpace(Controller):
    """SNS (Flacco, De Luca, Khatib 2015): joints saturate, others take over, then tasks scale."""

    supports: ClassVar[Features] = frozenset({"limits"})

    def build(self, problem: ControlProblem) -> Law:
        return SaturationNullSpaceLaw(problem)
