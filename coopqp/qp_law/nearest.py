"""Hard and scaled tasks that limits and loops make infeasible.

They are levels of least squares (:class:`coopqp.qp_law.level.Level`) above all soft ones, first of
hard tasks, with the answer v_h. Its damping d is next to nothing first, and then grows with what
the rows lack, m_i: d = c dt sum_i w_i |m_i| L_i. So v_h lacks something near a singularity where
hard tasks can hold, too, exactly, by v_e. Their motion is (1 - c) v_e + c v_h: c is 1 where they
cannot hold, else 0 up to MET of each row, or where v_e is not within NEAR of a limit and v_h lacks
less than half of SLOW. v_e and v_h meet where v_e ceases to exist. As far as a tick of it
overreaches (:meth:`coopqp.qp_law.equations.Damping.overreaches`) v_h with the damping of a soft
task replaces it. With J_i v of it fixed scaled tasks have the largest shares s_k in v_s, beside the
least part t of that motion, by an exact penalty; v_n is the nearest to all they want:

    J_k v_s = s_k wanted_k + t a_k,   at the cost W (t^2 / 2 + ASIDE t) more
    v = (1 - r) v_s + r v_n,   r = max_k (1 - s_k |wanted_k| / (LITTLE p_k))+ (1 - s_k / WHOLE)+

a is what that motion does of all scaled tasks, made as long as SLOW where it is shorter: next to no
motion takes neither t = 1 nor multipliers that cost the answer digits. p_k is what v_n has along a
direction, LEAST_SPEED at least; r is at least t, what hard tasks lack over SLOW, up to 1, and how
far v_s overreaches. v_n, damped as a soft task, sets out from v_s, or from the motion of the hard
tasks as far as these are slow. Later levels keep v.
"""

from dataclasses import replace

import numpy as np

from coopqp.base.rank import null_space
from coopqp.base.spec import Array
from coopqp.model.state import State
from coopqp.qp_law.equations import LEAST_SPEED, SCALE_WEIGHT
from coopqp.qp_law.level import Given, Level, Step
from coopqp.qp_law.priorities import IDLE, LaterLevel, Order
from coopqp.solver import Status, norm
from coopqp.task import TaskStack

#: A scaled task with less than this share may leave its direction, if along it there is less than
WHOLE = 0.5
#: this share of what the nearest motion has of it.
LITTLE = 0.1
#: Speed that hard tasks lack from which on scaled ones leave their direction [m/s, rad/s].
SLOW = 5e-3
#: What |a| is taken to be at most [m/s, rad/s]: multipliers up to ASIDE W / FAST leave t at 0.
FAST = 1.0
#: Least damping of the level of the hard tasks for their largest weight, as a share of the others'.
LESS = 1e-3
#: Rows that lack less than this are met, from twice it on they are not [m/s, rad/s].
MET = 1e-6
#: Speed from a limit from which on exact motions stand, whatever v_h lacks [m/s, rad/s].
NEAR = 0.1
#: Slope of the cost of t, above the multipliers that it may have, over W.
ASIDE = 1e3


class Nearest:
    """Levels of hard and scaled tasks; that of v_s is ``scaling``, its last share t."""

    def __init__(self, given: Given, order: Order) -> None:
        self._damping, self._bounds = given.damping, given.bounds
        hard, scaled, none = (TaskStack(t, order.start) for t in (order.hard, order.scaled, ()))
        base = given.damping.base * (LESS * float(hard.weights.max()) if order.hard else 1.0)
        firm = replace(given, damping=replace(given.damping, base=base))
        self.hard, self._refined = Level(firm, hard), Step(firm, hard)
        self.held = Level(given, none, hard.rows)
        self.scaled = LaterLevel(given, scaled, [hard])
        names = [*(task.name for task in order.scaled), "hard tasks"]
        self.scaling = Level(given, none, [*hard.rows, *scaled.rows], names)
        self.scaling.qp.q[-1] = ASIDE * SCALE_WEIGHT

    def of_hard(self, state: State, kappa: float) -> Status:
        """Solve it, by a step from the answer with more damping, which has all its digits."""
        self.hard.tasks.update(state)
        self.hard.assemble(state, kappa, self._damping.base)
        status = self.hard.solve()
        return self.damp(state, kappa, np.zeros(1)) if status.usable else status

    def damp(self, state: State, kappa: float, pulls: Array) -> Status:
        """Solve it anew, with the damping of rows that lack, or want, so much."""
        level, tasks = self.hard, self.hard.tasks
        d = self._damping.of(float(tasks.weights @ (pulls * tasks.curvature_bounds)), state)
        level.assemble(state, kappa, d)
        status = self._refined.step(level.v, null_space(state.J_loop).T, level.curvature)
        level.v[:] = self._refined.v
        return status

    def hold(self, state: State, kappa: float) -> Status:
        """Hold hard tasks as they are, without the scaled ones."""
        level, m = self.held, len(state.e_loop)
        level.assemble(state, kappa)
        level.qp.A[m:], level.qp.b[m:] = self.hard.tasks.J, self.hard.tasks.wanted
        return level.solve()

    def counts(self, v: Array) -> float:
        """How much v_h counts beside the exact motion v of the hard tasks alone."""
        missed, bounds = self.hard.tasks.J @ self.hard.v - self.hard.tasks.wanted, self._bounds
        slack = np.concatenate([bounds.ub, bounds.h, -bounds.lb]) - bounds.C.dot(v)
        sizes = np.maximum(np.linalg.norm(bounds.C, axis=1), IDLE)
        limited = 1.0 - float((slack / sizes).min(initial=NEAR)) / NEAR
        return counting(missed) * min(max(limited, 2.0 * norm(missed) / SLOW - 1.0, 0.0), 1.0)

    def of_scaled(self, state: State, v: Array) -> tuple[Array, Status]:
        """What the level of the scaled tasks makes of v, in what hard tasks leave free."""
        for stack in (self.hard.tasks, self.scaled.tasks):
            stack.update(state)
        loops = null_space(state.J_loop).T
        return self.scaled.improve(state, loops, v, state.memory["scaled pull"])


def counting(missed: Array) -> float:
    """How much counts of what rows of hard tasks lack."""
    return min(max(float(np.abs(missed).max(initial=0.0)) / MET - 1.0, 0.0), 1.0)


def blocked(share: float, wanted: Array, near: Array) -> float:
    """How far a task with a share of what is wanted may leave that direction for the nearest, r."""
    size = norm(wanted)
    along = max(float(wanted @ near), LEAST_SPEED * size, 1e-300)  # times size
    return max(1.0 - share * size * size / (LITTLE * along), 0.0) * max(1.0 - share / WHOLE, 0.0)
