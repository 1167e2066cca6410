"""The paper's "pseudo": eq. (33) with Z = 0."""

import numpy as np

from coopqp.base.spec import Positive, spec
from coopqp.controller import Controller, ControlProblem, Law
from coopqp.controllers._resolved_rate import ResolvedRateLaw


@spec
class Pseudoinverse(Controller):
    """Classical law, eq. (33) with Z = 0: minimum joint speed; knows no limits."""

    rcond: Positive = 1e-10
    """Singular values below this share of the largest count as zero."""

    def build(self, problem: ControlProblem) -> Law:
        return ResolvedRateLaw(problem, lambda J: np.linalg.pinv(J, self.rcond), null_space=False)
