"""Joints move with as little kinetic energy as they can: T = v' A v / 2.

    e = 0,   J = U,   rate = 0,   A = U' U

A is the inertia matrix of the arms with the object on the first, U its upper Cholesky factor, so
that |J v|^2 = 2 T. The rows are combinations of joints, the first of all and the last of one, and
the gain is without effect. Where A is singular, as with a joint that moves no mass, U is that of A
plus ``MASSLESS`` of its mean diagonal entry.
"""

from typing import ClassVar

import numpy as np
import pinocchio as pin
from scipy.linalg import lapack

from coopqp.base.spec import NonNegative, spec
from coopqp.closed_loop.dynamics import ClosedLoopDynamics
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.state import State
from coopqp.task import Evaluate, Task, TaskRows

#: Share of the mean inertia that every joint has at least.
MASSLESS = 1e-9


@spec
class MinimumKineticEnergy(Task):
    """Joints move with as little kinetic energy as the tasks allow (one row a joint)."""

    unit: ClassVar[str] = "kg^0.5 m"

    weight: NonNegative = 1e-2
    """Cost of twice the kinetic energy [1/J]; low, so that the tasks win."""

    def rows(self, chain: ClosedChain) -> tuple[str, ...]:
        """The joints, by the first that each row combines."""
        return chain.joint_names

    def bind(self, start: State) -> Evaluate:
        model, n = ClosedLoopDynamics(start.chain).model, start.chain.n
        data, diagonal = model.createData(), np.arange(n)

        def evaluate(state: State, rows: TaskRows) -> None:
            A = pin.crba(model, data, state.q)
            A[diagonal, diagonal] += MASSLESS / n * A.trace()
            factor, failed = lapack.dpotrf(A, lower=0, clean=1)
            rows.J[:] = 0.0 if failed else factor
            rows.e[:] = 0.0
            rows.rate[:] = 0.0

        return evaluate
