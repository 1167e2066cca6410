"""The transposed Jacobian instead of its inverse, along the loops: no matrix of the tasks inverted.

With w = rate - gain e, the motion that the tasks ask for, and N = I - J_c^+ J_c, which keeps the
loops closed, the joints go down the slope of |J v - w|^2 as far as one step can:

    v = a N J' w - kappa J_c^+ e_c,   a = |N J' w|^2 / |J N J' w|^2
"""

from __future__ import annotations

import numpy as np

from coopqp import Command, Controller, ControlProblem, Law, State, TaskStack, spec


class JacobianTransposeLaw(Law):
    """One step down the slope a tick."""

    def __init__(self, problem: ControlProblem) -> None:
        super().__init__(problem)
        self._tasks = TaskStack(problem.tasks, State(problem.chain))

    def decide(self, state: State) -> Command:
        """The velocity for the next dt; it raises nothing."""
        tasks, inverse = self._tasks, np.linalg.pinv(state.J_loop)
        tasks.update(state)
        slope = tasks.J.T @ tasks.wanted
        slope -= inverse @ (state.J_loop @ slope)
        moved = tasks.J @ slope
        step = (slope @ slope) / max(float(moved @ moved), 1e-12)
        self.command.v[:] = step * slope - self.problem.kappa * (inverse @ state.e_loop)
        return self.command


@spec
class JacobianTranspose(Controller):
    """Transposed Jacobian: slow but never singular; knows no limits."""

    def build(self, problem: ControlProblem) -> Law:
        """Bind the tasks."""
        return JacobianTransposeLaw(problem)
