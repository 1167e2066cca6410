"""Limits, and the QPs without tasks: limit recovery, and the reduced Baumgarte correction.

Joints that start outside recover before all tasks, by a QP of their own:

    minimise    sum over joints outside of (v_j - wish_j)^2  +  least |v|^2
    subject to  J_c v = -s kappa e,  lb <= v <= ub,  G v <= h

with s = 1, all of the Baumgarte correction. Where that is infeasible, or costs more than
W (1 - s)^2/2 (at s = 1 less of it would save y'kappa e, with the loops' multipliers y), s is from 0
to 1 and the largest that is worth it. The answer bounds the tasks, hard ones included: each joint
outside recovers at least almost as fast.

Where limits leave no motion for all of the correction, the largest share s is found, with W (1 -
s)^2 + d |v|^2 as the cost: with all limits, else without acceleration limits and with limits in
space that ask for no motion. The share replaces 1 in all levels of the tick.
"""

from dataclasses import replace
from functools import cached_property

import numpy as np

from coopqp.base.spec import Array
from coopqp.controller import ControlProblem
from coopqp.limit import ROUNDING
from coopqp.model.state import State
from coopqp.qp_law.bounds import Bounds
from coopqp.qp_law.equations import ALL_OF_IT, SCALE_WEIGHT, Damping
from coopqp.qp_law.level import Given, Level
from coopqp.qp_law.safety import drift_gain
from coopqp.solver import Status
from coopqp.task import TaskStack

#: Least speed of recovery [rad/s, m/s]: one that goes to zero at the limit never gets there.
LEAST_RECOVERY = 0.02
#: Cost of |v|^2, which only chooses among recoveries that are as fast.
LEAST_MOTION = 1e-4
#: Share of the fastest recovery that the tasks must keep; a little less, to stay feasible.
KEPT = 0.995
#: What of the largest share is done, so that the tick's levels have an answer to the last digit.
INSIDE = 1.0 - 1e-4


class LimitRecovery:
    """The limits of a tick, and how joints outside of them recover; the reduced correction.

    Attributes:
        bounds: the limits of the last tick, recovery included. active: whether a joint was outside.
        share: of the Baumgarte correction beside the recovery. v: of the recovery, if any.
    """

    def __init__(self, problem: ControlProblem, start: State, damping: Damping) -> None:
        self.bounds = Bounds(problem.limits, start, problem.dt)
        self._problem, self._nothing, self._damping = problem, TaskStack((), start), damping
        self.active, self.share = False, 1.0
        self.v: Array | None = None

    @cached_property
    def levels(self) -> tuple[Level, Level, Level]:
        """Of the recovery, with all of the Baumgarte correction and a share; of a share alone."""
        given = Given(self._problem, self.bounds, self._damping)
        back = replace(given, damping=replace(self._damping, base=LEAST_MOTION))
        whole, slowed = Level(back, self._nothing), Level(back, self._nothing, slows=True)
        return whole, slowed, Level(given, self._nothing, slows=True)

    def limit(self, state: State) -> float:
        """Evaluate limits and the recovery of joints outside; the drift gain it leaves."""
        chain = self._problem.chain  # back is from each joint to its limits, zero inside
        self._back = np.minimum(np.maximum(state.q, chain.lower), chain.upper) - state.q
        self._back *= np.abs(self._back) > ROUNDING
        self.active, self.share, self.v = bool(self._back.any()), 1.0, None
        self.bounds.update(state)
        if self.active:
            self._find(state)
            self._tighten()
        return drift_gain(self._problem, state, self.share)

    def _find(self, state: State) -> None:
        """The fastest recovery of the joints that are outside."""
        back, outside = self._back, self._back != 0.0
        wish = np.sign(back) * np.maximum(np.abs(back) / self._problem.dt, LEAST_RECOVERY)
        wish = np.clip(wish, self.bounds.lb, self.bounds.ub)
        kappa, pull, n = drift_gain(self._problem, state), state.memory["recovery"], len(wish)
        # Where loops leave hardly a way back they turn quickly along it: the more it pulls at them,
        # the shorter its steps.
        extra = self._damping.of(state.chain.reach * pull[0], state)
        extra += self._damping.of_drift(state, kappa)
        pull[0] = 0.0
        whole, slowed, _ = self.levels
        # What was done in part stays so, or it would go to and fro between all and a part.
        for level in (whole, slowed) if state.corrected >= ALL_OF_IT else (slowed,):
            level.assemble(state, kappa, extra)
            level.qp.P[:n, :n] += np.diag(outside)
            level.qp.q[:n] = -wish * outside
            usable, y = level.solve().usable, level.solution.y
            worth_it = kappa * y.dot(state.e_loop) <= (1.0 - ALL_OF_IT) * SCALE_WEIGHT
            if usable and (worth_it or level is slowed):
                self.v, self.share = level.v.copy(), float(level.shares.min(initial=1.0))
                pull[0] = np.abs(y).sum()
                return

    def _tighten(self) -> None:
        """Bound v so that the recovery is kept."""
        if self.v is not None:
            keep, lb, ub = KEPT * self.v, self.bounds.lb, self.bounds.ub
            np.maximum(lb, np.maximum(keep, 0.0), out=lb, where=self._back > 0.0)
            np.minimum(ub, np.minimum(keep, 0.0), out=ub, where=self._back < 0.0)

    def rescue(self, v: Array, causes: tuple[Status, ...]) -> tuple[Array, tuple[Status, ...]]:
        """The tick's answer, or the recovery itself where there is none."""
        if causes[0] in (Status.OPTIMAL, Status.INACCURATE):
            return v, (Status.RECOVERING, *causes)
        if not causes[0].usable and self.v is not None:
            return self.v, (Status.RECOVERING, *causes)
        return v, (*causes, Status.RECOVERING)

    def reduce(self, state: State) -> tuple[float, Array, tuple[Status, ...]]:
        """The largest share of the Baumgarte correction, v that does it, and what is relaxed.

        The limits are then as they were when it was found. Nothing is relaxed if there is none.
        """
        level, causes, kappa = self.levels[2], list[Status](), drift_gain(self._problem, state)
        level.assemble(state, kappa, self._damping.of_drift(state, kappa))
        if not level.solve().usable:
            causes += [Status.ACCELERATION_GIVEN_UP] * self.bounds.release(state)
            self._tighten()
            level.assemble(state, kappa, self._damping.of_drift(state, kappa))
            if not level.solve().usable:
                return 0.0, level.v, ()
        share = float(level.shares[0])
        if share < ALL_OF_IT:
            share *= INSIDE
            causes.append(Status.DRIFT_SLOWED)
        return share, level.v, tuple(causes) or (Status.SOLVER_FAILED,)
