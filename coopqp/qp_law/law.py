"""The QP law: tasks as objectives, loop closure and limits as hard constraints.

    minimise    sum_i w_i |J_i v - (rate_i - gain_i e_i)|^2 + d |v|^2            soft tasks
    subject to  J_c v = -kappa e,   lb <= v <= ub,   G v <= h                    always
                J_j v = rate_j - gain_j e_j                                      hard tasks
                J_k v = s_k (rate_k - gain_k e_k),  0 <= s_k <= 1, s_k largest   scaled tasks

with d = damping + c dt (sum_i w_i gain_i |e_i| L_i + curvature of the rows that must hold), in
every level from its own tasks: what a step needs that it does not overshoot where the arms are
stretched (:func:`coopqp.qp_law.equations.step_damping`). It fades as the tasks are met.

Soft tasks of a later priority, and the secondary objectives after them all, are solved in what the
earlier ones leave free (:mod:`coopqp.qp_law.priorities`).

A tick, from top to bottom: assemble, solve, improve (the later levels), shorten.

Joints that start outside their limits come back first, before all tasks
(:mod:`coopqp.qp_law.recovery`).

When not everything can hold, this is given up, in this order, and said: hard and scaled tasks
become soft, for a moment; the drift correction is done in part; acceleration limits go. Never the
loop rows, never position and velocity limits. Standing still is feasible from any state inside the
limits, so there is always an answer.
"""

from __future__ import annotations

import math
from functools import cached_property

import numpy as np

from coopqp.checked import Array
from coopqp.controller import Command, ControlProblem, Law
from coopqp.qp import QP
from coopqp.qp_law.equations import LEAST_SPEED, SCALE_WEIGHT, loop_rows, step_damping
from coopqp.qp_law.exact_tasks import ExactTasks
from coopqp.qp_law.fallback import Fallback
from coopqp.qp_law.level import Level
from coopqp.qp_law.priorities import LaterLevel, deciding
from coopqp.qp_law.way_back import WayBack
from coopqp.solver import Solution, Status
from coopqp.squeezer import Squeezer
from coopqp.state import State
from coopqp.task import TaskStack

ERROR_DAMPING = 0.5  # default share of the damping that rules out any overshoot
SOFT_FOR = 0.2  # hard tasks that were given up stay soft for this long [s]
MOST_HARD_DAMPING = 1.0  # that the multipliers of hard tasks may ask for
MOST_DAMPING = 1e4  # that scaled tasks and decided rows may; beyond it solvers see a wall


class QPLaw(Law):
    """The QPs of one problem, with their arrays.

    Args:
        problem: what to control.
        damping: cost of |v|^2.
        error_damping: c, share of the damping that rules out any overshoot.
        squeezer: who presses by measured forces, if anybody does.

    Attributes:
        first: the level that holds the loops, the hard and scaled and the first soft tasks.
        levels: all of them.
        stacks: the soft tasks of each level. exact: the hard and scaled tasks.
        way_back: the limits, and of joints outside of them. bounds, recovery, probe: its parts.
        memory_sizes: "stopped" is 1 after a stop; "soft" for how many more ticks hard tasks stay
            soft; "recovery" what the way back pulled at the loops in the last tick; "pull" the sum
            of the hard rows' multipliers; "missing" what the share of each scaled task lacked to 1;
            "later pulls" what each later level pulled at the rows decided before it,
            :attr:`LaterLevel.pull`; and what the squeezer needs.
    """

    engine = "python"

    def __init__(
        self,
        problem: ControlProblem,
        damping: float,
        error_damping: float = ERROR_DAMPING,
        squeezer: Squeezer | None = None,
    ) -> None:
        super().__init__(problem, squeezer=squeezer)
        chain, start = problem.chain, State(problem.chain)
        self._error_damping, self._reach = error_damping, chain.reach
        self.way_back = way_back = WayBack(problem, start, error_damping)
        self.bounds, self.recovery, self.probe = (
            way_back.bounds, way_back.recovery, way_back.probe
        )  # fmt: skip
        self.exact = exact = ExactTasks(problem, start)
        self.stacks = stacks = [TaskStack(group, start) for group in deciding(problem, start)]
        rows = (*chain.loops.solver_rows, *exact.rows)
        self.first = Level(problem, stacks[0], rows, self.bounds, damping, exact.scaled_names)
        self._later = [
            LaterLevel(problem, stacks[:i], exact, stack, self.bounds, damping)
            for i, stack in enumerate(stacks[1:], 1)
        ]
        self.memory_sizes = memory_sizes(problem, len(stacks), squeezer)
        self.levels = (self.first, *(later.level for later in self._later))
        self._start, self._damping = start, damping
        self._has_exact, self._scales = bool(exact.rows), bool(exact.scaled_names)
        self._stops = problem.on_infeasible == "stop"
        self._soft_ticks = soft_ticks(problem)

    @cached_property
    def fallback(self) -> Fallback:
        """For ticks in which not everything can hold; built when it is asked for."""
        return Fallback(self.problem, self._start, self._damping, self._error_damping)

    def prepare(self) -> QPLaw:
        """Build now what only rare ticks need, so that none waits for it; returns itself."""
        _ = self.fallback, self.recovery.level
        return self

    @property
    def qp(self) -> QP:
        """The first level's program of the last tick."""
        return self.first.qp

    @property
    def solution(self) -> Solution:
        """Its answer."""
        return self.first.solution

    def decide(self, state: State) -> Command:
        """Assemble, solve, verify, level by level; the command is safe whatever happened."""
        if self._stops and state.memory["stopped"][0]:
            return self._stand_still(Status.INFEASIBLE)
        self.assemble(state)
        status = self._solve_first(state)
        command = self.command
        command.scale = command.drift = 1.0
        if status.usable:
            v, causes = self._improve(state, status)
            command.scale = self.first.scale if self._scales else 1.0
        elif self.problem.on_infeasible == "scale":
            v, causes = self._give_up(state, status)
        else:
            v, causes = self.first.v, (status,)
            if self._stops:
                state.memory["stopped"][0] = 1.0
        if self.recovery.active:
            v, causes = self.recovery.rescue(v, causes)
            command.drift = min(command.drift, self.recovery.share)
        if not causes[0].usable:
            return self._stand_still(*causes)
        command.v[:] = v
        command.say(*causes)
        self.probe.shorten(state, command)
        return command

    def assemble(self, state: State) -> None:
        """Evaluate limits and tasks, and fill the first level's QP."""
        first, m, kappa = self.first, len(state.e_loop), self.way_back.limit(state)
        for stack in self.stacks:
            stack.update(state)
        extra = self._step_damping(first.tasks, state)
        if self._has_exact:
            self.exact.update(state)
            self.exact.fill(first.qp.A[m:], first.b[m:])
            extra += self._exact_damping(state)
        first.assemble(self.bounds, extra)
        loop_rows(state.J_loop, state.e_loop, kappa, first.A[:m], first.b[:m])

    def _step_damping(self, tasks: TaskStack, state: State) -> float:
        return step_damping(tasks.bend(state.v), self.problem.dt, self._error_damping)

    def _exact_damping(self, state: State) -> float:
        """The same for hard rows, which bend by their multipliers, and for scaled ones.

        The multiplier of a scaled task is SCALE_WEIGHT (1 - s) / |wanted|, with s of the last tick.
        """
        share, scaled = self._error_damping * self.problem.dt, self.exact.scaled
        if not self._scales:
            hard: float = share * self._reach * state.memory["pull"][0]
            return min(hard, MOST_HARD_DAMPING)
        asked, pull = scaled.bends(state.v), 0.0
        for part, missing in zip(scaled.slices, state.memory["missing"].tolist(), strict=True):
            wanted = float(scaled.wanted[part].dot(scaled.wanted[part])) + LEAST_SPEED**2
            pull += missing * math.sqrt(asked[part].dot(asked[part])) / wanted
        return min(share * SCALE_WEIGHT * pull, MOST_DAMPING)

    def _solve_first(self, state: State) -> Status:
        """The first level's answer, unless its hard tasks were given up a moment ago."""
        if not self._has_exact:
            return self.first.solve()
        soft, m = state.memory["soft"], len(state.e_loop)
        if soft[0] > 0.0:
            soft[0] -= 1.0
            return Status.INFEASIBLE
        status = self.first.solve()
        if status is Status.INFEASIBLE and self.problem.on_infeasible == "scale":
            soft[0] = self._soft_ticks
        pull, shares = self.first.solution.y[m:], self.first.solution.v[self.problem.chain.n :]
        state.memory["pull"][0] = np.abs(pull).sum() if status.usable else 0.0
        state.memory["missing"][:] = 1.0 - np.clip(shares, 0.0, 1.0) if status.usable else 0.0
        return status

    def _improve(self, state: State, status: Status) -> tuple[Array, tuple[Status, ...]]:
        """What the later levels make of the first one's answer."""
        v, pulls = self.first.v, state.memory["later pulls"]
        for i, later in enumerate(self._later):
            pull = step_damping(pulls[i], self.problem.dt, self._error_damping)
            extra = self._step_damping(later.level.tasks, state) + min(pull, MOST_DAMPING)
            status, v = later.improve(state, self.bounds, v, status, extra)
            pulls[i] = later.pull
        return v, (status,)

    def _give_up(self, state: State, failed: Status) -> tuple[Array, tuple[Status, ...]]:
        """The answer of a smaller problem."""
        kappa = self.probe.kappa(state)
        outcome = self.fallback.solve(state, state.e_loop, kappa, failed, self.recovery)
        self.command.scale = 0.0 if self._scales else 1.0
        self.command.drift = outcome.drift
        return outcome.v, outcome.causes

    def _stand_still(self, *causes: Status) -> Command:
        command = self.command
        command.v[:] = 0.0
        command.say(*causes)
        command.scale = 0.0 if self._scales else 1.0
        return command


def memory_sizes(
    problem: ControlProblem, levels: int, squeezer: Squeezer | None = None
) -> dict[str, int]:
    """What the law remembers between ticks, :attr:`QPLaw.memory_sizes`.

    Args:
        problem: what to control.
        levels: how many there are.
        squeezer: who presses by measured forces, if anybody does.
    """
    scaled = sum(task.mode == "scaled" for task in problem.tasks)
    return {
        "stopped": 1, "soft": 1, "pull": 1, "recovery": 1,
        "missing": scaled, "later pulls": levels - 1,
        **(squeezer.memory_sizes if squeezer else {}),
    }  # fmt: skip


def soft_ticks(problem: ControlProblem) -> int:
    """For how many more ticks hard tasks stay soft that were given up."""
    return round(SOFT_FOR / problem.dt)
