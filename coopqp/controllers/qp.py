"""QP each tick; :mod:`coopqp.qp_law` is the law, here are its settings."""

from __future__ import annotations

from typing import ClassVar

from coopqp.checked import NonNegative, Positive, spec
from coopqp.controller import HEEDS_ALL, Controller, ControlProblem, Heeds, Law
from coopqp.qp_law.law import ERROR_DAMPING, QPLaw


@spec
class QPController(Controller):
    """QP each tick: tasks as objectives, loop closure and limits as hard constraints."""

    uses_solver: ClassVar[bool] = True
    heeds: ClassVar[Heeds] = HEEDS_ALL

    damping: Positive = 1e-6
    """Cost of |v|^2 [s2/rad2]; makes the answer unique. Below 1e-9 solvers begin to disagree."""
    error_damping: NonNegative = ERROR_DAMPING
    """The same for every unit of the squared task error [s2/rad2 per m2]."""

    def build(self, problem: ControlProblem) -> Law:
        """Preallocate the QPs and open the solver on them."""
        return QPLaw(problem, self.damping, self.error_damping)
