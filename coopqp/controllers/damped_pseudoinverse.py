"""Damped least squares: the fair baseline near singular poses (Nakamura and Hanafusa 1986).

(H J_ext)^# = J' (J J' + damping^2 I)^-1
"""

from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from coopqp.base.spec import Array, Positive, spec
from coopqp.controller import Controller, ControlProblem, Features, Law
from coopqp.controllers._resolved_rate import ResolvedRateLaw


@spec
class DampedPseudoinverse(Controller):
    """Damped least squares: bounded near singular poses, pays with errors of task and loop."""

    supports: ClassVar[Features] = frozenset({"secondary"})

    damping: Positive = 0.02
    """Singular values well below this are damped out [m/rad]."""

    def build(self, problem: ControlProblem) -> Law:
        squared = self.damping**2

        def invert(J: Array) -> NDArray[np.floating[Any]]:
            gram = J.dot(J.T)  # which, unlike @, warns of nothing
            gram.flat[:: len(gram) + 1] += squared
            return np.linalg.solve(gram, J).T

        return ResolvedRateLaw(problem, invert, null_space=True, damping=self.damping)
