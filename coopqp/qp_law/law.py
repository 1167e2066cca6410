"""The QP law: tasks as objectives, loop closure and limits as hard constraints.

    minimise    sum_i w_i |J_i v - (rate_i - gain_i e_i)|^2 + d |v|^2            soft tasks
    subject to  J_c v = -kappa e,   lb <= v <= ub,   G v <= h                    always
                J_j v = rate_j - gain_j e_j                                      hard tasks
                J_k v = s_k (rate_k - gain_k e_k),  0 <= s_k <= 1, s_k largest   scaled tasks

with d = damping + error_damping sum_i |e_i|^2 (Sugihara 2011). The second part fades as the
tasks are met; without it a goal out of reach can make the arms rattle at full speed about the
singular pose where they are stretched. For a task that asks for a velocity alone, such as twist,
J_i v_last - rate_i stands for e_i: what the last tick has missed.

Soft tasks of a later priority, and the secondary objectives after them all, are solved in what the
earlier ones leave free (:mod:`coopqp.qp_law.priorities`).

A tick, from top to bottom: assemble, solve, improve (the later levels), shorten.

When not everything can hold, this is given up, in this order, and said: hard and scaled tasks
become soft, acceleration limits, the drift correction. Never the loop rows, never position and
velocity limits. Standing still is feasible from any state inside the limits, so there is always an
answer.
"""

from __future__ import annotations

from coopqp.checked import Array
from coopqp.controller import Command, ControlProblem, Law
from coopqp.qp import QP
from coopqp.qp_law.bounds import Bounds
from coopqp.qp_law.equations import add_damping, loop_rows
from coopqp.qp_law.exact_tasks import ExactTasks
from coopqp.qp_law.fallback import Fallback
from coopqp.qp_law.level import Level
from coopqp.qp_law.priorities import LaterLevel, groups
from coopqp.qp_law.recovery import Recovery
from coopqp.qp_law.safety import LoopProbe
from coopqp.solver import Solution, Status
from coopqp.state import State
from coopqp.task import TaskStack

ERROR_DAMPING = 0.1  # default: 1e-3 at an error of 10 cm, 1e-7 at one of a millimetre


class QPLaw(Law):
    """The QPs of one problem, with their arrays.

    Args:
        problem: what to control.
        damping: cost of |v|^2.
        error_damping: the same for every unit of the squared task error.

    Attributes:
        first: the level that holds the loops, the hard and scaled and the first soft tasks.
        levels: all of them.
        damping: as given.
        memory_sizes: "stopped" is 1 after a stop.
    """

    memory_sizes = {"stopped": 1}  # noqa: RUF012 - a constant of the class

    def __init__(
        self, problem: ControlProblem, damping: float, error_damping: float = ERROR_DAMPING
    ) -> None:
        super().__init__(problem)
        chain, start = problem.chain, State(problem.chain)
        self.damping, self._error_damping = damping, error_damping
        self._bounds = bounds = Bounds(chain, problem.limits, start, problem.dt)
        self._exact = exact = ExactTasks(problem, start)
        stacks = [TaskStack(group, start) for group in groups(problem)]
        rows = (*chain.loops.solver_rows, *exact.rows)
        self.first = Level(problem, stacks[0], rows, bounds, damping, exact.scaled_names)
        self._later = []
        for i, stack in enumerate(stacks[1:], 1):
            later = LaterLevel(problem, stacks[:i], exact, stack, bounds, damping)
            if later.nothing_free:
                break
            self._later.append(later)
        self._stacks = stacks[: len(self._later) + 1]
        self.levels = (self.first, *(later.level for later in self._later))
        self._fallback = Fallback(problem, start, damping)
        self._probe = LoopProbe(problem)
        self._recovery = None if chain.starts_inside else Recovery(problem)
        self._has_exact, self._scales = bool(exact.rows), bool(exact.scaled_names)
        self._stops = problem.on_infeasible == "stop"

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
        status = self.first.solve()
        v, scale = self.first.v, self.first.scale if self._scales else 1.0
        if status.usable:
            status, v = self._improve(state, status)
        elif self.problem.on_infeasible == "scale":
            status, v = self._fallback.solve(state, status, self._recovery)
            scale = 0.0 if self._scales else 1.0
        elif self._stops:
            state.memory["stopped"][0] = 1.0
        if not status.usable:
            return self._stand_still(status)
        command = self.command
        command.v[:], command.status, command.scale = v, status, scale
        self._probe.shorten(state, command)
        if self._recovery and self._recovery.active:
            command.status = Status.RECOVERING
        return command

    def assemble(self, state: State) -> None:
        """Evaluate limits and tasks, and fill the first level's QP."""
        first, m = self.first, len(state.e_loop)
        self._bounds.update(state)
        for stack in self._stacks:
            stack.update(state)
        first.assemble(self._bounds)
        add_damping(first.P, self._error_damping * first.tasks.squared_error(state.v))
        if self._recovery:
            self._recovery.pull(state, first.qp)
        loop_rows(state.J_loop, state.e_loop, self.problem.kappa, first.A[:m], first.b[:m])
        if self._has_exact:
            self._exact.update(state)
            self._exact.fill(first.qp.A[m:], first.b[m:])

    def _improve(self, state: State, status: Status) -> tuple[Status, Array]:
        """What the later levels make of the first one's answer."""
        v = self.first.v
        if self._recovery and self._recovery.active:
            return status, v  # they would undo the way back, which no task asks for
        for later in self._later:
            status, v = later.improve(state, self._bounds, v, status)
        return status, v

    def _stand_still(self, status: Status) -> Command:
        command = self.command
        command.v[:], command.status = 0.0, status
        command.scale = 0.0 if self._scales else 1.0
        return command
