"""The paper's two-step law: the actuated joints from eq. (17), then the others from eq. (8).

    v_a = (H J_a)^+ h_dot                                  eq. (17), J_a = J motion, eq. (18)-(19)
    [G_p 0; G_pc G_c] [v_p; v_c] = -[G_a; G_ac] v_a        eq. (8), (10)-(12)

Section 5.1 names it before it takes the law of eq. (33) instead. The independent ("actuated")
joints are as many as there are degrees of freedom and chosen once, as the paper's [q1 q2 q3 q7].
Where the others do not follow from them, eq. (8) is singular: the law stops with a status. Near
such poses joint velocities grow without bound. It knows no limits.

With kappa > 0, eq. (8) has -kappa e on its right side, as the loop rows of the other laws have,
and the motion that it causes is subtracted from h_dot.
"""

import numpy as np

from coopqp.base.errors import InvalidValueError
from coopqp.base.rank import independent_rows, least_squares, null_space
from coopqp.base.spec import spec
from coopqp.closed_loop.constraint_equations import SINGULAR_CONDITION, scheme
from coopqp.controller import Command, Controller, ControlProblem, Law
from coopqp.controllers._resolved_rate import StackedRows
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.state import State
from coopqp.solver import Status


class TwoStepLaw(Law):
    """The law built for one problem, with indices of its independent joints."""

    def __init__(self, problem: ControlProblem, actuated: tuple[int, ...]) -> None:
        super().__init__(problem)
        n = problem.chain.n
        self._rows = StackedRows(problem)
        self._actuated = list(actuated)
        self._others = [i for i in range(n) if i not in actuated]
        self._motion, self._drift = np.zeros((n, len(actuated))), np.zeros(n)
        self._motion[self._actuated] = np.eye(len(actuated))

    def decide(self, state: State) -> Command:
        self._rows.update(state)
        try:
            J_c, drift = self._rows.loops
            G_others = J_c[:, self._others]
            if self._others and not np.linalg.cond(G_others) < SINGULAR_CONDITION:
                return self.refuse(Status.SOLVER_ERROR)
            right = np.column_stack([-J_c[:, self._actuated], drift])
            solved = np.linalg.solve(G_others, right)
            self._motion[self._others], self._drift[self._others] = solved[:, :-1], solved[:, -1]
            tasks, command = self._rows.tasks, self.command
            J_a, h_dot = tasks.J @ self._motion, tasks.wanted - tasks.J @ self._drift
            command.v[:] = self._motion @ least_squares(J_a, h_dot) + self._drift
        except np.linalg.LinAlgError:  # a singular value decomposition did not converge
            return self.refuse(Status.SOLVER_ERROR)
        return self.settle()


@spec
class TwoStep(Controller):
    """The paper's two steps, eq. (17) and (8): chosen joints first, the others close the loops."""

    actuated: tuple[str, ...] = ()
    """Names of the independent joints; those that leave eq. (8) best conditioned at the start if
    omitted."""

    def build(self, problem: ControlProblem) -> Law:
        """Choose the joints; UnknownNameError, InvalidValueError: they are no scheme here."""
        chain = problem.chain
        chosen = scheme(chain, self.actuated) if self.actuated else _best(chain)
        return TwoStepLaw(problem, chosen)


def _best(chain: ClosedChain) -> tuple[int, ...]:
    """The joints left over by a pivoted choice of J_c's columns, passive joints first."""
    J_c, passive = State(chain).J_loop, chain.passive.tolist()
    if len(independent_rows(J_c[:, passive].T)) < len(passive):
        raise InvalidValueError(
            "two_step: the motors do not decide how the passive joints "
            f"{', '.join(chain.joint_names[i] for i in passive)} turn; take another controller"
        )
    rest = null_space(J_c[:, passive].T).T @ J_c
    taken = [*passive, *independent_rows(rest.T, max_rows=len(J_c) - len(passive))]
    return tuple(i for i in range(chain.n) if i not in taken)
