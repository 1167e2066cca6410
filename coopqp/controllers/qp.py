"""The QP law: tasks as objectives, loop closure and limits as hard constraints.

minimise    sum_i w_i |J_i v - (rate_i - gain_i e_i)|^2
          + sum_s w_s |v - Z_s|^2 + damping |v|^2
subject to  J_c v = -kappa e,   lb <= v <= ub,   G v <= h
"""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from coopqp.controller import Command, Controller, ControlProblem, Law
from coopqp.limit import LimitRows, Tighten
from coopqp.qp import QP, RowNames
from coopqp.solver import Solution, Verifier
from coopqp.spec import Positive, spec
from coopqp.state import State
from coopqp.task import TaskStack


class QPLaw(Law):
    """The QP of one problem, with its arrays.

    Args:
        problem: what to control.
        damping: cost of |v|^2.

    Attributes:
        qp: the last tick's program.
        solution: its answer.
    """

    def __init__(self, problem: ControlProblem, damping: float) -> None:
        super().__init__(problem)
        chain, start = problem.chain, State(problem.chain)
        self._tasks = TaskStack(problem.tasks, start)
        self._secondary = TaskStack(problem.secondary, start)
        rows = [limit.rows(chain) for limit in problem.limits]
        self.qp = QP(
            RowNames(
                variables=chain.joint_names,
                inequalities=tuple(name for r in rows for name in r),
                equalities=chain.loops.solver_names,
            )
        )
        self.solution = Solution(self.qp)
        self._bind_limits(start)
        self._minus_weights = -self._tasks.weights[:, None]
        self._weighted_J = np.zeros_like(self._tasks.J)
        secondary = self._secondary.weights.reshape(-1, chain.n)
        diagonal = damping + secondary.sum(axis=0)
        self._diagonal = np.diag(diagonal)
        self._pull = np.zeros_like(self._secondary.e)
        self._minus_kappa = np.full_like(start.e_loop, -problem.kappa)
        self._verifier = Verifier(self.qp, self.solution, problem.budget, float(diagonal.min()))
        self._solve = problem.solver.open(self.qp, self.solution)

    def tick(self, state: State) -> Command:
        """Assemble, solve, verify; an answer that fails the check is not used: v = 0."""
        self.assemble(state)
        self._solve()
        status = self._verifier.check()
        self.solution.status = status
        command = self.command
        command.status = status
        if status.usable:
            command.v[:] = self.solution.v
        else:
            command.v[:] = 0.0
            self.solution.v[:] = 0.0
        return command

    def assemble(self, state: State) -> None:
        """Fill the QP for a state."""
        qp = self.qp
        self._fill_objective(state)
        qp.A[:] = state.J_loop
        np.multiply(state.e_loop, self._minus_kappa, qp.b)
        qp.seal()
        qp.lb[:], qp.ub[:] = self._constant_lb, self._constant_ub
        for tighten, rows in self._limits:
            tighten(state, rows)

    def _fill_objective(self, state: State) -> None:
        qp, tasks = self.qp, self._tasks
        tasks.update(state)
        np.multiply(tasks.J, self._minus_weights, self._weighted_J)
        self._weighted_J.T.dot(tasks.J, qp.P)
        np.subtract(self._diagonal, qp.P, qp.P)
        tasks.wanted.dot(self._weighted_J, qp.q)
        if self._secondary.tasks:
            self._fill_secondary(state)

    def _fill_secondary(self, state: State) -> None:
        secondary, q = self._secondary, self.qp.q
        secondary.update(state)
        np.multiply(secondary.weights, secondary.wanted, self._pull)
        for part in secondary.slices:
            np.subtract(q, self._pull[part], q)

    def _bind_limits(self, start: State) -> None:
        """Ask the constant limits now, keep the others for each tick."""
        problem, qp = self.problem, self.qp
        self._limits: list[tuple[Tighten, LimitRows]] = []
        at = 0
        for limit in problem.limits:
            end = at + len(limit.rows(problem.chain))
            rows = LimitRows(qp.lb, qp.ub, qp.G[at:end], qp.h[at:end])
            at = end
            tighten = limit.bind(problem.chain, problem.dt)
            if limit.constant:
                tighten(start, rows)
            else:
                self._limits.append((tighten, rows))
        self._constant_lb, self._constant_ub = qp.lb.copy(), qp.ub.copy()


@spec
class QPController(Controller):
    """QP each tick: tasks as objectives, loop closure and limits as hard constraints."""

    uses_solver: ClassVar[bool] = True

    damping: Positive = 1e-6
    """Cost of |v|^2 [s2/rad2]; makes the answer unique. Below 1e-9 solvers begin to disagree."""

    def build(self, problem: ControlProblem) -> Law:
        """Preallocate the QP and open the solver on it."""
        return QPLaw(problem, self.damping)
