"""The paper's "joint limit motion": eq. (33)-(34) with Z from the secondary objectives."""

from typing import ClassVar

import numpy as np

from coopqp.base.spec import Positive, spec
from coopqp.controller import Controller, ControlProblem, Features, Law
from coopqp.controllers._resolved_rate import ResolvedRateLaw


@spec
class PseudoinverseNullSpace(Controller):
    """Classical law with null-space term, eq. (33)-(34): gradient projection, no hard limits."""

    supports: ClassVar[Features] = frozenset({"secondary"})

    rcond: Positive = 1e-10
    """Singular values below this share of the largest count as zero."""

    def build(self, problem: ControlProblem) -> Law:
        return ResolvedRateLaw(problem, lambda J: np.linalg.pinv(J, self.rcond), null_space=True)
