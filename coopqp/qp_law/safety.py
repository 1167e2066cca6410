"""The look at the loops after the step: no step may open one farther than the budget."""

from __future__ import annotations

import numpy as np

from coopqp.checked import Array
from coopqp.controller import Command, ControlProblem
from coopqp.solver import Status
from coopqp.state import State

SHORTEN = 0.5  # a step that opens a loop too far is halved ...
SHORTEST = 2.0**-10  # ... down to this share, and then not made


class LoopProbe:
    """Looks ahead whether a step would leave the loops within their budget.

    The equality rows take care of the first order alone.

    Args:
        problem: chain, period and budget.
    """

    def __init__(self, problem: ControlProblem) -> None:
        self._dt, self._kappa = problem.dt, problem.kappa
        self._most = np.array([problem.budget.loop_position, problem.budget.loop_orientation])
        self._after = State(problem.chain)

    def shorten(self, state: State, command: Command) -> None:
        """Halve the step until the loops stay within the budget after it."""
        share = 1.0
        while not self.within(state, command.v):
            share *= SHORTEN
            if share < SHORTEST:
                command.v[:] = 0.0
                command.say(Status.LOOP_BUDGET, *command.causes)
                return
            command.v *= SHORTEN
        if share < 1.0:
            others = (cause for cause in command.causes if cause is not Status.OPTIMAL)
            command.say(Status.STEP_SHORTENED, *others)

    def kappa(self, state: State, share: float = 1.0) -> float:
        """Gain of the drift correction: the problem's, or more where the budget is half used up.

        With the paper's kappa = 0 nothing else would ever close a loop again.

        Args:
            state: of the tick.
            share: of the problem's gain that is wanted.
        """
        slow, most = share * self._kappa, 1.0 / self._dt
        if slow >= most:
            return slow
        used = float((_sizes(state.closed_error) / self._most).max(initial=0.0))
        return max(slow, min(max(2.0 * used - 1.0, 0.0), 1.0) * most)

    def within(self, state: State, v: Array) -> bool:
        """Whether the loops are within budget after a step v dt, or no worse than before it."""
        after, closed = self._after, state.closed_error
        after.q[:] = state.q + self._dt * v
        after.update_poses()
        opened = (after.loop_error - state.gap)[: len(closed)]
        # A loop that is open already may be closed by steps that leave it open for now.
        return bool((_sizes(opened) <= np.maximum(_sizes(closed), self._most)).all())


def _sizes(error: Array) -> Array:
    """How far each loop is open, in position and in angle, shape (L, 2)."""
    return np.asarray(np.linalg.norm(error.reshape(-1, 2, 3), axis=2))
