"""The way back for joints that start outside their limits, before all tasks.

It has a QP of its own, with nothing else to want than to be inside again:

    minimise    sum over joints outside of (v_j - wish_j)^2  +  least |v|^2
    subject to  J_c v = -s kappa e,  lb <= v <= ub,  G v <= h,  0 <= s <= 1, s largest

What it finds becomes a bound for the tasks, hard ones included: each joint that is outside comes
back at least almost as fast.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np

from coopqp.checked import Array
from coopqp.controller import ControlProblem
from coopqp.limit import ROUNDING
from coopqp.qp_law.bounds import Bounds
from coopqp.qp_law.equations import add_damping, drift_damping, slowed_loop_rows, step_damping
from coopqp.qp_law.level import Level
from coopqp.solver import Status
from coopqp.state import State
from coopqp.task import TaskStack

#: Slowest wish to come back [rad/s, m/s]: one that goes to zero at the limit never gets there.
LEAST_RECOVERY = 0.02
#: Cost of |v|^2, which only chooses among ways back that are as fast.
LEAST_MOTION = 1e-4
#: What of the fastest way back the tasks must leave; a little room, so that they stay feasible.
KEPT = 0.995


class Recovery:
    """Decides how fast joints come back.

    Args:
        problem: what to control.
        start: a state.
        error_damping: share of the damping that rules out any overshoot.

    Attributes:
        active: whether a joint was outside in the last tick.
        share: of the drift correction that the way back leaves room for, in the last tick.
        v: the way back, when there was one in the last tick.
    """

    def __init__(self, problem: ControlProblem, start: State, error_damping: float) -> None:
        chain = problem.chain
        self._reach, self._dt, self._share = chain.reach, problem.dt, error_damping
        self._lower, self._upper = chain.lower, chain.upper
        self._problem, self._start = problem, start
        self._low, self._high = np.zeros((2, chain.n), bool)
        self.active, self.share = False, 1.0
        self.v: Array | None = None

    @cached_property
    def level(self) -> Level:
        """Its QP; built when it is asked for."""
        problem, start = self._problem, self._start
        bounds = Bounds(problem.chain, problem.limits, start, problem.dt)
        rows = problem.chain.loops.solver_rows
        return Level(
            problem, TaskStack((), start), rows, bounds, LEAST_MOTION, shares=["drift correction"]
        )

    def begins(self, state: State) -> bool:
        """Whether a joint is outside, of the start or of a real robot that stands elsewhere."""
        self._low = state.q < self._lower - ROUNDING
        self._high = state.q > self._upper + ROUNDING
        self.active = bool((self._low | self._high).any())
        self.v, self.share = None, 1.0
        return self.active

    def decide(self, state: State, bounds: Bounds, drift: Array, kappa: float) -> None:
        """Find the fastest way back for what is outside.

        Args:
            state: with the joints.
            bounds: the limits at the state.
            drift: what the loops must lose, shape (m,).
            kappa: gain of the drift correction [1/s].
        """
        outside = self._low | self._high
        back = np.maximum(self._lower - state.q, 0.0) - np.maximum(state.q - self._upper, 0.0)
        wish = np.sign(back) * np.maximum(np.abs(back) / self._dt, LEAST_RECOVERY)
        wish = np.clip(wish, bounds.lb, bounds.ub)
        level = self.level
        # Where loops leave hardly a way back they turn quickly along it: the more it pulls at them,
        # the shorter its steps.
        pull = state.memory["recovery"]
        extra = step_damping(self._reach * pull[0], self._dt, self._share)
        extra += drift_damping(drift, kappa, self._dt, self._reach, state.corrected)
        level.assemble(bounds, extra)
        add_damping(level.P, outside.astype(float))
        np.multiply(wish, -1.0 * outside, out=level.q)
        slowed_loop_rows(state.J_loop, drift, kappa, level.qp.A, level.b)
        pull[0] = 0.0
        if level.solve().usable:
            self.v, self.share = level.v.copy(), level.scale
            pull[0] = np.abs(level.solution.y).sum()

    def tighten(self, bounds: Bounds) -> None:
        """Let nobody take the way back away."""
        if self.v is None:
            return
        low, high = self._low, self._high
        np.maximum(bounds.lb, np.maximum(KEPT * self.v, 0.0), out=bounds.lb, where=low)
        np.minimum(bounds.ub, np.minimum(KEPT * self.v, 0.0), out=bounds.ub, where=high)

    def rescue(self, v: Array, causes: tuple[Status, ...]) -> tuple[Array, tuple[Status, ...]]:
        """The tick's answer, or the way back itself where nothing else has one."""
        if causes[0] in (Status.OPTIMAL, Status.INACCURATE):
            return v, (Status.RECOVERING, *(c for c in causes if c is not Status.OPTIMAL))
        if not causes[0].usable and self.v is not None:
            return self.v, (Status.RECOVERING, *causes)
        return v, (*causes, Status.RECOVERING)
