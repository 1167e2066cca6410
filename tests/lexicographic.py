"""The lexicographic optimum of a tick, computed apart from the law, on 64 bits of mantissa.

From the state, the tasks and the limits, never from the law's programs:

    0  J_c v = -kappa e,  lb <= v <= ub,  G v <= h
    1  J_h v = w_h of the hard tasks; where that cannot hold
       min sum weight |J_h v - w_h|^2 + d |v|^2
    2  J_k v = s_k w_k of the scaled tasks, 0 <= s_k <= 1,  min 1e3 sum (1 - s_k)^2 + d |v|^2; where
       that cannot hold  min sum weight (|across|^2 + 1e-3 |along|^2) of J_k v - w_k, + d |v|^2
    3  soft tasks and secondary objectives, min sum weight |J v - w|^2 + d |v|^2 by priority

Each level keeps J v of the tasks before it. The dampings d belong to the definition.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import quadprog
from oracle import LONG, Program, UndeterminedError, solved

from coopqp.checked import Array
from coopqp.controller import ControlProblem
from coopqp.qp_law.bounds import Bounds
from coopqp.qp_law.equations import SCALE_WEIGHT, Damping
from coopqp.qp_law.safety import drift_gain
from coopqp.state import State
from coopqp.task import Task, TaskStack

LEAST_RELAXED = 1e-9  # cost of |v|^2 where hard or scaled tasks are met as nearly as possible
ALONG = 1e-3  # cost of a scaled task's missing share beside what is across its direction
PROBE = 1e-14  # cost of |v|^2 while it is asked whether rows can hold
EXCESS = 1e-12  # by which limits may be exceeded [rad/s]
ROOM = 1e-9  # by which they may be while it is looked for those that are active [rad/s]
NOISE, CLEAR = 1e-7, 1e-5  # singular values that add nothing to the rows before, or something
HOLDS, FAILS = 1e-9, 1e-6  # rows that miss by less hold, by more do not [m/s, rad/s]


@dataclass(frozen=True)
class Optimum:
    """What a tick's levels want.

    Attributes:
        v: velocity, shape (n,) [rad/s, m/s].
        hard, scaled: whether these tasks can hold; True without such tasks.
    """

    v: Array
    hard: bool
    scaled: bool


class Cascade:
    """The levels of one problem at one state.

    Args:
        problem: whose tick it is.
        state: of the tick, up to date.
        damping: cost of |v|^2 of soft levels and of scaled tasks that hold.
        missed: what each hard, then each scaled row lacked in the last tick, shape (k,) [m/s,
            rad/s]; for their level's damping where they do not hold.
        jitter: by how much numbers are moved, in units of their last digit.
        seed: of the jitter.
    """

    def __init__(
        self,
        problem: ControlProblem,
        state: State,
        damping: Damping,
        missed: Array | None = None,
        jitter: float = 0.0,
        seed: int = 0,
    ) -> None:
        self._problem, self._state, self._damping = problem, state, damping
        self._rng, self._jitter, self._missed = np.random.default_rng(seed), jitter, missed
        self._start, self._n = State(problem.chain), problem.chain.n
        bounds = Bounds(problem.chain, problem.limits, self._start, problem.dt)
        bounds.update(state)
        unit = np.eye(self._n)
        G = np.vstack([unit, -unit, self._moved(bounds.G)])
        h = np.concatenate([bounds.ub, -bounds.lb, bounds.h])
        self._G, self._h = G[np.isfinite(h)], h[np.isfinite(h)]
        wanted = (-drift_gain(problem, state) * state.e_loop).astype(LONG)
        nothing = np.zeros((0, self._n), LONG), np.zeros(0, LONG)
        self._C, self._c = _added(*nothing, self._moved(state.J_loop), wanted)
        self._v = np.zeros(self._n, LONG)

    def optimum(self) -> Optimum:
        """Level by level.

        Raises:
            UndeterminedError: rows nearly depend on each other, or just hold or just do not.
        """
        by_mode = {
            mode: [task for task in self._problem.tasks if task.mode == mode]
            for mode in ("hard", "scaled")
        }
        hard = self._hard(self._stack(by_mode["hard"])) if by_mode["hard"] else True
        scaled = self._scaled(self._stack(by_mode["scaled"])) if by_mode["scaled"] else True
        for group in _levels(self._problem):
            self._soft(self._stack(group))
        return Optimum(self._v.astype(float), hard, scaled)

    def _hard(self, tasks: TaskStack) -> bool:
        J, w = self._moved(tasks.J), tasks.wanted.astype(LONG)
        holds = self._can_hold(J, w)
        if holds:
            self._keep(J, w)
        else:
            rows = slice(0, len(w))
            self._minimise(J, w, tasks.weights, self._relaxed(tasks, rows))
            self._keep(J, J @ self._v)
        return holds

    def _scaled(self, tasks: TaskStack) -> bool:
        J, w = self._moved(tasks.J), tasks.wanted.astype(LONG)
        ways = np.zeros((len(w), len(tasks.slices)), LONG)  # of each task in a column
        for k, part in enumerate(tasks.slices):
            ways[part, k] = w[part]
        holds = self._can_hold(np.hstack([J, -ways]), np.zeros_like(w))
        if holds:
            self._share(J, ways)
        else:
            across = [_across(w[part]) for part in tasks.slices]
            turned = _block_diagonal(across)
            rows = slice(-len(w), None)
            self._minimise(turned @ J, turned @ w, tasks.weights, self._relaxed(tasks, rows))
        self._keep(J, J @ self._v)
        return holds

    def _soft(self, tasks: TaskStack) -> None:
        J, w = self._moved(tasks.J), tasks.wanted.astype(LONG)
        bend = tasks.bend(self._state.v)
        d = self._damping.least + self._damping.of(bend, self._state)
        self._minimise(J, w, tasks.weights, d)
        self._keep(J, J @ self._v)

    def _relaxed(self, tasks: TaskStack, rows: slice) -> float:
        """Damping of tasks that are met as nearly as possible."""
        if self._missed is None:
            return LEAST_RELAXED
        bend = float((tasks.weights * tasks.levers) @ np.abs(self._missed[rows]))
        return LEAST_RELAXED + self._damping.of(bend, self._state)

    def _can_hold(self, J: Array, w: Array) -> bool:
        """Whether J x = w can hold within all that is kept; x may have shares after v."""
        shares = J.shape[1] - self._n
        x = self._solve(np.vstack([J, np.sqrt(LONG(PROBE)) * np.eye(J.shape[1])]),
                        np.concatenate([w, np.zeros(J.shape[1])]), shares)  # fmt: skip
        missed = float(np.abs(J @ x - w).max())
        if HOLDS < missed < FAILS:
            raise UndeterminedError
        return missed <= HOLDS

    def _share(self, J: Array, ways: Array) -> None:
        """The largest shares s with J v = ways s."""
        n, shares = self._n, ways.shape[1]
        damping = np.sqrt(LONG(self._damping.least))
        M = np.diag(np.concatenate([np.full(n, damping), np.full(shares, np.sqrt(SCALE_WEIGHT))]))
        m = np.concatenate([np.zeros(n, LONG), np.full(shares, np.sqrt(LONG(SCALE_WEIGHT)))])
        rows = np.hstack([J, -ways])
        self._v = self._solve(M.astype(LONG), m, shares, rows)[:n]

    def _minimise(self, J: Array, w: Array, weights: Array, d: float) -> None:
        roots = np.sqrt(weights.astype(LONG))
        M = np.vstack([roots[:, None] * J, np.sqrt(LONG(d)) * np.eye(self._n)])
        self._v = self._solve(M, np.concatenate([roots * w, np.zeros(self._n)]), 0)

    def _solve(self, M: Array, m: Array, shares: int, held: Array | None = None) -> Array:
        """Least squares within all that is kept, with shares from 0 to 1, and more rows at zero."""
        n, wide = self._n, self._n + shares
        C, c = _widened(self._C, shares), self._c
        if held is not None:
            C, c = _added(C, c, held, np.zeros(len(held), LONG))
        ends = np.eye(wide)[n:]
        G = np.vstack([_widened(self._G, shares), ends, -ends])
        h = np.concatenate([self._h, np.ones(shares), np.zeros(shares)])
        program = Program(M, m, C.astype(LONG), c.astype(LONG), G.astype(LONG), h.astype(LONG))
        return solved(program, _active(program), EXCESS)

    def _keep(self, J: Array, w: Array) -> None:
        self._C, self._c = _added(self._C, self._c, J, w)

    def _stack(self, tasks: list[Task]) -> TaskStack:
        stack = TaskStack(tasks, self._start)
        stack.update(self._state)
        return stack

    def _moved(self, rows: Array) -> Array:
        size = self._jitter * np.finfo(float).eps
        return rows.astype(LONG) * (1.0 + size * self._rng.uniform(-1.0, 1.0, rows.shape))


def _levels(problem: ControlProblem) -> list[list[Task]]:
    """Soft tasks by priority, then the secondary objectives by theirs."""
    groups = []
    for tasks in ([t for t in problem.tasks if t.mode == "soft"], list(problem.secondary)):
        for priority in sorted({task.priority for task in tasks}):
            groups.append([task for task in tasks if task.priority == priority])
    return groups


def _across(w: Array) -> Array:
    """Square root of the weights of what is across and along w, shape (k, k)."""
    size = np.sqrt(w @ w)
    if not size:
        return np.eye(len(w), dtype=LONG)
    u = w / size
    return np.eye(len(w), dtype=LONG) + (np.sqrt(LONG(ALONG)) - 1.0) * np.outer(u, u)


def _block_diagonal(blocks: list[Array]) -> Array:
    size = sum(map(len, blocks))
    whole, at = np.zeros((size, size), LONG), 0
    for block in blocks:
        whole[at : at + len(block), at : at + len(block)] = block
        at += len(block)
    return whole


def _active(program: Program) -> list[int]:
    """The limits that are active by quadprog, with a little room so that some motion is left."""
    M, C, G = (rows.astype(float) for rows in (program.M, program.C, program.G))
    P = M.T @ M
    P += 1e-14 * np.trace(P) * np.eye(len(P))
    rows, sides = np.vstack([C, -G]), np.concatenate([program.c, -program.h - ROOM])
    try:
        found = quadprog.solve_qp(
            P, M.T @ program.m.astype(float), rows.T, sides.astype(float), len(C)
        )
    except ValueError as error:
        raise UndeterminedError from error
    multipliers, numbers = found[4][len(C) :], found[5] - 1 - len(C)
    active = [int(i) for i in numbers if i >= 0]
    return sorted(active, key=lambda i: -float(multipliers[i]))


def _widened(rows: Array, shares: int) -> Array:
    return np.hstack([rows, np.zeros((len(rows), shares))])


def _added(C: Array, c: Array, rows: Array, sides: Array) -> tuple[Array, Array]:
    """Orthonormal C x = c and what rows x = sides add to them.

    Raises:
        UndeterminedError: what they add is next to nothing, but not noise.
    """
    left = rows - (rows @ C.T) @ C
    U, values, Vt = np.linalg.svd(left.astype(float), full_matrices=False)
    if ((values > NOISE) & (values < CLEAR)).any():
        raise UndeterminedError
    U, Q = U[:, values >= CLEAR].astype(LONG), Vt[values >= CLEAR].astype(LONG)
    for i, row in enumerate(Q):
        for _ in range(2):
            row -= (C @ row) @ C + (Q[:i] @ row) @ Q[:i]
        row /= np.sqrt(row @ row)
    seen, wanted = U.T @ left @ Q.T, U.T @ (sides - rows @ (c @ C))
    b = np.zeros(len(Q), LONG)
    for _ in range(3):  # refined: the factorisation has 53 bits
        b += np.linalg.solve(seen.astype(float), (wanted - seen @ b).astype(float))
    return np.vstack([C, Q]), np.concatenate([c, b])
