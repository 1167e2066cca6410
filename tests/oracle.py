"""What a tick's optimum is, in extended precision: who of two engines that differ is off.

The plain law's matrices of a tick are taken as they are, but P = J'WJ + dI is never formed:

    minimise |sqrt(W) (J v - wanted)|^2 + d |v|^2 + W_s |s - 1|^2    by a QR factorisation
    subject to the equality rows and the limits that are active

on numbers of 64 bits of mantissa. Which limits are active is settled here, from the answer's.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from coopqp.base.spec import Array
from coopqp.model.state import State
from coopqp.qp_law.bounds import Bounds
from coopqp.qp_law.equations import SCALE_WEIGHT
from coopqp.qp_law.law import QPLaw
from coopqp.qp_law.level import Level
from coopqp.qp_law.priorities import LaterLevel
from coopqp.solver import Status

LONG = np.longdouble
DEPENDENT, DOUBTFUL = 1e-12, 1e-5  # what is left of a row that depends on others, or nearly does
ROUNDS = 60
ACTIVE = 1e-7  # as near to a limit as that an answer is at it [rad/s]


class UndeterminedError(Exception):
    """The rows depend on each other, or nearly so, or no set of limits settles."""


@dataclass(frozen=True)
class Program:
    """Least squares |M x - m| with C x = c and G x <= h."""

    M: Array
    m: Array
    C: Array
    c: Array
    G: Array
    h: Array


def optimum(law: QPLaw, state: State, relaxed: bool) -> Array:
    """The velocity that the tick's levels have, one after the other, shape (n,).

    Args:
        law: after the tick.
        state: of it.
        relaxed: whether its hard tasks were not met in full.

    Raises:
        UndeterminedError: it is not determined, or scaled tasks were relaxed too.
    """
    n = len(state.q)
    if relaxed and law.order.scaled:
        raise UndeterminedError
    levels = [law.nearest.hard if relaxed else law.first, *law.later]
    decided, v = np.zeros((0, n)), np.zeros(n, LONG)
    for level in levels:
        if isinstance(level, Level):
            program, share, there = _first(level), 1.0, level.solution.v
        else:
            A = np.vstack([state.J_loop, decided])
            program, share, there = (
                _later(level, law.limit_recovery.bounds, A, v),
                level.share,
                level.v,
            )
        at_limits = np.flatnonzero(program.h - program.G @ there < ACTIVE).tolist()
        v = v + share * (solved(program, at_limits)[:n] - v)  # the step that is made
        decided = np.vstack([decided, *([law.exact.J] * (level is levels[0])), level.tasks.J])
    return v


def _first(level: Level) -> Program:
    qp = level.qp
    return _program(level, (qp.A, qp.b), (qp.lb, qp.ub, qp.G, qp.h))


def _later(level: LaterLevel, bounds: Bounds, A: Array, v: Array) -> Program:
    return _program(level, (A, A.astype(LONG) @ v), (bounds.lb, bounds.ub, bounds.G, bounds.h))


def _program(
    level: Level | LaterLevel, rows: tuple[Array, Array], limits: tuple[Array, Array, Array, Array]
) -> Program:
    tasks, (A, b), (lb, ub, G, h) = level.tasks, rows, limits
    n, all_of_it = tasks.J.shape[1], A.shape[1]
    roots = np.sqrt(tasks.weights.astype(LONG))
    M = np.zeros((len(roots) + all_of_it, all_of_it), LONG)
    m = np.zeros(len(M), LONG)
    M[: len(roots), :n] = roots[:, None] * tasks.J
    m[: len(roots)] = roots * tasks.wanted
    M[len(roots) :][range(n), range(n)] = np.sqrt(LONG(level.curvature))
    M[len(roots) + n :, n:] = np.sqrt(LONG(SCALE_WEIGHT)) * np.eye(all_of_it - n)
    m[len(roots) + n :] = np.sqrt(LONG(SCALE_WEIGHT))
    unit = np.eye(all_of_it)
    G, h = np.vstack([unit, -unit, G]), np.concatenate([ub, -lb, h])
    kept = np.isfinite(h)
    return Program(M, m, A.astype(LONG), b.astype(LONG), G[kept].astype(LONG), h[kept].astype(LONG))


def solved(program: Program, active: Sequence[int], excess: float = 1e-17) -> Array:
    """The optimum, by changes of the active set.

    Args:
        program: what is to be solved.
        active: limits with which the search begins; of those that depend on each other the first.
        excess: by which a limit may be exceeded [rad/s].

    Raises:
        UndeterminedError: rows nearly depend on each other, or no set of limits settles.
    """
    G, h, active = program.G, program.h, list(active)
    for _ in range(ROUNDS):
        active = _independent(program, active)
        x, z = _on(program, active)
        if len(z) and z.min() < 0.0:
            del active[int(np.argmin(z))]
            continue
        slack = h - G @ x
        slack[active] = 0.0
        worst = int(np.argmin(slack)) if len(slack) else -1
        if worst < 0 or slack[worst] >= -LONG(excess):
            return x
        active.append(worst)
    raise UndeterminedError


def _independent(program: Program, active: list[int]) -> list[int]:
    """Those of the active limits that the rows before leave something of."""
    kept: list[int] = []
    Q = _basis(program.C)
    for i in active:
        rest = _left_of(program.G[i], Q)
        if np.sqrt(rest @ rest) > ACTIVE:
            kept.append(i)
            Q = np.vstack([Q, rest / np.sqrt(rest @ rest)])
    return kept


def _left_of(row: Array, Q: Array) -> Array:
    for _ in range(2):
        row = row - (Q @ row) @ Q
    return row


def _basis(rows: Array) -> Array:
    """Orthonormal rows that span the same.

    Raises:
        UndeterminedError: a row nearly depends on others.
    """
    Q = np.zeros((0, rows.shape[1]), LONG)
    for row in rows:
        rest = _left_of(row, Q)
        size, whole = np.sqrt(rest @ rest), np.sqrt(row @ row)
        if DEPENDENT < size < DOUBTFUL * whole:
            raise UndeterminedError
        if size > DEPENDENT:
            Q = np.vstack([Q, rest / size])
    return Q


def _on(program: Program, active: list[int]) -> tuple[Array, Array]:
    """The optimum with some limits as equalities, and their multipliers."""
    rows = np.vstack([program.C, program.G[active]])
    sides = np.concatenate([program.c, program.h[active]])
    Q = _basis(rows)
    x = _least_squares(rows @ Q.T, sides) @ Q
    rest = [_left_of(unit, Q) for unit in np.eye(rows.shape[1], dtype=LONG)]
    Z = np.zeros((0, rows.shape[1]), LONG)
    for row in sorted(rest, key=lambda r: -float(r @ r)):
        left = _left_of(row, np.vstack([Q, Z]))
        size = np.sqrt(left @ left)
        if size > DOUBTFUL and len(Q) + len(Z) < rows.shape[1]:
            Z = np.vstack([Z, left / size])
    if len(Z):
        x = x + _least_squares(program.M @ Z.T, program.m - program.M @ x) @ Z
    g = program.M.T @ (program.M @ x - program.m)
    y = _least_squares(Q @ rows.T, -(Q @ g))
    return x, y[len(program.C) :]


def _least_squares(A: Array, b: Array) -> Array:
    """The x of a smallest |A x - b|, by orthogonalisation of A's columns, twice.

    Columns that depend on others get zero.
    """
    Q, kept = np.zeros((0, len(A)), LONG), []
    for j, column in enumerate(A.T):
        rest = _left_of(column, Q)
        size = np.sqrt(rest @ rest)
        if size > DEPENDENT:
            Q, kept = np.vstack([Q, rest / size]), [*kept, j]
    R, y, x = Q @ A[:, kept], Q @ b, np.zeros(A.shape[1], LONG)
    for i in range(len(kept) - 1, -1, -1):
        y[i] = (y[i] - R[i, i + 1 :] @ y[i + 1 :]) / R[i, i]
    x[kept] = y
    return x


def plainly(causes: tuple[Status, ...]) -> bool | None:
    """Whether a tick relaxed its hard tasks; None where more was done than to solve its levels."""
    return {(Status.OPTIMAL,): False, (Status.TASKS_RELAXED,): True}.get(causes)
