"""Step verification: no step may open a loop farther than the budget."""

import numpy as np

from coopqp.base.spec import Array
from coopqp.controller import Command, ControlProblem
from coopqp.limit import opening
from coopqp.model.state import State
from coopqp.solver import Status, norm

HALVINGS = 20  # with which the largest share of a step is found that does not open a loop too far
SHORTEST = 2.0**-10  # share below which no step is made


class StepVerification:
    """Whether the loops stay within their budget after a step.

    To first order, by the equality rows, an error e becomes 2 |e| at most. The second order is
    bounded: for an arm of k revolute joints with reach rho, |p''| <= rho (sum |v_j|)^2 <= rho k
    sum v_j^2, and likewise for the angle with rho = 1: :func:`coopqp.limit.opening` has the sum of
    a loop's two arms. Only beyond the budget are the kinematics after the step computed.
    """

    def __init__(self, problem: ControlProblem) -> None:
        self._dt, self._second_order = problem.dt, opening(problem.chain, problem.dt)
        self._budget = np.array([problem.budget.loop_position, problem.budget.loop_orientation])
        self._chain, self._lengths = problem.chain, np.array([problem.chain.reach, 1.0])

    def shorten(self, state: State, command: Command) -> None:
        """Make the largest share of the step that leaves the loops within the budget after it."""
        if self.within(state, command.v):
            return
        share = 0.0
        for more in 0.5 ** np.arange(1, HALVINGS + 1):
            share += more if self.within(state, (share + more) * command.v) else 0.0
        share *= share >= SHORTEST
        command.v *= share
        causes = (cause for cause in command.causes if not share or cause is not Status.OPTIMAL)
        command.say(Status.STEP_SHORTENED if share else Status.LOOP_BUDGET, *causes)

    def within(self, state: State, v: Array) -> bool:
        """Whether the loops are within budget after a step v dt, or no worse than before it."""
        now = state.closed_error
        opened = self._lengths * self._second_order.dot(v * v).max(initial=0.0)
        if (2.0 * norm(now) + opened <= self._budget).all():
            return True
        then = self._chain.loop_error(state.q + self._dt * v) - state.loop_offset[: len(now)]
        # A loop that is open already may be closed by steps that leave it open for now.
        return bool((_sizes(then) <= np.maximum(_sizes(now), self._budget)).all())


def drift_gain(problem: ControlProblem, state: State, share: float = 1.0) -> float:
    """Baumgarte gain: a share of the problem's, or more as the budget is used up (if kappa = 0)."""
    slow, fast, budget = share * problem.kappa, 1.0 / problem.dt, problem.budget
    if slow >= fast:
        return slow
    sizes = _sizes(state.closed_error) / (budget.loop_position, budget.loop_orientation)
    return max(slow, min(max(2.0 * float(sizes.max(initial=0.0)) - 1.0, 0.0), 1.0) * fast)


def _sizes(error: Array) -> Array:
    """How far each loop is open, in position and in angle, shape (L, 2)."""
    return np.asarray(np.sqrt(np.square(error.reshape(-1, 2, 3)).sum(axis=2)))
