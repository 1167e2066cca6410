"""The QP law: tasks as objectives, loop closure and limits as hard constraints.

    minimise    sum_i w_i |J_i v - (rate_i - gain_i e_i)|^2 + d |v|^2            soft tasks
    subject to  J_c v = -kappa e,   lb <= v <= ub,   G v <= h                    always
                J_j v = rate_j - gain_j e_j                                      hard tasks
                J_k v = s_k (rate_k - gain_k e_k),  0 <= s_k <= 1, s_k largest   scaled tasks

with d = damping + c dt (sum_i w_i gain_i |e_i| L_i + curvature of the rows that must hold), in
every level from its own tasks: what a step needs that it does not overshoot where the arms are
stretched (:class:`coopqp.qp_law.equations.Damping`). It fades as the tasks are met.

Soft tasks of a later priority, and the secondary objectives after them all, are solved in what the
earlier ones leave free (:mod:`coopqp.qp_law.priorities`).

A tick, from top to bottom: assemble, solve, improve (the later levels), shorten.

Joints that start outside their limits come back first, before all tasks
(:mod:`coopqp.qp_law.way_back`).

When not everything can hold, this is given up, in this order, and said: hard and scaled tasks
become soft, for a moment; the drift correction is done in part; acceleration limits go. Never the
loop rows, never position and velocity limits. Standing still is feasible from any state inside the
limits, so there is always an answer.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np

from coopqp.checked import Array
from coopqp.controller import Command, ControlProblem, Law
from coopqp.qp_law.equations import LEAST_SPEED, MOST_DAMPING, SCALE_WEIGHT, Damping, note_swing
from coopqp.qp_law.fallback import Fallback
from coopqp.qp_law.level import Level
from coopqp.qp_law.priorities import LaterLevel, Order
from coopqp.qp_law.way_back import WayBack
from coopqp.solver import Status, norm
from coopqp.squeezer import Squeezer
from coopqp.state import State

ERROR_DAMPING = 0.5  # default share of the damping that rules out any overshoot
SOFT_FOR = 0.2  # hard tasks that were given up stay soft for this long [s]
MOST_HARD_DAMPING = 1.0  # that the multipliers of hard tasks may ask for


class QPLaw(Law):
    """The QPs of one problem, with their arrays.

    Args:
        problem: what to control.
        damping: cost of |v|^2.
        error_damping: c, share of the damping that rules out any overshoot.
        squeezer: who presses by measured forces, if anybody does.
        order: of the problem's tasks, where it is known.

    Attributes:
        order: of the tasks.
        exact: the hard tasks, then the scaled ones. stacks: the soft tasks of each level.
        first: the level that holds the loops, the exact and the first soft tasks; qp and solution
            are its program and answer in the last tick.
        levels: all of them.
        way_back: the limits, and of joints outside of them. probe: its look at the loops.
        memory_sizes: "stopped" is 1 after a stop; "soft" for how many more ticks hard tasks stay
            soft; "swing" how much more damping there is because joints swing back,
            :func:`coopqp.qp_law.equations.note_swing`;
            "recovery" what the way back pulled at the loops in the last tick; "pull" the sum
            of the hard rows' multipliers; "missing" what the share of each scaled task lacked to 1;
            "later pulls" what each later level pulled at the rows decided before it,
            :meth:`LaterLevel.improve`; and what the squeezer needs.
    """

    engine = "python"

    def __init__(
        self,
        problem: ControlProblem,
        damping: float,
        error_damping: float = ERROR_DAMPING,
        squeezer: Squeezer | None = None,
        order: Order | None = None,
    ) -> None:
        super().__init__(problem, squeezer=squeezer)
        self.order = order = order or Order(problem)
        self._damping = cost = Damping(damping, error_damping, problem.dt)
        self.way_back = WayBack(problem, order.start, error_damping)
        self.probe, bounds = self.way_back.probe, self.way_back.bounds
        self.exact = order.exact
        self._scaled = self.exact.slices[len(order.hard) :]
        self._at_rest = 0.0 if order.scaled else 1.0  # the scale where scaled tasks do nothing
        self.stacks = [order.stack(level) for level in range(len(order.groups))]
        rows = [*problem.chain.loops.solver_rows, *self.exact.rows]
        names = [task.name for task in order.scaled]
        self.first = Level(problem, self.stacks[0], rows, bounds, cost, names)
        self.qp, self.solution = self.first.qp, self.first.solution
        self._later = [
            LaterLevel(problem, order, level, bounds, cost) for level in range(1, len(self.stacks))
        ]
        self.levels = (self.first, *(later.level for later in self._later))
        self.memory_sizes = memory_sizes(problem, len(self.stacks), squeezer)

    @cached_property
    def fallback(self) -> Fallback:
        """For ticks in which not everything can hold; built when asked for."""
        return Fallback(self.problem, self.order.start, self.way_back, self._damping)

    def prepare(self) -> QPLaw:
        """Build now what only rare ticks need, so that none waits for it; returns itself."""
        self.fallback, self.way_back.levels  # noqa: B018 - are built by being asked for
        return self

    def decide(self, state: State) -> Command:
        """Assemble, solve, verify, level by level; the command is safe whatever happened."""
        if state.memory["stopped"][0]:
            return self._stand_still(Status.INFEASIBLE)
        self.assemble(state)
        status = self._solve_first(state)
        command, way_back = self.command, self.way_back
        command.scale, command.drift = self.first.scale, 1.0
        v, causes = (self._improve if status.usable else self._give_up)(state, status)
        if way_back.active:
            v, causes = way_back.rescue(v, causes)
            command.drift = min(command.drift, way_back.share)
        if not causes[0].usable:
            return self._stand_still(*causes)
        command.v[:] = v
        command.say(*causes)
        self.probe.shorten(state, command)
        note_swing(state, command.v)
        return command

    def assemble(self, state: State) -> None:
        """Evaluate limits and tasks, and fill the first level's QP."""
        kappa = self.way_back.limit(state)
        for stack in (*self.stacks, self.exact):
            stack.update(state)
        self.first.assemble(state, self.way_back.bounds, self._exact_damping(state))
        self.first.close_loops(state, kappa)
        self._hold_exact(self.qp.A[len(state.e_loop) :], self.qp.b[len(state.e_loop) :])

    def _hold_exact(self, A: Array, b: Array) -> None:
        """Write J_j v = wanted_j of hard tasks, J_k v - s_k wanted_k = 0 of scaled ones."""
        n, wanted = self.problem.chain.n, self.exact.wanted
        A[:, :n], b[:] = self.exact.J, wanted
        for share, part in enumerate(self._scaled):
            A[part, n + share], b[part] = -wanted[part], 0.0

    def _exact_damping(self, state: State) -> float:
        """For hard rows, which bend by their multipliers, and for scaled ones.

        The multiplier of a scaled task is SCALE_WEIGHT (1 - s) / |wanted|, with s of the last tick.
        """
        if not self._scaled:
            pull = state.memory["pull"][0]
            return min(self._damping.of(state.chain.reach * pull, state), MOST_HARD_DAMPING)
        bends, pull = self.exact.bends(state.v), 0.0
        for part, missing in zip(self._scaled, state.memory["missing"], strict=True):
            wanted = self.exact.wanted[part]
            pull += missing * norm(bends[part]) / (wanted @ wanted + LEAST_SPEED**2)
        return min(self._damping.of(SCALE_WEIGHT * pull, state), MOST_DAMPING)

    def _solve_first(self, state: State) -> Status:
        """The first level's answer, unless its hard tasks were given up a moment ago."""
        memory, answer = state.memory, self.solution
        if memory["soft"][0] > 0.0:
            memory["soft"][0] -= 1.0
            return Status.INFEASIBLE
        status = self.first.solve()
        gives_up = status is Status.INFEASIBLE and self.problem.on_infeasible == "scale"
        if gives_up and self.exact.tasks:
            memory["soft"][0] = soft_ticks(self.problem)
        pulls, shares = answer.y[len(state.e_loop) :], answer.v[self.problem.chain.n :]
        memory["pull"][0] = np.abs(pulls).sum() if status.usable else 0.0
        memory["missing"][:] = 1.0 - shares if status.usable else 0.0
        return status

    def _improve(self, state: State, status: Status) -> tuple[Array, tuple[Status, ...]]:
        """What the later levels make of the first one's answer."""
        v, pulls = self.first.v, state.memory["later pulls"].reshape(-1, 1)
        for later, pull in zip(self._later, pulls, strict=True):
            v, status = later.improve(state, self.way_back.bounds, v, status, pull)
        return v, (status,)

    def _give_up(self, state: State, failed: Status) -> tuple[Array, tuple[Status, ...]]:
        """The answer of a smaller problem, where the problem is to be scaled."""
        self.command.scale = self._at_rest
        if self.problem.on_infeasible == "stop":
            state.memory["stopped"][0] = 1.0
        if self.problem.on_infeasible != "scale":
            return self.first.v, (failed,)
        v, causes = self.fallback.solve(state, failed)
        self.command.drift = self.fallback.drift
        return v, causes

    def _stand_still(self, *causes: Status) -> Command:
        self.command.v[:], self.command.scale = 0.0, self._at_rest
        self.command.say(*causes)
        return self.command


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
        **(squeezer.memory_sizes if squeezer else {}), "swing": 2,
    }  # fmt: skip


def soft_ticks(problem: ControlProblem) -> int:
    """For how many more ticks hard tasks stay soft that were given up."""
    return round(SOFT_FOR / problem.dt)
