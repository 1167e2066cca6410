"""What a tick may do at all: limits, the way back of joints outside of them, the loops' drift."""

from __future__ import annotations

from functools import cached_property

from coopqp.controller import ControlProblem
from coopqp.qp_law.bounds import Bounds
from coopqp.qp_law.recovery import Recovery
from coopqp.qp_law.safety import LoopProbe, drift_gain
from coopqp.state import State


class WayBack:
    """Limits that joints outside of them come back by.

    Args:
        problem: what to control.
        start: a state.
        error_damping: share of the damping that rules out any overshoot.

    Attributes:
        bounds: the limits. recovery: of joints outside of them.
    """

    def __init__(self, problem: ControlProblem, start: State, error_damping: float) -> None:
        self._problem = problem
        self.bounds = Bounds(problem.chain, problem.limits, start, problem.dt)
        self.recovery = Recovery(problem, start, error_damping)

    @cached_property
    def probe(self) -> LoopProbe:
        """Looks ahead at the loops; built when it is asked for."""
        return LoopProbe(self._problem)

    def limit(self, state: State) -> float:
        """Evaluate limits and the way back of joints outside of them; the drift gain it leaves."""
        kappa = drift_gain(self._problem, state)
        self.bounds.update(state)
        if self.recovery.begins(state):
            self.recovery.decide(state, self.bounds, state.e_loop, kappa)
            self.recovery.tighten(self.bounds)
            kappa = drift_gain(self._problem, state, self.recovery.share)
        return kappa
