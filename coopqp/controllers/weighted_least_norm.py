"""Weighted least norm (Chan and Dubey 1995): joints near a limit move less, where others can.

    v = W^-1 A' (A W^-1 A')^-1 b,     A = H J_ext,   b = [h_dot; V_rel]          eq. (32)

    H(q) = sum_i (u_i - l_i)^2 / (4 (u_i - q_i) (q_i - l_i)),    W = diag(w)
    w_i = 1 + |dH/dq_i|   where |dH/dq_i| does not fall, i.e. the joint moves towards its limit
        = 1               where it falls, so that a joint can return freely

T. F. Chan and R. V. Dubey, A weighted least-norm solution based scheme for avoiding joint limits
for redundant joint manipulators, IEEE Trans. Robotics and Automation 11(2), 1995. There the robot
is one open arm and A its Jacobian; here the loop rows are below the tasks', as in eq. (33).

H grows without bound towards a limit. A tick is finite and can step over it, so a joint within
``NEAREST`` of the limit, or beyond it, counts as ``NEAREST`` away. All tasks are always met, if
necessary beyond a limit: this law repels joints from limits and does not enforce them.
"""

import numpy as np

from coopqp.base.rank import least_squares
from coopqp.base.spec import Array, spec
from coopqp.controller import Command, Controller, ControlProblem, Law
from coopqp.controllers._resolved_rate import StackedRows
from coopqp.kernel.formula import FormulaLaw
from coopqp.model.state import State
from coopqp.solver import Status

#: Least distance to a limit that counts, as a share of the joint's range.
NEAREST = 1e-4


class WeightedLeastNormLaw(FormulaLaw):
    """The law built for one problem."""

    def __init__(self, problem: ControlProblem) -> None:
        super().__init__(problem, weighted=True)
        chain = problem.chain
        self._rows = StackedRows(problem)
        self._limited = np.isfinite(chain.lower) & np.isfinite(chain.upper)
        self._lower, self._upper = chain.lower[self._limited], chain.upper[self._limited]
        self._range = self._upper - self._lower
        self._weights = np.ones(chain.n)

    def decide(self, state: State) -> Command:
        """The least norm of W^(1/2) v, by singular values."""
        rows, command = self._rows, self.command
        rows.update(state)
        shrink = 1.0 / np.sqrt(self.weights(state))
        try:
            command.v[:] = shrink * least_squares(rows.A * shrink, rows.b)
        except np.linalg.LinAlgError:  # the singular value decomposition did not converge
            return self.refuse(Status.SOLVER_ERROR)
        return self.settle()

    def weights(self, state: State) -> Array:
        """The diagonal of W at a state, shape (n,); 1 for joints without limits."""
        lower, upper, keep = self._lower, self._upper, NEAREST * self._range
        q = np.clip(state.q[self._limited], lower + keep, upper - keep)
        off_middle = 2.0 * q - upper - lower
        slope = self._range**2 * off_middle / (4.0 * (upper - q) ** 2 * (q - lower) ** 2)
        # |dH/dq| grows with the distance from the middle, so the joint's last motion tells.
        towards = state.v[self._limited] * off_middle >= 0.0
        self._weights[self._limited] = np.where(towards, 1.0 + np.abs(slope), 1.0)
        return self._weights


@spec
class WeightedLeastNorm(Controller):
    """Weighted least norm (Chan, Dubey 1995): spares joints near their limits, can't stop there."""

    def build(self, problem: ControlProblem) -> Law:
        return WeightedLeastNormLaw(problem)
