"""Hard and scaled tasks where limits and loops leave no motion that does all they ask.

They are levels of a hierarchy of least-squares problems with inequalities (Kanoun, Lamiraux and
Wieber 2011; Escande, Mansard and Wieber 2014), above all soft tasks: first the hard ones,

    minimise    sum_i w_i |J_i v - wanted_i|^2 + d |v|^2
    subject to  J_c v = -kappa e,   lb <= v <= ub,   G v <= h

then, with J_i v of these fixed, the scaled ones: the largest shares of what they want, and where no
share of it can be had the motion that is nearest to it,

    minimise    sum_k w_k (|across_k|^2 + ALONG |along_k|^2) + d |v|^2

with J_k v - wanted_k split along and across wanted_k. Later levels keep what was got. The damping is
that of a soft task (:class:`coopqp.qp_law.equations.Damping`), by what the rows lacked in the last
tick, m_i, instead of what they ask for: d = damping + c dt sum_i w_i |m_i| L_i. So it is nothing as
long as they hold, and grows from there as they cease to.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from coopqp.checked import Array
from coopqp.controller import ControlProblem
from coopqp.qp_law.bounds import Bounds
from coopqp.qp_law.equations import LEAST_SPEED, Damping
from coopqp.qp_law.level import Level
from coopqp.qp_law.priorities import Order
from coopqp.row import Row
from coopqp.solver import Status
from coopqp.state import State
from coopqp.task import TaskStack

#: Weight of what a scaled task lacks along its direction, beside what it does across it.
ALONG = 1e-3
#: Their least damping, beside that of the soft tasks.
LESS = 1e-3
#: Rows that lack less than this are met [m/s, rad/s].
MET = 1e-9


class Nearest:
    """The nearest motion to what hard tasks, or scaled ones after them, want.

    Args:
        problem: what to control.
        order: of its tasks.
        bounds: the limits.
        damping: cost of |v|^2.

    Attributes:
        v: the answer of the level that was solved last, shape (n,).
    """

    def __init__(
        self, problem: ControlProblem, order: Order, bounds: Bounds, damping: Damping
    ) -> None:
        self._exact, self._bounds, self._damping = order.exact, bounds, damping
        self._count = sum(order.exact.sizes[: len(order.hard)])
        stacks = TaskStack(order.hard, order.start), TaskStack(order.scaled, order.start)
        fixed = tuple(Row(name=f"nearest[{i}]", kind="decided") for i in range(self._count))
        loops = tuple(problem.chain.loops.solver_rows)
        less = replace(damping, least=LESS * damping.least)
        self._hard = Level(problem, stacks[0], loops, bounds, less)
        self._scaled = Level(problem, stacks[1], (*loops, *fixed), bounds, less)
        for level in (self._hard, self._scaled):  # which decide what rows do, not all of v
            level.certified = damping.least
        self.v = self._hard.v

    def of_hard(self, state: State, kappa: float) -> Status:
        """Solve the level of the hard tasks; the exact stack is up to date."""
        exact, tasks, rows = self._exact, self._hard.tasks, slice(self._count)
        tasks.J[:], tasks.wanted[:] = exact.J[rows], exact.wanted[rows]
        return self._solve(self._hard, state, kappa, rows)

    def of_scaled(self, state: State, kappa: float, hard: Array) -> Status:
        """Solve the level of the scaled tasks.

        Args:
            state: of the tick.
            kappa: gain of the drift correction.
            hard: what J v of the hard rows is, shape (rows of these,).
        """
        exact, level, rows = self._exact, self._scaled, slice(self._count, None)
        J, wanted = level.tasks.J, level.tasks.wanted
        J[:], wanted[:] = exact.J[rows], exact.wanted[rows]
        for part in level.tasks.slices:
            size = np.sqrt(wanted[part] @ wanted[part] + LEAST_SPEED**2)
            along = wanted[part] / size
            less = (1.0 - np.sqrt(ALONG)) * along
            J[part] -= np.outer(less, along @ J[part])
            wanted[part] -= less * (along @ wanted[part])
        A, b, m = level.qp.A, level.qp.b, len(state.e_loop)
        A[m:], b[m:] = exact.J[: self._count], hard
        return self._solve(level, state, kappa, rows)

    def _solve(self, level: Level, state: State, kappa: float, rows: slice) -> Status:
        missed = np.abs(state.memory["missed"][rows])
        bend = float((self._exact.weights * self._exact.levers)[rows] @ missed)
        level.assemble(self._bounds, self._damping.of(bend, state))
        level.close_loops(state, kappa)
        self.v = level.v
        return level.solve()
