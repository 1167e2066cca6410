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
earlier ones leave free (:mod:`coopqp.hierarchy`).

When not everything can hold, this is given up, in this order, and said: hard and scaled tasks
become soft, acceleration limits, the drift correction. Never the loop rows, never position and
velocity limits. Standing still is feasible from any state inside the limits, so there is always an
answer.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

import numpy as np
import pinocchio as pin
from scipy.linalg.blas import dnrm2

from coopqp.checked import Array, NonNegative, Positive, spec
from coopqp.controller import Command, Controller, ControlProblem, Law
from coopqp.hierarchy import Bounds, Decided, Level, generic_rank, limit_names
from coopqp.limit import movers
from coopqp.qp import QP
from coopqp.solver import Solution, Status
from coopqp.state import State
from coopqp.task import Task, TaskStack

ERROR_DAMPING = 0.1  # default: 1e-3 at an error of 10 cm, 1e-7 at one of a millimetre
SHORTEN = 0.5  # a step that opens a loop too far is halved ...
SHORTEST = 2.0**-10  # ... down to this share, and then not made


class QPLaw(Law):
    """The QPs of one problem, with their arrays.

    Args:
        problem: what to control.
        damping: cost of |v|^2.
        error_damping: the same for every unit of the squared task error.

    Attributes:
        first: the level that holds the loops and the first soft tasks.
        levels: all of them.
        damping: as given.
        memory_size: 1; the memory is 1 after a stop.
    """

    memory_size = 1

    def __init__(
        self, problem: ControlProblem, damping: float, error_damping: float = ERROR_DAMPING
    ) -> None:
        super().__init__(problem)
        self.damping = damping
        start = State(problem.chain)
        self._exact = _ExactTasks(problem, start)
        groups = _groups(problem)
        loops, names = problem.chain.loops.solver_names, limit_names(problem)
        rows = (*loops, *self._exact.names)
        scaled = tuple(task.name for task in self._exact.scaled.tasks)
        self.first = Level(problem, start, groups[0], rows, names, damping, scaled, error_damping)
        self._bounds = Bounds(problem, start, self.first.qp)
        self._scales = bool(scaled)
        self._minus_kappa = np.full_like(start.e_loop, -problem.kappa)
        self._later = [
            _LaterLevel(problem, start, groups[: i + 1], group, names, damping, self._exact)
            for i, group in enumerate(groups[1:])
        ]
        self.levels = (self.first, *(later.level for later in self._later))
        self._fallback = _Fallback(problem, start, damping)
        self._probe = LoopProbe(problem)
        self._recovery = None if problem.chain.starts_inside else Recovery(problem)

    @property
    def qp(self) -> QP:
        """The first level's program of the last tick."""
        return self.first.qp

    @property
    def solution(self) -> Solution:
        """Its answer."""
        return self.first.solution

    def tick(self, state: State) -> Command:
        """Assemble, solve, verify, level by level; the command is safe whatever happened."""
        command = self.command
        if state.memory.size and state.memory[0]:
            return self._stand_still(Status.INFEASIBLE)
        self.assemble(state)
        status, v = self.first.solve(), self.first.v
        if self._scales:
            command.scale = self.first.scale
        if status.usable:
            # Later levels would undo the way back, which no task asks for.
            recovering = self._recovery is not None and self._recovery.active
            for later in () if recovering else self._later:
                status, v = later.solve(state, self._bounds, v, status)
        elif self.problem.on_infeasible == "scale":
            command.scale = 0.0 if self._scales else 1.0
            status, v = self._fallback.solve(state, status, self._recovery)
        elif self.problem.on_infeasible == "stop" and state.memory.size:
            state.memory[0] = 1.0
        if not status.usable:
            command.scale = 0.0 if self._scales else 1.0
            return self._stand_still(status)
        command.v[:] = v
        command.status = status
        self._shorten(state, command)
        if self._recovery and self._recovery.active:
            command.status = Status.RECOVERING
        return command

    def assemble(self, state: State) -> None:
        """Fill the first level's QP for a state."""
        self._bounds.update(state)
        self.first.assemble(state, self._bounds)
        if self._recovery:
            self._recovery.pull(state, self.first.qp)
        qp, m = self.first.qp, len(state.e_loop)
        if qp.m == m and qp.n == len(state.q):
            qp.A[:] = state.J_loop
        else:
            qp.A[:m, : len(state.q)] = state.J_loop
            self._exact.fill(state, qp.A[m:], qp.b[m:])
        np.multiply(state.e_loop, self._minus_kappa, qp.b[:m])
        qp.seal()

    def _stand_still(self, status: Status) -> Command:
        self.command.v[:] = 0.0
        self.command.status = status
        return self.command

    def _shorten(self, state: State, command: Command) -> None:
        """Halve the step until the loops stay within the budget after it."""
        share = 1.0
        while not self._probe.within(state, command.v):
            share *= SHORTEN
            if share < SHORTEST:
                command.v[:] = 0.0
                command.status = Status.STEP_SHORTENED
                return
            command.v *= SHORTEN
            command.status = Status.STEP_SHORTENED


class _ExactTasks:
    """The hard and scaled tasks: equality rows of the first level."""

    def __init__(self, problem: ControlProblem, start: State) -> None:
        tasks = [task for task in problem.tasks if task.mode != "soft"]
        self.hard = TaskStack([task for task in tasks if task.mode == "hard"], start)
        self.scaled = TaskStack([task for task in tasks if task.mode == "scaled"], start)
        self.names = (*self.hard.names, *self.scaled.names)
        self._n = problem.chain.n

    def fill(self, state: State, A: Array, b: Array) -> None:
        """Write the rows, shapes (k, n + shares) and (k,)."""
        if not self.names:
            return
        n, k = self._n, len(self.hard.e)
        self.hard.update(state)
        self.scaled.update(state)
        A[:k, :n], b[:k] = self.hard.J, self.hard.wanted
        A[k:, :n], b[k:] = self.scaled.J, 0.0
        for share, part in enumerate(self.scaled.slices):
            A[k + part.start : k + part.stop, n + share] = -self.scaled.wanted[part]


class _LaterLevel:
    """A level after the first, within what all levels before it have decided."""

    def __init__(
        self,
        problem: ControlProblem,
        start: State,
        before: Sequence[Sequence[Task]],
        tasks: Sequence[Task],
        inequalities: tuple[str, ...],
        damping: float,
        exact: _ExactTasks,
    ) -> None:
        self._before = TaskStack([task for group in before for task in group], start)
        self._exact = exact
        blocks = (self._before.J, exact.hard.J, exact.scaled.J)

        def stacked(state: State) -> Sequence[Array]:
            for stack in (self._before, exact.hard, exact.scaled):
                stack.update(state)
            return blocks

        rank = generic_rank(problem.chain, stacked)
        rows = sum(len(block) for block in (start.J_loop, *blocks))
        self._decided = Decided(problem.chain.n, rows, rank)
        names = tuple(f"decided[{i}]" for i in range(rank))
        self._full = rank == problem.chain.n
        self.level = Level(problem, start, tasks, names, inequalities, damping)

    def solve(self, state: State, bounds: Bounds, v: Array, status: Status) -> tuple[Status, Array]:
        """Improve v where it is still free; keep it when this level fails."""
        if self._full:
            return status, v
        self._before.update(state)
        Q = self._decided.basis(
            state.J_loop, self._before.J, self._exact.hard.J, self._exact.scaled.J
        )
        level = self.level
        level.assemble(state, bounds)
        level.qp.A[:] = Q
        Q.dot(v, level.qp.b)
        level.qp.seal()
        own = level.solve()
        if not own.usable:
            return Status.INACCURATE, v
        return (status if own is Status.OPTIMAL else own), level.v


class _Fallback:
    """The declared order of sacrifice, from the least to the most."""

    def __init__(self, problem: ControlProblem, start: State, damping: float) -> None:
        tasks, loops = list(problem.tasks), problem.chain.loops.solver_names
        self._soft = Level(problem, start, tasks, loops, limit_names(problem), damping)
        self._free = Level(problem, start, tasks, loops, limit_names(problem, skip=True), damping)
        self._bounds = Bounds(problem, start, self._soft.qp)
        self._slack = Bounds(problem, start, self._free.qp, skip=True)
        self._minus_kappa = -problem.kappa
        self._has_exact = any(task.mode != "soft" for task in tasks)
        self._has_sacrifice = any(limit.sacrificed_first for limit in problem.limits)

    def solve(
        self, state: State, failed: Status, recovery: Recovery | None
    ) -> tuple[Status, Array]:
        """The first attempt that has an answer, and what it gave up; else the first failure.

        That something left no motion is said only where the solver found so each time: one that
        ran out of iterations or broke a row tells nothing about the problem.
        """
        attempts = (
            (self._has_exact, self._soft, self._bounds, 1.0, Status.TASKS_GIVEN_UP),
            (self._has_sacrifice, self._free, self._slack, 1.0, Status.ACCELERATION_GIVEN_UP),
            (True, self._free, self._slack, 0.0, Status.DRIFT_GIVEN_UP),
        )
        conflict = failed is Status.INFEASIBLE
        for makes_sense, level, bounds, drift, given_up in attempts:
            if not makes_sense:
                continue
            status = self._attempt(state, level, bounds, drift, recovery)
            if status.usable:
                return given_up if conflict else Status.SOLVER_FAILED, level.v
            conflict = conflict and status is Status.INFEASIBLE
        return failed, self._free.v

    def _attempt(
        self, state: State, level: Level, bounds: Bounds, drift: float, recovery: Recovery | None
    ) -> Status:
        bounds.update(state)
        level.assemble(state, bounds)
        if recovery:
            recovery.pull(state, level.qp)
        level.qp.A[:] = state.J_loop
        np.multiply(state.e_loop, drift * self._minus_kappa, level.qp.b)
        if not drift:  # the last attempt: nothing may ask for a motion, so that v = 0 is feasible
            np.maximum(level.qp.h, 0.0, out=level.qp.h)
        level.qp.seal()
        return level.solve()


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
        self._dt = np.full(chain.n, problem.dt)
        self._q = np.zeros(chain.n)
        self._gap, self._turn = budget.loop_position, budget.loop_orientation
        pin.framesForwardKinematics(self._model, self._data, chain.q_start)
        X_0, *others = (self._data.oMf[frame] for frame in frames)
        self._p_0, self._R_0T = X_0.translation, X_0.rotation.T
        self._others = [(X.translation, X.rotation) for X in others]
        moved = movers(chain, [chain.model.frames[frame].parentJoint for frame in frames])
        per_arm = moved * moved.sum(axis=1, keepdims=True)
        self._second_order = 0.5 * problem.dt**2 * (per_arm[1:] + per_arm[0])
        self._steepest = float(self._second_order.max(initial=0.0))  # a bound that takes one norm
        self._reach, self._squares = chain.reach, np.zeros(chain.n)

    def within(self, state: State, v: Array) -> bool:
        """Whether the loops are within budget after a step v dt, or no worse than before it."""
        if not self._others:  # one arm alone closes no loop
            return True
        error, speed = 2.0 * dnrm2(state.closed_error), dnrm2(v)
        if self._fits(error, self._steepest * speed * speed):
            return True
        opened = max(self._second_order.dot(np.multiply(v, v, self._squares)).tolist())
        return self._fits(error, opened) or self._look(state, v)

    def _fits(self, error: float, opened: float) -> bool:
        return error + self._reach * opened <= self._gap and error + opened <= self._turn

    def _look(self, state: State, v: Array) -> bool:
        np.multiply(v, self._dt, self._q)
        np.add(self._q, state.q, self._q)
        pin.forwardKinematics(self._model, self._data, self._q)
        for frame in self._frames:
            pin.updateFramePlacement(self._model, self._data, frame)
        for p, R in self._others:
            if np.linalg.norm(p - self._p_0) > self._gap:
                return self._no_worse(state)
            if np.linalg.norm(pin.log3(R.dot(self._R_0T))) > self._turn:
                return self._no_worse(state)
        return True

    def _no_worse(self, state: State) -> bool:
        """A loop that is open already may be closed by steps that leave it open for now."""
        before = np.linalg.norm(state.closed_error.reshape(-1, 2, 3), axis=2)
        for (p, R), (gap, turn) in zip(self._others, before, strict=True):
            gap_after = np.linalg.norm(p - self._p_0)
            turn_after = np.linalg.norm(pin.log3(R.dot(self._R_0T)))
            if gap_after > max(gap, self._gap):
                return False
            if turn_after > max(turn, self._turn):
                return False
        return True


def _groups(problem: ControlProblem) -> list[list[Task]]:
    """Soft tasks by priority, then the secondary objectives by theirs; the first may be empty."""
    soft = [task for task in problem.tasks if task.mode == "soft"]
    first = min((task.priority for task in soft), default=0)
    main = [
        [k for k in soft if k.priority == p] for p in sorted({first, *(k.priority for k in soft)})
    ]
    later = [
        [k for k in problem.secondary if k.priority == p]
        for p in sorted({k.priority for k in problem.secondary})
    ]
    # What a scaled task can do comes before all soft ones, whatever their weights.
    first_alone: list[list[Task]] = (
        [[]] if any(task.mode == "scaled" for task in problem.tasks) else []
    )
    return [*first_alone, *main, *later]


class Recovery:
    """Pulls joints that are outside their limits back, more than any task pulls.

    Args:
        problem: dt and limits.

    Attributes:
        active: whether a joint was outside in the last tick.
    """

    def __init__(self, problem: ControlProblem) -> None:
        chain = problem.chain
        self._lower, self._upper, self._rate = chain.lower, chain.upper, 1.0 / problem.dt
        self.active = False

    def pull(self, state: State, qp: QP) -> None:
        """Add the wish to be back at the limit with the next step; the bounds slow it down."""
        n = len(state.q)
        back = np.maximum(self._lower - state.q, 0.0) - np.maximum(state.q - self._upper, 0.0)
        outside = back != 0.0
        self.active = bool(outside.any())
        if not self.active:
            return
        # A speed that goes to zero at the limit would lose against the tasks just outside it.
        wish = np.sign(back) * np.maximum(np.abs(back) * self._rate, LEAST_RECOVERY)
        wish = np.minimum(np.maximum(wish, qp.lb[:n]), qp.ub[:n])
        weight = RECOVERY_WEIGHT * outside
        qp.P.reshape(-1)[: n * qp.n : qp.n + 1] += weight
        qp.q[:n] -= weight * wish


#: Cost of not coming back, far above any task [s2/rad2].
RECOVERY_WEIGHT = 1e3
#: Slowest wish to come back [rad/s].
LEAST_RECOVERY = 0.02


@spec
class QPController(Controller):
    """QP each tick: tasks as objectives, loop closure and limits as hard constraints."""

    uses_solver: ClassVar[bool] = True

    damping: Positive = 1e-6
    """Cost of |v|^2 [s2/rad2]; makes the answer unique. Below 1e-9 solvers begin to disagree."""
    error_damping: NonNegative = ERROR_DAMPING
    """The same for every unit of the squared task error [s2/rad2 per m2]."""

    def build(self, problem: ControlProblem) -> Law:
        """Preallocate the QPs and open the solver on them."""
        return QPLaw(problem, self.damping, self.error_damping)
