"""The lexicographic optimum of a tick, computed apart from the law, on 64 bits of mantissa.

From the state, the tasks and the limits, never from the law's programs:

    0  J_c v = -kappa e,  lb <= v <= ub,  G v <= h
    1  v_h: min sum weight |J_h v - w_h|^2 + d |v|^2 of the hard tasks; where w_h can hold, that and
       the shortest motion with w_h are mixed: v_h counts where it lacks more than MET of a row, in
       part up to 2 MET, and from NEAR a limit to the limit, or from SLOW / 2 to SLOW
    2  v_s: J_k v = s_k w_k + t a_k of the scaled tasks, 0 <= s_k, t <= 1, where a is what level 1
       makes of J_k v, as long as SLOW where it is shorter, and J_h v stays,
       min 1e3 (sum (1 - s_k)^2 + (t + ASIDE)^2) + d |v|^2
       v_n: min sum weight |J_k v - w_k|^2 + d |v|^2
       v = (1 - r) v_s + r v_n  with r of :func:`coopqp.qp_law.nearest.blocked`, and at least t and
       what hard tasks lack over SLOW
    3  soft tasks and secondary objectives, min sum weight |J v - w|^2 + d |v|^2 by priority

Each level keeps J v of the tasks before it. The dampings d belong to the definition: they are made
of the state's memory.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
import quadprog
from oracle import LONG, Program, UndeterminedError, solved

from coopqp.base.spec import Array
from coopqp.controller import ControlProblem
from coopqp.model.state import State
from coopqp.qp_law.bounds import Bounds
from coopqp.qp_law.equations import LEAST_SPEED, MOST_DAMPING, SCALE_WEIGHT, Damping
from coopqp.qp_law.nearest import ASIDE, LESS, MET, NEAR, SLOW, WHOLE, blocked
from coopqp.qp_law.priorities import IDLE
from coopqp.qp_law.priorities import NOISE as RELEASED
from coopqp.qp_law.safety import drift_gain
from coopqp.task import Task, TaskStack

PROBE = 1e-14  # cost of |v|^2 while it is asked whether rows can hold
EXCESS = 1e-12  # by which limits may be exceeded [rad/s], and t its bound
ROOM = 1e-9  # by which they may be while it is looked for those that are active [rad/s]
NOISE, CLEAR = 1e-10, 1e-5  # singular values that add nothing to the rows before, or something
HOLDS, FAILS = 1e-9, 1e-6  # rows that miss by less hold, by more do not [m/s, rad/s]


@dataclass(frozen=True)
class Optimum:
    """What a tick's levels want.

    Attributes:
        v: velocity, shape (n,) [rad/s, m/s].
        hard, scaled: whether these tasks are relaxed.
    """

    v: Array
    hard: bool
    scaled: bool


class Cascade:
    """The levels of one problem at one state.

    Args:
        problem: whose tick it is.
        state: of the tick, up to date, with the memory that the law has before it.
        damping: cost of |v|^2.
        jitter: by how much the numbers of Jacobians, and of the gradients that programs are made
            of, are moved, in units of their last digit.
        seed: of the jitter.
    """

    def __init__(
        self,
        problem: ControlProblem,
        state: State,
        damping: Damping,
        jitter: float = 0.0,
        seed: int = 0,
    ) -> None:
        self._problem, self._state, self._damping = problem, state, damping
        self._rng, self._jitter = np.random.default_rng(seed), jitter
        self._start, self._n = State(problem.chain), problem.chain.n
        bounds = Bounds(problem.limits, self._start, problem.dt)
        bounds.update(state)
        unit = np.eye(self._n)
        G = np.vstack([unit, -unit, self._moved(bounds.G)])
        h = np.concatenate([bounds.ub, -bounds.lb, bounds.h])
        self._G, self._h = G[np.isfinite(h)], h[np.isfinite(h)]
        wanted = (-drift_gain(problem, state) * state.e_loop).astype(LONG)
        nothing = np.zeros((0, self._n), LONG), np.zeros(0, LONG)
        self._C, self._c = _added(*nothing, self._moved(state.J_loop), wanted)
        self._loops = self._C
        self._v, self._decided = np.zeros(self._n, LONG), np.zeros((0, self._n), LONG)

    def optimum(self) -> Optimum:
        """Level by level.

        Raises:
            UndeterminedError: rows nearly depend on each other, or just hold or just do not.
        """
        tasks, memory = self._problem.tasks, self._state.memory
        hard = self._stack([task for task in tasks if task.mode == "hard"])
        scaled = self._stack([task for task in tasks if task.mode == "scaled"])
        firm = bool(hard.tasks or scaled.tasks)
        relaxed = self._firm(hard, scaled) if firm else (False, False)
        pulls = memory["later pulls"].tolist()
        if not firm:  # the first soft level is then the first of all
            pulls.insert(0, 0.0)
        # The law leaves out levels with no motion left.
        groups = zip(
            _levels(self._problem), itertools.chain(pulls, itertools.repeat(0.0)), strict=False
        )
        for group, pull in groups:
            soft = self._stack(group)
            J = self._moved(soft.J)
            self._v = self._improved(soft, J, pull)
            self._keep(J, J @ self._v)
        return Optimum(self._v.astype(float), *relaxed)

    def _firm(self, hard: TaskStack, scaled: TaskStack) -> tuple[bool, bool]:
        """Decide hard and scaled tasks; which of them are relaxed."""
        J_h, w_h = self._moved(hard.J), hard.wanted.astype(LONG)
        J_k, ways = self._moved(scaled.J), _ways(scaled)
        rows, sides = _exact(J_h, w_h, J_k, ways)
        best = np.ones(ways.shape[1], LONG)
        d = self._damping.base + (self._pulled(scaled) if scaled.tasks else 0.0)
        v, lacks = self._hard(hard, J_h, w_h)
        near, shares = v, best
        slow = leaves = min(float(np.sqrt(lacks @ lacks)) / SLOW, 1.0)
        if scaled.tasks and leaves < 1.0:
            sides[: len(w_h)] = J_h @ v
            aside = np.concatenate([0.0 * w_h, J_k @ v])
            aside *= SLOW / min(max(np.sqrt(aside @ aside), MET), SLOW)
            rows, best = np.hstack([rows, -aside[:, None]]), np.append(best, -LONG(ASIDE))
            v, shares = self._shares(rows, sides, best, d)
            t = float(shares[-1])
            shares, leaves = shares[:-1], max(leaves, t if t > EXCESS else 0.0)
            leaves = max(leaves, self._overreaches(scaled, J_k, v))
        self._v = v
        if scaled.tasks and (leaves > 0.0 or shares.min() < WHOLE):
            leaves = self._leave(scaled, J_k, shares, leaves, (J_h, v + LONG(slow) * (near - v)))
        self._keep(np.vstack([J_h, J_k]), np.concatenate([J_h @ self._v, J_k @ self._v]))
        relaxed = _counting(J_h @ self._v - w_h) > 0.0
        return relaxed, bool(scaled.tasks) and leaves > 0.0

    def _hard(self, tasks: TaskStack, J: Array, w: Array) -> tuple[Array, Array]:
        """The motion of hard tasks, and what it lacks."""
        least = self._damping.base * (LESS * float(tasks.weights.max()) if tasks.tasks else 1.0)
        v = near = self._nearest(J, w, tasks.weights, least)
        missed, exact, counts = J @ v - w, v, 1.0
        size = float(np.sqrt(missed @ missed))
        if tasks.tasks and size < SLOW and self._can_hold(J, w):
            exact = self._shares(J, w, np.zeros(0, LONG), self._damping.base)[0]
            counts = min(max(self._at_limits(exact), 2.0 * size / SLOW - 1.0), 1.0)
            counts = _counting(missed) * counts
        pulls = counts * _counting(missed) * np.abs(missed)

        def damped() -> Array:
            d = self._damping.of(
                float(tasks.weights @ (pulls * tasks.curvature_bounds)), self._state
            )
            return self._nearest(J, w, tasks.weights, least + d)

        if counts > 0.0:
            near = damped()
        v = exact + LONG(counts) * (near - exact)
        softens = self._overreaches(tasks, J, v)
        if softens > 0.0:
            pulls += softens * np.abs(w)
            v = v + LONG(softens) * (damped() - v)
        missed = J @ v - w
        return v, _counting(missed) * missed

    def _overreaches(self, tasks: TaskStack, J: Array, v: Array) -> float:
        """How far rows are softened that see J v of a motion."""
        return self._damping.overreaches(
            tasks.curvature_bounds, (J @ v).astype(float), v.astype(float)
        )

    def _at_limits(self, v: Array) -> float:
        """How near an exact motion v is to a limit, from 0 at NEAR to 1 at it."""
        sizes = np.sqrt((self._G * self._G).sum(axis=1))
        margin = (self._h - self._G @ v) / np.maximum(sizes, LONG(IDLE))
        return min(max(1.0 - float(margin.min(initial=NEAR)) / NEAR, 0.0), 1.0)

    def _leave(
        self, tasks: TaskStack, J: Array, shares: Array, leaves: float, beside: tuple[Array, Array]
    ) -> float:
        """Mix the motion so far with the nearest to scaled tasks; how far they leave their ways.

        Args:
            tasks: these.
            J: their rows.
            shares: that the motion so far has of what they want.
            leaves: how far they leave their directions at least.
            beside: rows of hard tasks, and the motion that the nearest keeps of them.
        """
        v, kept = self._v, (self._C, self._c, self._decided)
        self._v = beside[1]
        self._keep(beside[0], beside[0] @ self._v)
        near = self._improved(tasks, J, float(self._state.memory["scaled pull"][0]))
        self._C, self._c, self._decided = kept
        if leaves < 1.0:
            parts = zip(shares.astype(float), tasks.slices, strict=True)
            done = (J @ near).astype(float)
            blocks = [blocked(float(s), tasks.wanted[part], done[part]) for s, part in parts]
            leaves = max(leaves, *blocks)
        self._v = v + LONG(leaves) * (near - v)
        return leaves

    def _improved(self, tasks: TaskStack, J: Array, pull: float) -> Array:
        """The nearest to what a level wants, from what those before it have decided.

        Args:
            tasks: of the level.
            J: its rows.
            pull: at the rows decided before it, in the last tick.
        """
        d = self._damping.base + self._damping.of_tasks(tasks, self._state)
        needed = self._damping.of(pull, self._state)
        share = MOST_DAMPING / max(needed, MOST_DAMPING)  # of the step that is made
        wanted = tasks.wanted.astype(LONG)
        v = self._nearest(J, wanted, tasks.weights, d + min(needed, MOST_DAMPING))
        return self._v + LONG(share) * (v - self._v)

    def _pulled(self, tasks: TaskStack) -> float:
        """Damping of scaled tasks for what their shares lacked in the last tick."""
        curvatures, pull = tasks.curvatures(self._state.v), 0.0
        for part, lacked in zip(tasks.slices, self._state.memory["missing"], strict=True):
            rate = float(np.linalg.norm(tasks.wanted[part]))
            moves = min(rate / LEAST_SPEED, 1.0) / (rate**2 + LEAST_SPEED**2)
            pull += float(lacked * np.linalg.norm(curvatures[part])) * moves
        return min(self._damping.of(SCALE_WEIGHT * pull, self._state), MOST_DAMPING)

    def _can_hold(self, J: Array, w: Array) -> bool:
        """Whether J x = w can hold within all that is kept; x may have shares after v."""
        shares = J.shape[1] - self._n
        x = self._solve(np.vstack([J, np.sqrt(LONG(PROBE)) * np.eye(J.shape[1])]),
                        np.concatenate([w, np.zeros(J.shape[1])]), shares)  # fmt: skip
        missed = float(np.abs(J @ x - w).max())
        if HOLDS < missed < FAILS:
            raise UndeterminedError
        return missed <= HOLDS

    def _shares(self, rows: Array, sides: Array, best: Array, d: float) -> tuple[Array, Array]:
        """The v and the shares with rows [v; s] = sides, these as near as can be to the best."""
        n, shares = self._n, len(best)
        root = np.sqrt(LONG(SCALE_WEIGHT))
        M = np.diag(np.concatenate([np.full(n, np.sqrt(LONG(d))), np.full(shares, root)]))
        m = np.concatenate([np.zeros(n, LONG), root * best])
        x = self._solve(M, m, shares, rows, sides)
        return x[:n], x[n:]

    def _nearest(self, J: Array, w: Array, weights: Array, d: float) -> Array:
        """The v of least sum weight |J v - w|^2 + d |v|^2."""
        roots, root = np.sqrt(weights.astype(LONG)), np.sqrt(LONG(d))
        M = np.vstack([roots[:, None] * J, root * np.eye(self._n)])
        m = np.concatenate([roots * w, np.zeros(self._n)])
        v = self._solve(M, m, 0)
        if not self._jitter:
            return v
        sizes = np.abs(M).T @ (np.abs(M) @ np.abs(v) + np.abs(m))
        m[len(w) :] += self._digits(sizes.shape) * sizes / root
        return self._solve(M, m, 0)

    def _solve(
        self, M: Array, m: Array, shares: int, held: Array | None = None, sides: Array | None = None
    ) -> Array:
        """Least squares within all that is kept, with shares from 0 to 1, and more rows."""
        n, wide = self._n, self._n + shares
        C, c = _widened(self._C, shares), self._c
        if held is not None:
            C, c = _added(C, c, held, sides)
        ends = np.eye(wide)[n:]
        G = np.vstack([_widened(self._G, shares), ends, -ends])
        h = np.concatenate([self._h, np.ones(shares), np.zeros(shares)])
        program = Program(M, m, C.astype(LONG), c.astype(LONG), G.astype(LONG), h.astype(LONG))
        return solved(program, _active(program), EXCESS)

    def _keep(self, J: Array, w: Array) -> None:
        """Let later levels keep J v = w.

        Raises:
            UndeterminedError: the law would take a direction of the decided rows for noise.
        """
        self._C, self._c = _added(self._C, self._c, J, w)
        self._decided = np.vstack([self._decided, J])
        along = self._decided - (self._decided @ self._loops.T) @ self._loops
        values = np.linalg.svd(along.astype(float), compute_uv=False)
        if ((values > NOISE) & (values < RELEASED)).any():
            raise UndeterminedError

    def _stack(self, tasks: list[Task]) -> TaskStack:
        stack = TaskStack(tasks, self._start)
        stack.update(self._state)
        return stack

    def _moved(self, rows: Array) -> Array:
        return rows.astype(LONG) * (1.0 + self._digits(rows.shape))

    def _digits(self, shape: tuple[int, ...]) -> Array:
        """By what numbers move, relatively."""
        return self._jitter * np.finfo(float).eps * self._rng.uniform(-1.0, 1.0, shape)


def _counting(missed: Array) -> float:
    """How much counts of what hard tasks lack: none that still counts as met."""
    return min(max(float(np.abs(missed).max(initial=0.0)) / MET - 1.0, 0.0), 1.0)


def _ways(scaled: TaskStack) -> Array:
    """What each of the scaled tasks wants, in a column."""
    ways = np.zeros((len(scaled.wanted), len(scaled.slices)), LONG)
    for k, part in enumerate(scaled.slices):
        ways[part, k] = scaled.wanted[part]
    return ways


def _exact(J_h: Array, w_h: Array, J_k: Array, ways: Array) -> tuple[Array, Array]:
    """Rows over v and the shares that hard and scaled tasks want to hold together."""
    rows = np.block([[J_h, np.zeros((len(J_h), ways.shape[1]), LONG)], [J_k, -ways]])
    return rows, np.concatenate([w_h, np.zeros(len(J_k), LONG)])


def _levels(problem: ControlProblem) -> list[list[Task]]:
    """Soft tasks by priority, then the secondary objectives by theirs."""
    groups = []
    for tasks in ([t for t in problem.tasks if t.mode == "soft"], list(problem.secondary)):
        for priority in sorted({task.priority for task in tasks}):
            groups.append([task for task in tasks if task.priority == priority])
    return groups


def _active(program: Program) -> list[int]:
    """The limits that are active by quadprog, with a little margin so that some motion is left."""
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
