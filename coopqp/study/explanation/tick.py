"""Why a tick could not do what its tasks asked, by name, with an open solver (HiGHS).

A tick is kept as its QP with the names of all rows. The explanation is the smallest relaxation, in
the sum of what each limit would have to give, with which loops and tasks can all hold:

    minimise    sum r
    subject to  J_c v = b,   J_task v = wanted,   lb - r <= v <= ub + r,   G v <= h + r,   r >= 0
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from scipy.optimize import linprog

from coopqp.checked import Array
from coopqp.qp import QP
from coopqp.row import names_of
from coopqp.solver import Solution, Solver, Status, Verifier
from coopqp.study.tick_record import TickRecord

#: A relaxation below this is nothing [rad/s, m/s].
NOTHING = 1e-7

#: A task row is missed by more than this [rad/s, m/s], and by more than a share of what is wanted:
#: the damping holds ordinary ticks back by some percent of it.
MISSED, MISSED_SHARE = 1e-4, 0.02

#: Task rows that the loops leave less than this share of are impossible, not merely blocked.
IMPOSSIBLE = 1e-7


@dataclass(frozen=True)
class Relaxation:
    """What one limit would have to give.

    Attributes:
        name: of the limit's row.
        amount: for this tick; ``unit`` says of what.
        unit: of amount: position limits in rad or m, the others per second.
    """

    name: str
    amount: float
    unit: str


@dataclass(frozen=True)
class Explanation:
    """Why a tick could not do what its tasks asked.

    Attributes:
        missed: task rows that the answer misses.
        impossible: those that the loops alone rule out, whatever the limits.
        relaxations: the smallest that would let all others hold; empty when nothing is missed.
        sentence: the same in words.
    """

    missed: tuple[str, ...]
    impossible: tuple[str, ...]
    relaxations: tuple[Relaxation, ...]
    sentence: str


def explain(record: TickRecord) -> Explanation:
    """The smallest relaxation of the limits that would let loops and tasks hold."""
    qp, J = record.qp(), np.array(record.J).reshape(-1, len(record.variables))
    wanted, names = np.array(record.wanted), names_of(record.task_rows)
    gap = np.abs(J @ np.array(record.answer) - wanted)
    allowed = MISSED + MISSED_SHARE * np.abs(wanted)
    missed = tuple(name for name, g, a in zip(names, gap, allowed, strict=True) if g > a)
    if not missed:
        return Explanation((), (), (), "nothing was in the way: every task row was met")
    possible = _possible_rows(_loops(record, qp), J)
    impossible = tuple(name for i, name in enumerate(names) if i not in possible)
    answer = _relax(record, qp, J[possible], wanted[possible])
    relaxations = _named(record, answer) if answer is not None else ()
    return Explanation(
        missed, impossible, relaxations, _sentence(missed, impossible, relaxations, answer)
    )


def _loops(record: TickRecord, qp: QP) -> tuple[Array, Array]:
    """The loop rows alone; hard and scaled tasks are tasks here."""
    kept = [i for i, row in enumerate(record.equality_rows) if row.kind == "loop"]
    return qp.A[kept], qp.b[kept]


def _possible_rows(loops: tuple[Array, Array], J: Array) -> list[int]:
    """Task rows that loops leave open, and that no earlier row decides already."""
    rows, kept = list(loops[0]), []
    for i, row in enumerate(J):
        basis = np.linalg.qr(np.array(rows).T)[0] if rows else np.zeros((len(row), 0))
        left = row - basis @ (basis.T @ row)
        if np.linalg.norm(left) > IMPOSSIBLE * max(float(np.linalg.norm(row)), 1e-12):
            rows.append(row)
            kept.append(i)
    return kept


def _relax(record: TickRecord, qp: QP, J: Array, wanted: Array) -> Array | None:
    """R of [lb; ub; h], or None when no relaxation helps."""
    n, p = qp.n, qp.p
    A, b = _loops(record, qp)
    equal = np.vstack([A, J])
    zeros = np.zeros((len(equal), 2 * n + p))
    eye, none = np.eye(n), np.zeros((n, n))
    rows = [
        np.hstack([-eye, -eye, none, np.zeros((n, p))]),
        np.hstack([eye, none, -eye, np.zeros((n, p))]),
        np.hstack([qp.G, np.zeros((p, 2 * n)), -np.eye(p)]),
    ]
    bounded = np.concatenate([-qp.lb, qp.ub, qp.h])
    kept = np.isfinite(bounded)
    result = linprog(
        np.concatenate([np.zeros(n), np.ones(2 * n + p)]),
        A_ub=np.vstack(rows)[kept],
        b_ub=bounded[kept],
        A_eq=np.hstack([equal, zeros]),
        b_eq=np.concatenate([b, wanted]),
        bounds=[(None, None)] * n + [(0.0, None)] * (2 * n + p),
    )
    return np.asarray(result.x[n:], float) if result.success else None


def _named(record: TickRecord, r: Array) -> tuple[Relaxation, ...]:
    rows = [*record.lb_rows, *record.ub_rows, *record.inequality_rows]
    found = [
        Relaxation(row.name, float(amount) * (record.dt if row.of_place else 1.0), row.unit)
        for row, amount in zip(rows, r, strict=True)
        if amount > NOTHING
    ]
    return tuple(sorted(found, key=lambda relaxation: -relaxation.amount))


def _sentence(
    missed: Sequence[str],
    impossible: Sequence[str],
    relaxations: Sequence[Relaxation],
    answer: Array | None,
) -> str:
    along = _listed([name for name in missed if name not in impossible])
    said = []
    if impossible:
        said.append(f"the loops alone leave no motion along {_listed(impossible)}")
    if along and relaxations:
        blocks = _listed([relaxation.name for relaxation in relaxations])
        more = _listed([f"{r.amount:.3g} {r.unit} more" for r in relaxations])
        said.append(f"the loop and {blocks} leave no motion along {along}; {more} would do")
    elif along and answer is None:
        said.append(f"no relaxation of the limits makes {along} possible")
    elif along:
        said.append(f"{along} could be met; damping, weights or a later level gave it up")
    return "; ".join(said)


def _listed(names: Sequence[str]) -> str:
    if len(names) < 2:
        return "".join(names)
    return f"{', '.join(names[:-1])} and {names[-1]}"
