"""Strict priorities: a sequence of QPs, each within what the ones before leave free.

Level 0 decides v_0. What its tasks and the loops see of it is fixed for the levels after:

    Q v = Q v_0,   Q an orthonormal basis of the rows decided so far,

so that level 1 moves in their null space alone, and so on. Q comes from a singular value
decomposition, which minds no redundant rows.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from coopqp.checked import Array
from coopqp.closed_chain import ClosedChain
from coopqp.controller import ControlProblem
from coopqp.limit import Limit, LimitRows, Tighten
from coopqp.qp import QP, RowNames
from coopqp.rank import matrix_rank
from coopqp.solver import Solution, Status, Verifier
from coopqp.state import State
from coopqp.task import Task, TaskStack


class Bounds:
    """The limits of one problem, for any number of QPs that share them.

    Args:
        problem: whose limits.
        start: a state, for limits that are constant.
        target: the QP whose bounds and first n columns of G they write; arrays of their own when
            omitted.
        skip: leave out the limits that are sacrificed first.

    Attributes:
        lb, ub, G, h: as of the last update, shapes (n,), (n,), (p, n), (p,).
    """

    def __init__(
        self, problem: ControlProblem, start: State, target: QP | None = None, *, skip: bool = False
    ) -> None:
        chain, n = problem.chain, problem.chain.n
        limits = _limits(problem, skip=skip)
        p = sum(len(limit.rows(chain)) for limit in limits)
        self.lb, self.ub = np.full(n, -np.inf), np.full(n, np.inf)
        self.G, self.h = np.zeros((p, n)), np.zeros(p)
        if target is not None:
            self.lb, self.ub, self.G, self.h = (
                target.lb[:n],
                target.ub[:n],
                target.G[:, :n],
                target.h,
            )
        self._each_tick: list[tuple[Tighten, LimitRows]] = []
        at = 0
        for limit in limits:
            part = slice(at, at + len(limit.rows(chain)))
            at = part.stop
            block = LimitRows(self.lb, self.ub, self.G[part], self.h[part])
            tighten = limit.bind(chain, problem.dt)
            if limit.constant:
                tighten(start, block)
            else:
                self._each_tick.append((tighten, block))
        self._constant_lb, self._constant_ub = self.lb.copy(), self.ub.copy()

    def update(self, state: State) -> None:
        """Ask the limits that change."""
        self.lb[:], self.ub[:] = self._constant_lb, self._constant_ub
        for tighten, block in self._each_tick:
            tighten(state, block)


def limit_names(problem: ControlProblem, *, skip: bool = False) -> tuple[str, ...]:
    """Names of the limits' inequality rows."""
    return tuple(n for k in _limits(problem, skip=skip) for n in k.rows(problem.chain))


def _limits(problem: ControlProblem, *, skip: bool) -> list[Limit]:
    return [limit for limit in problem.limits if not (skip and limit.sacrificed_first)]


class Level:
    """One QP: soft tasks within equality rows that somebody else fills.

    Args:
        problem: budget, solver and sizes.
        start: the state from which references set out.
        tasks: soft tasks of this level.
        equalities: names of the equality rows.
        inequalities: names of the limits' rows.
        damping: cost of |v|^2.
        error_damping: the same for every unit of the squared task error.
        scaled: names of the scaled tasks, each of which adds a share s in [0, 1].

    Attributes:
        qp, solution: of the last tick. qp's variables are v, then s.
        tasks: the stack of the soft tasks.
    """

    def __init__(
        self,
        problem: ControlProblem,
        start: State,
        tasks: Sequence[Task],
        equalities: tuple[str, ...],
        inequalities: tuple[str, ...],
        damping: float,
        scaled: tuple[str, ...] = (),
        error_damping: float = 0.0,
    ) -> None:
        n = problem.chain.n
        self.tasks = TaskStack(tasks, start)
        self.qp = QP(
            RowNames(
                variables=(*problem.chain.joint_names, *(f"scale[{name}]" for name in scaled)),
                inequalities=inequalities,
                equalities=equalities,
            )
        )
        self.solution = Solution(self.qp)
        qp, whole = self.qp, not scaled
        # With shares the blocks for v are parts of larger arrays, which BLAS writes to only when
        # they are whole; so the assembly has arrays of its own then.
        self._P, self._q = (qp.P, qp.q) if whole else (np.zeros((n, n)), np.zeros(n))
        self._whole, self._n = whole, n
        self._minus_weights = -self.tasks.weights[:, None]
        self._weighted_J = np.zeros_like(self.tasks.J)
        self._diagonal = np.diag(np.full(n, damping))
        self._error_damping = error_damping
        self._P_diagonal = self._P.reshape(-1)[:: n + 1]
        if scaled:
            qp.lb[n:], qp.ub[n:] = 0.0, 1.0
            np.fill_diagonal(qp.P[n:, n:], SCALE_WEIGHT)
            qp.q[n:] = -SCALE_WEIGHT
        self._verifier = Verifier(qp, self.solution, problem.budget, damping)
        self._solve = problem.solver.open(qp, self.solution)

    def assemble(self, state: State, bounds: Bounds) -> None:
        """Objective and limits; the caller fills A and b and seals."""
        qp, tasks, n = self.qp, self.tasks, self._n
        tasks.update(state)
        np.multiply(tasks.J, self._minus_weights, self._weighted_J)
        self._weighted_J.T.dot(tasks.J, self._P)
        np.subtract(self._diagonal, self._P, self._P)
        if self._error_damping:
            error = tasks.squared_error(state.v)
            np.add(self._P_diagonal, self._error_damping * error, self._P_diagonal)
        tasks.wanted.dot(self._weighted_J, self._q)
        if not self._whole:
            qp.P[:n, :n], qp.q[:n] = self._P, self._q
        if bounds.lb.base is qp.lower:
            return  # the limits have written here themselves
        qp.lb[:n], qp.ub[:n] = bounds.lb, bounds.ub
        if qp.p:
            qp.G[:, :n], qp.h[:] = bounds.G, bounds.h

    def solve(self) -> Status:
        """Solve and verify."""
        self._solve()
        self.solution.status = status = self._verifier.check()
        return status

    @property
    def v(self) -> Array:
        """The velocities of the answer."""
        return self.solution.v[: self._n]

    @property
    def scale(self) -> float:
        """Least share of the answer."""
        return float(self.solution.v[self._n :].min(initial=1.0))


#: Cost of a scaled task's missing share, far above any soft task.
SCALE_WEIGHT = 1e3


class Decided:
    """The rows that the levels so far have decided, as an orthonormal basis.

    Args:
        n: number of joints.
        rows: how many there are before redundant ones are dropped.
        rank: how many of them are independent in general.
    """

    def __init__(self, n: int, rows: int, rank: int) -> None:
        self._stack = np.zeros((rows, n))
        self.rank = rank

    def basis(self, *blocks: Array) -> Array:
        """Q, shape (rank, n)."""
        at = 0
        for block in blocks:
            self._stack[at : at + len(block)] = block
            at += len(block)
        if not np.isfinite(self._stack).all():
            return np.full((self.rank, self._stack.shape[1]), np.nan)
        Vt: Array = np.linalg.svd(self._stack, full_matrices=self.rank > at)[2]
        return Vt[: self.rank]


def generic_rank(chain: ClosedChain, rows: Callable[[State], Sequence[Array]]) -> int:
    """Largest rank of loop and task rows, so that a singular start leaves nothing undecided.

    Args:
        chain: whose configurations are sampled, seeded.
        rows: the task rows at a state.
    """
    rank, state = 0, State(chain)
    for q in (chain.q_start, *chain.sample(np.random.default_rng(0), SAMPLES)):
        state.q[:] = q
        state.update()
        rank = max(rank, matrix_rank(np.vstack([state.J_loop, *rows(state)])))
    return min(rank, chain.n)


SAMPLES = 6  # configurations at which ranks are taken, beside the start
