"""The look at the loops after the step: no step may open one farther than the budget."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from coopqp.checked import Array
from coopqp.controller import Command, ControlProblem
from coopqp.limit import opening
from coopqp.solver import Status
from coopqp.state import State

SHORTEN = 0.5  # a step that opens a loop too far is halved ...
SHORTEST = 2.0**-10  # ... down to this share, and then not made


class LoopProbe:
    """Looks ahead whether a step would leave the loops within their budget.

    The equality rows take care of the first order: an error e becomes 2 |e| at most. The second is
    bounded: for an arm of k revolute joints with reach rho, |p''| <= rho (sum |v_j|)^2 <= rho k
    sum v_j^2, and likewise for the angle with rho = 1, so that a step opens the loop of arms i and
    0 by rho dt^2 / 2 (k_i sum_i v_j^2 + k_0 sum_0 v_j^2) at most. Where that is within the budget,
    as in most ticks, nothing is computed.

    Args:
        problem: chain, period and budget.
    """

    def __init__(self, problem: ControlProblem) -> None:
        chain, budget = problem.chain, problem.budget
        self._model, self._data = chain.model, chain.model.createData()
        self._frames = frames = chain.frames[: chain.holding]
        self._dt = problem.dt
        self._gap, self._turn = budget.loop_position, budget.loop_orientation
        pin.framesForwardKinematics(self._model, self._data, chain.q_start)
        X_0, *others = (self._data.oMf[frame] for frame in frames)
        self._p_0, self._R_0T = X_0.translation, X_0.rotation.T
        self._others = [(X.translation, X.rotation) for X in others]
        self._second_order = opening(chain, problem.dt)
        self._reach = chain.reach

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
            command.say(Status.STEP_SHORTENED, *_not_ordinary(command.causes))

    def within(self, state: State, v: Array) -> bool:
        """Whether the loops are within budget after a step v dt, or no worse than before it."""
        if not self._others:  # one arm alone closes no loop
            return True
        error = 2.0 * float(np.linalg.norm(state.closed_error))
        opened = float((self._second_order @ np.square(v)).max())
        fits = error + self._reach * opened <= self._gap and error + opened <= self._turn
        return fits or self._look(state, v)

    def _look(self, state: State, v: Array) -> bool:
        pin.forwardKinematics(self._model, self._data, state.q + self._dt * v)
        for frame in self._frames:
            pin.updateFramePlacement(self._model, self._data, frame)
        # A loop that is open already may be closed by steps that leave it open for now.
        most = np.maximum(_sizes(state.closed_error), (self._gap, self._turn))
        return bool((self._opened(state) <= most).all())

    def _opened(self, state: State) -> Array:
        """How far each loop is open after the step, beyond the model's own gap, shape (L, 2)."""
        after = []
        for (p, R), gap in zip(self._others, state.gap.reshape(-1, 2, 3), strict=False):
            turn = pin.log3(R.dot(self._R_0T)) - gap[1]
            after.append((np.linalg.norm(p - self._p_0 - gap[0]), np.linalg.norm(turn)))
        return np.array(after)


def drift_gain(problem: ControlProblem, state: State, share: float = 1.0) -> float:
    """Gain of the drift correction: the problem's, or more where the budget is half used up.

    With the paper's kappa = 0 nothing else would ever close a loop again.

    Args:
        problem: what is controlled.
        state: of the tick.
        share: of the problem's gain that is wanted.
    """
    slow, most = share * problem.kappa, 1.0 / problem.dt
    if slow >= most or not len(state.closed_error):
        return slow
    budget = problem.budget
    sizes = _sizes(state.closed_error) / (budget.loop_position, budget.loop_orientation)
    return float(max(slow, min(max(2.0 * float(sizes.max()) - 1.0, 0.0), 1.0) * most))


def _sizes(error: Array) -> Array:
    """How far each loop is open, in position and in angle, shape (L, 2)."""
    return np.asarray(np.linalg.norm(error.reshape(-1, 2, 3), axis=2))


def _not_ordinary(causes: tuple[Status, ...]) -> tuple[Status, ...]:
    return tuple(cause for cause in causes if cause is not Status.OPTIMAL)
