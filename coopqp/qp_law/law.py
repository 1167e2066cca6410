"""The QP law: tasks as objectives, loop closure and limits as hard constraints.

A hierarchy of least-squares problems (Kanoun, Lamiraux and Wieber 2011; Escande, Mansard and Wieber
2014), in every level of which

    J_c v = -kappa e,   lb <= v <= ub,   G v <= h

and what the levels before it have decided stays:

    hard tasks          J_j v = rate_j - gain_j e_j
    scaled tasks        J_k v = s_k (rate_k - gain_k e_k),  0 <= s_k <= 1, s_k largest
    soft tasks          minimise  sum_i w_i |J_i v - (rate_i - gain_i e_i)|^2 + d |v|^2
    of each priority    with d = damping + c dt sum_i w_i gain_i |e_i| L_i + by what it pulls
    secondary ones      likewise

Hard and scaled tasks are one program where they are feasible, else a least-squares level each
(:mod:`coopqp.qp_law.nearest`). The damping d keeps a step from overshooting near singularities
(:class:`coopqp.qp_law.equations.Damping`); it fades as the tasks are met. Later levels move in the
null space of what is decided (:mod:`coopqp.qp_law.priorities`).

A tick, from top to bottom: assemble (``bounds``, ``level``), decide level by level, shorten
(``safety``). Joints outside their limits recover before all tasks; where limits leave no motion for
the whole Baumgarte correction it is reduced, then acceleration limits are relaxed
(``limit_recovery``); loop rows, position and velocity limits never are. v = 0 is feasible from any
state inside the limits: there is always an answer.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np

from coopqp.base.rank import null_space
from coopqp.base.spec import Array
from coopqp.controller import Command, ControlProblem, InternalForceControl, Law
from coopqp.limit import ROUNDING
from coopqp.model.state import State
from coopqp.qp_law.equations import LEAST_SPEED, MOST_DAMPING, SCALE_WEIGHT, Damping, note_chatter
from coopqp.qp_law.level import Given, Level
from coopqp.qp_law.limit_recovery import LimitRecovery
from coopqp.qp_law.nearest import ASIDE, FAST, LESS, MET, SLOW, WHOLE, Nearest, blocked, counting
from coopqp.qp_law.priorities import LaterLevel, Order
from coopqp.qp_law.safety import StepVerification, drift_gain
from coopqp.solver import Status, norm
from coopqp.task import TaskStack


class QPLaw(Law):
    """The QPs of one problem, with their arrays; c is error_damping.

    ``exact`` are the hard tasks, then the scaled ones, ``stacks`` the soft ones of each level. The
    ``first`` level has the loops, the exact and the first soft tasks, ``later`` ones the others.
    """

    engine = "python"

    def __init__(
        self,
        problem: ControlProblem,
        damping: float,
        error_damping: float,
        force_control: InternalForceControl | None = None,
        order: Order | None = None,
    ) -> None:
        super().__init__(problem, force_control=force_control)
        self.order = order = order or Order(problem)
        self._damping = Damping(damping, error_damping, problem.dt)
        self.limit_recovery = LimitRecovery(problem, order.start, self._damping)
        self._given = given = Given(problem, self.limit_recovery.bounds, self._damping)
        self.probe = StepVerification(problem)
        self.exact = exact = TaskStack([*order.hard, *order.scaled], order.start)
        self._hard, self._scaled = exact.slices[: len(order.hard)], exact.slices[len(order.hard) :]
        self._relaxes = problem.on_infeasible == "scale"
        self.stacks = stacks = [TaskStack(tasks, order.start) for tasks in order.groups]
        self.first = Level(given, stacks[0], exact.rows, [task.name for task in order.scaled])
        self.later = [
            LaterLevel(given, stacks[i], [*stacks[:i], exact]) for i in range(1, len(stacks))
        ]
        self.memory_sizes = memory_sizes(problem, len(self.stacks), force_control)
        self._hard_rows, self._shares = slice(self.memory_sizes["missed"]), self.first.shares

    @cached_property
    def nearest(self) -> Nearest:
        """Built when hard or scaled tasks cannot hold."""
        return Nearest(self._given, self.order)

    def prepare(self) -> QPLaw:
        """Build now what only rare ticks need, so that none waits for it; returns itself."""
        self.nearest, self.limit_recovery.levels  # noqa: B018 - are built by being asked for
        return self

    def decide(self, state: State) -> Command:
        """Assemble, solve, verify, level by level; the command is safe whatever happened."""
        command, limit_recovery = self.command, self.limit_recovery
        command.scale, command.drift = (0.0 if self.exact.tasks else 1.0), 1.0
        if state.memory["stopped"][0]:
            return self.refuse(Status.INFEASIBLE)
        kappa = self.assemble(state)
        v, causes = self._decide_levels(state, kappa)
        if not causes[0].usable:
            v, causes = self._with_less_drift(state, causes[0])
        if limit_recovery.active:
            v, causes = limit_recovery.rescue(v, causes)
            command.drift = min(command.drift, limit_recovery.share)
        command.v[:] = v if causes[0].usable else 0.0
        others = dict.fromkeys(cause for cause in causes if cause is not Status.OPTIMAL)
        command.say(*(others or (Status.OPTIMAL,)))
        if causes[0].usable:
            self.probe.shorten(state, command)
            note_chatter(state, command.v, self.problem.dt)
        return command

    def assemble(self, state: State) -> float:
        """Evaluate limits and tasks, and fill the first level's QP; returns the drift gain."""
        kappa = self.limit_recovery.limit(state)
        for stack in (*self.stacks, self.exact) if self.exact.tasks else self.stacks:
            stack.update(state)
        self._assemble_exact(self.first, state, kappa, self.exact.wanted)
        return kappa

    def _assemble_exact(self, level: Level, state: State, kappa: float, wanted: Array) -> None:
        """J_j v = wanted_j of hard tasks, J_k v - s_k wanted_k = 0 of scaled ones."""
        n, m = self.problem.chain.n, len(state.e_loop)
        scaled = self._scaled_damping(state) if self._scaled else 0.0
        level.assemble(state, kappa, self._damping.of_tasks(level.tasks, state) + scaled)
        A, b = level.qp.A[m:], level.qp.b[m:]
        A[:, :n], b[:] = self.exact.J, wanted
        for share, part in enumerate(self._scaled):
            A[part, n + share], b[part] = -wanted[part], 0.0

    def _scaled_damping(self, state: State) -> float:
        """For scaled tasks, whose rows have curvature by their multipliers.

        They are SCALE_WEIGHT (1 - s) / |wanted|, with s of the last tick; fewer towards rest, where
        wanted is rounding.
        """
        curvatures, wanted = self.exact.curvatures(state.v), self.exact.wanted
        rates = [(norm(curvatures[p]), norm(wanted[p]) / LEAST_SPEED) for p in self._scaled]
        sizes = [curvature * min(rate, 1.0) / (rate * rate + 1.0) for curvature, rate in rates]
        pull = SCALE_WEIGHT / LEAST_SPEED**2 * float(state.memory["missing"] @ sizes)
        return min(self._damping.of(pull, state), MOST_DAMPING)

    def _decide_levels(self, state: State, kappa: float) -> tuple[Array, tuple[Status, ...]]:
        """One after the other, each in the null space of those before it."""
        status, v = self.first.solve(), self.first.v
        v, causes = self._decide_exact(state, kappa) if self.exact.tasks else (v, (status,))
        if self.later and causes[0].usable:
            loops, pulls = null_space(state.J_loop).T, state.memory["later pulls"].reshape(-1, 1)
            for later, pull in zip(self.later, pulls, strict=True):
                v, status = later.improve(state, loops, v, pull)
                causes = (*causes, status)
        return v, causes

    def _decide_exact(self, state: State, kappa: float) -> tuple[Array, tuple[Status, ...]]:
        """Hard and scaled tasks, after the exact program."""
        status = whole = self.first.solution.status
        v, set_out, leaves, self._shares = self.first.v, self.first.v, 0.0, self.first.shares
        firm = whole.usable and not self._overreaches(self._hard_rows, v)
        holds = firm and self._holds_firmly(met=False) if self._relaxes else whole.usable
        if not holds and (self._relaxes or self._scaled):
            status, v, set_out, leaves = self._come_near(state, kappa)
            if not self._relaxes and (leaves > 0.0 or self._missed(v).any()):
                return self.first.v, (whole,)  # else shares of nothing are all there is
        if not status.usable:
            return v, (status,)
        if self._relaxes and self._scaled:
            leaves = max(leaves, self._overreaches(slice(self._hard_rows.stop, None), v))
        if self._relaxes and (leaves > 0.0 or self._shares.min(initial=1.0) < WHOLE):
            near, found = self.nearest.of_scaled(state, set_out)
            status = found if status is Status.OPTIMAL else status
            wanted, parts = self.exact.wanted, zip(self._scaled, self._shares.tolist(), strict=True)
            for p, share in () if leaves == 1.0 else parts:
                leaves = max(leaves, blocked(share, wanted[p], self.exact.J[p] @ near))
            v = (1.0 - leaves) * v + leaves * near
        self._remember(state, v, leaves)
        if not whole.usable and whole is not Status.INFEASIBLE:
            return v, (Status.SOLVER_FAILED, status)
        if leaves > 0.0 or self.command.scale < MET or state.memory["missed"].any():
            return v, (Status.TASKS_RELAXED, status)
        return v, (status,)

    def _come_near(self, state: State, kappa: float) -> tuple[Status, Array, Array, float]:
        """Decide between the exact program, which is solved, and the nearest motion.

        Returned are the outcome, v, what scaled tasks set out from, and how far they leave.
        """
        first, nearest, wanted = self.first, self.nearest, self.exact.wanted[self._hard_rows]
        whole, status, near = first.solution.status, nearest.of_hard(state, kappa), nearest.hard.v
        lacks, held, v = self._missed(near), whole, first.v
        if self._scaled:
            alone = self._hard and norm(lacks) < SLOW
            held, v = (nearest.hold(state, kappa), nearest.held.v) if alone else (status, near)
        counts = nearest.counts(v) if held.usable else 1.0
        if counts > 0.0 and status.usable:
            status = nearest.damp(state, kappa, counts * np.abs(lacks))
        v = near.copy() if counts == 1.0 else (1.0 - counts) * v + counts * near
        softens = self._overreaches(self._hard_rows, v)
        firm = counts == softens == 0.0 and self._holds_firmly(met=True)
        if whole.usable and (firm or not status.usable):
            return whole, first.v, first.v, 0.0
        if softens > 0.0 and status.usable:
            status = nearest.damp(state, kappa, counts * np.abs(lacks) + softens * np.abs(wanted))
            v = (1.0 - softens) * v + softens * near
        if not (status.usable and self._scaled):
            return status, v, v, 0.0
        leaves = min(norm(self._missed(v)) / SLOW, 1.0)
        scaled_v, share = self._largest_shares(state, kappa, v) if leaves < 1.0 else (v, 1.0)
        return status, scaled_v, scaled_v + leaves * (v - scaled_v), max(leaves, share)

    def _overreaches(self, rows: slice, v: Array) -> float:
        exact = self.exact
        return self._damping.overreaches(exact.curvature_bounds[rows], exact.J[rows] @ v, v)

    def _holds_firmly(self, *, met: bool) -> bool:
        """Whether the exact program answers as the levels of least squares would.

        So it is where no multipliers of its rows are so large that v_h would lack something of hard
        tasks, unless these are ``met``, nor so large that the penalty of t would not be exact. Rows
        beside shares that hold by the solver's tolerance alone do not.
        """
        solution, weights = self.first.solution, self.exact.weights[self._hard_rows]
        y = solution.y[-len(self.exact.wanted) :]
        lacking = solution.primal_residual > ROUNDING or norm(y) * FAST > ASIDE * SCALE_WEIGHT
        if self._scaled and lacking:
            return False
        if met or not self._hard:
            return True
        share = LESS * float(weights.max()) * self._damping.base / self.first.curvature
        lacks = share * norm(y[self._hard_rows] / np.sqrt(weights))
        return lacks <= MET * float(np.sqrt(weights.min()))

    def _largest_shares(self, state: State, kappa: float, v: Array) -> tuple[Array, float]:
        """The largest shares beside the motion v of hard tasks; how far these may be left."""
        level, wanted, got = self.nearest.scaling, self.exact.wanted.copy(), self.exact.J @ v
        hard, self._shares = self._hard_rows, level.shares[:-1]
        wanted[hard] = got[hard]
        aside = got * (SLOW / min(max(norm(got[hard.stop :]), MET), SLOW))
        aside[hard] = 0.0
        if not np.isfinite(got).all():
            return v, 1.0
        level.qp.A[:] = 0.0
        self._assemble_exact(level, state, kappa, wanted)
        level.qp.A[len(state.e_loop) :, -1] = -aside
        level.qp.orthogonalize()
        return (level.v, level.shares[-1]) if level.solve().usable else (v, 1.0)

    def _missed(self, v: Array) -> Array:
        """What rows of hard tasks lack, zero where that is rounding."""
        missed: Array = (self.exact.J @ v - self.exact.wanted)[self._hard_rows]
        return missed * counting(missed)

    def _remember(self, state: State, v: Array, leaves: float) -> None:
        """What hard and scaled tasks lack, for the damping of the next tick; the scale of this."""
        wanted, missed, missing = self.exact.wanted, state.memory["missed"], state.memory["missing"]
        missed[:] = self._missed(v)
        missing[:] = 1.0 if leaves == 1.0 else 1.0 - (1.0 - leaves) * self._shares
        sizes = [(norm(missed[p]), norm(wanted[p])) for p in self._hard]
        for p in self._scaled if leaves > 0.0 else ():
            sizes.append((norm(self.exact.J[p] @ v - wanted[p]), norm(wanted[p])))
        lacks = [lack / max(whole, lack, MET) for lack, whole in sizes]
        shares = missing.tolist() if leaves == 0.0 else ()
        self.command.scale = 1.0 - max([0.0, *lacks, *shares])

    def _with_less_drift(self, state: State, failed: Status) -> tuple[Array, tuple[Status, ...]]:
        """The levels with as much of the Baumgarte stabilisation as can be done."""
        if not self._relaxes:
            state.memory["stopped"][0] = self.problem.on_infeasible == "stop"
            return self.first.v, (failed,)
        self.command.drift, slowed, relaxed = self.limit_recovery.reduce(state)
        if not relaxed:
            return slowed, (failed,)
        kappa = self.command.drift * drift_gain(self.problem, state)
        self._assemble_exact(self.first, state, kappa, self.exact.wanted)
        v, causes = self._decide_levels(state, kappa)
        if not causes[0].usable:
            if relaxed[0] is Status.SOLVER_FAILED:  # nothing was in the way but the solver
                return v, (failed,)
            v, causes = slowed, ()
        if failed is not Status.INFEASIBLE:
            relaxed = (Status.SOLVER_FAILED,)
        return v, (*relaxed, *causes)


def memory_sizes(
    problem: ControlProblem, levels: int, force_control: InternalForceControl | None = None
) -> dict[str, int]:
    """What the law remembers of the last tick, and in how many numbers.

    "stopped" is 1 after a stop; "recovery" the loops' multipliers in limit recovery; "missed" what
    rows of hard tasks lacked, zero where that is rounding; "missing" what the share of each scaled
    task lacked to 1; "scaled pull" and "later pulls" those of :meth:`LaterLevel.improve`; "chatter"
    as :func:`coopqp.qp_law.equations.note_chatter` keeps it; others are of internal force control.
    """
    scaled = sum(task.mode == "scaled" for task in problem.tasks)
    hard = sum(len(task.rows(problem.chain)) for task in problem.tasks if task.mode == "hard")
    return {
        "stopped": 1, "recovery": 1, "missed": hard, "missing": scaled,
        "scaled pull": min(scaled, 1), "later pulls": levels - 1,
        **(force_control.memory_sizes if force_control else {}), "chatter": 1 + problem.chain.n,
    }  # fmt: skip
