"""Why a tick could not do what its tasks asked, by name.

A tick is kept as its QP with the names of all rows. Three things are told of it:

* task rows that the loops alone rule out, and tasks that ask for motions which rule each other out,
* the limits at their bound now that hold the tasks back, by force
  (:mod:`coopqp.study.explanation.shares`),
* the smallest relaxation, in the sum of what each limit would have to give, with which loops and
  tasks can all hold in this tick, by an open solver (HiGHS):

    minimise    sum r
    subject to  J_c v = b,   J_task v = wanted,   lb - r <= v <= ub + r,   G v <= h + r,   r >= 0

What it names and is not at its bound now would come next. It is of one tick, a twentieth of the way
or less; what would do in all is said of the whole run (:mod:`coopqp.study.explanation.whole`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import linprog

from coopqp.checked import Array
from coopqp.qp import QP
from coopqp.rank import null_space
from coopqp.row import Row, names_of
from coopqp.solver import HALTS, Status, causes_of
from coopqp.study.explanation.contradiction import irreducible
from coopqp.study.explanation.shares import Share, forces, shares, thing_of
from coopqp.study.explanation.words import listed, with_note
from coopqp.study.tick_record import TickRecord

#: A relaxation below this is nothing [rad/s, m/s].
NOTHING = 1e-7

#: A task row is missed by more than this [rad/s, m/s], and by more than a share of what is wanted:
#: the damping holds ordinary ticks back by some percent of it.
MISSED, MISSED_SHARE = 1e-4, 0.02

#: Task rows that the loops leave less than this share of are impossible, not merely blocked.
IMPOSSIBLE = 1e-7

#: A velocity this near to its bound is at it [rad/s, m/s].
AT_BOUND = 1e-6

#: Ticks that end so have an answer that says something of limits and tasks.
CONFLICTS = (Status.INFEASIBLE, Status.LOOP_BUDGET)


@dataclass(frozen=True)
class Relaxation:
    """What one limit would have to give.

    Attributes:
        name: of the limit's row.
        amount: for this tick; ``unit`` says of what.
        unit: of amount: limits of place in rad or m, the others per second.
        words: what a sentence calls it.
        now: whether it is at its bound in this tick; the others would come next.
    """

    name: str
    amount: float
    unit: str
    words: str = ""
    now: bool = True


@dataclass(frozen=True)
class Explanation:
    """Why a tick could not do what its tasks asked.

    Attributes:
        missed: task rows that the answer misses.
        impossible: those that the loops alone rule out, whatever the limits.
        relaxations: the smallest that would let all others hold; empty when nothing is missed.
        sentence: the same in words.
        contradicting: names of tasks that ask for motions which rule each other out.
        holding: limits at their bound now that hold back, the most forceful first.
    """

    missed: tuple[str, ...]
    impossible: tuple[str, ...]
    relaxations: tuple[Relaxation, ...]
    sentence: str
    contradicting: tuple[str, ...] = ()
    holding: tuple[str, ...] = ()


def explain(record: TickRecord) -> Explanation:
    """Why, as far as one tick can tell."""
    causes = causes_of(record.status)
    if halts := [cause for cause in causes if cause in HALTS]:
        return Explanation((), (), (), f"the law was not asked; the loop {halts[0].value}")
    status = causes[0]
    if not status.usable and status not in CONFLICTS:
        return Explanation((), (), (), f"the tick stands still: {status.value}")
    qp, J = record.qp(), np.array(record.J).reshape(-1, len(record.variables))
    wanted, names = np.array(record.wanted), names_of(record.task_rows)
    gap = np.abs(J @ np.array(record.answer) - wanted)
    allowed = MISSED + MISSED_SHARE * np.abs(wanted)
    missed = tuple(name for name, g, a in zip(names, gap, allowed, strict=True) if g > a)
    if not missed:
        return Explanation((), (), (), "nothing was in the way: every task row was met")
    rows = _Rows(record, _loops(record, qp), J)
    impossible = tuple(names[i] for i in rows.impossible)
    against = rows.contradicting(wanted, allowed)
    answer = None if against else _relax(record, qp, J[rows.kept], wanted[rows.kept])
    relaxations = _named(record, qp, answer) if answer is not None else ()
    held = () if against else _holding(record, qp, J, wanted)
    found = Explanation(
        missed, impossible, relaxations, "", against, tuple(s.row.name for s in held)
    )
    along = [name for name in missed if name not in impossible]
    sentence = _sentence(found, along, held, relaxed=answer is not None)
    return Explanation(missed, impossible, relaxations, sentence, against, found.holding)


def at_bound(record: TickRecord) -> tuple[Row, ...]:
    """The limits that the answer is at, each side of a joint and each thing in space once."""
    at = _slack(record, record.qp()) < AT_BOUND
    rows = [row for row, now in zip(_limit_rows(record), at, strict=True) if now]
    return tuple({thing_of(row): row for row in rows}.values())


class _Rows:
    """Which task rows the loops leave, and which only repeat or contradict others.

    Attributes:
        kept: rows that loops and rows before them leave open.
        impossible: rows that loops and other rows of the same task rule out.
    """

    def __init__(self, record: TickRecord, loops: tuple[Array, Array], J: Array) -> None:
        self._owners = [row.owner for row in record.task_rows]
        self._loops, self._J = loops, J
        self.kept: list[int] = []
        self.impossible: list[int] = []
        own: list[int] = []
        for i, owner in enumerate(self._owners):
            own = [k for k in own if self._owners[k] == owner]
            if not self._open(i, own):
                self.impossible.append(i)
                continue
            own.append(i)
            if self._open(i, self.kept):
                self.kept.append(i)

    def _open(self, i: int, others: Sequence[int]) -> bool:
        """Whether loops and other rows leave row i a motion."""
        rows, row = [*self._loops[0], *self._J[list(others)]], self._J[i]
        basis = np.linalg.qr(np.array(rows).T)[0] if rows else np.zeros((len(row), 0))
        left = row - basis @ (basis.T @ row)
        return bool(np.linalg.norm(left) > IMPOSSIBLE * max(float(np.linalg.norm(row)), 1e-12))

    def contradicting(self, wanted: Array, allowed: Array) -> tuple[str, ...]:
        """Tasks that cannot hold together, limits or not; none where they can."""
        possible = [i for i in range(len(wanted)) if i not in self.impossible]
        owners = tuple(dict.fromkeys(self._owners[i] for i in possible))
        A, b = self._loops

        def fails(some: tuple[str, ...]) -> bool:
            chosen = [i for i in possible if self._owners[i] in some]
            M = np.vstack([A, self._J[chosen]])
            r = np.concatenate([b, wanted[chosen]])
            off = M @ np.linalg.lstsq(M, r, rcond=IMPOSSIBLE)[0] - r
            return bool((np.abs(off[len(b) :]) > allowed[chosen]).any())

        found = irreducible(owners, fails) if fails(owners) else ()
        return found if len(found) > 1 else ()


def _loops(record: TickRecord, qp: QP) -> tuple[Array, Array]:
    """The loop rows alone; hard and scaled tasks are tasks here."""
    kept = [i for i, row in enumerate(record.equality_rows) if row.kind == "loop"]
    return qp.A[kept], qp.b[kept]


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


def _named(record: TickRecord, qp: QP, r: Array) -> tuple[Relaxation, ...]:
    at = _slack(record, qp) < AT_BOUND
    found = [
        Relaxation(
            row.name,
            float(amount) * (record.dt if row.of_place else 1.0),
            row.unit,
            row.words,
            bool(now),
        )
        for row, amount, now in zip(_limit_rows(record), r, at, strict=True)
        if amount > NOTHING
    ]
    return tuple(sorted(found, key=lambda relaxation: -relaxation.amount))


def _limit_rows(record: TickRecord) -> list[Row]:
    return [*record.lb_rows, *record.ub_rows, *record.inequality_rows]


def _slack(record: TickRecord, qp: QP) -> Array:
    """What the answer leaves of lb, ub and h."""
    v = np.array(record.answer)
    return np.concatenate([v - qp.lb, qp.ub - v, qp.h - qp.G @ v])


def _holding(record: TickRecord, qp: QP, J: Array, wanted: Array) -> tuple[Share, ...]:
    """Limits at their bound that hold the missed motion back."""
    n, v = qp.n, np.array(record.answer)
    Z = null_space(_loops(record, qp)[0])
    pull = Z.T @ J.T @ (wanted - J @ v)
    ways = np.vstack([-np.eye(n), np.eye(n), qp.G])
    at = np.flatnonzero(_slack(record, qp) < AT_BOUND)
    rows = _limit_rows(record)
    within = [(rows[i], Z.T @ ways[i]) for i in at]
    within = [(row, way) for row, way in within if np.linalg.norm(way) > 1e-9]
    return shares([row for row, _ in within], forces(pull, [way for _, way in within]))


def _sentence(
    found: Explanation, along: Sequence[str], held: Sequence[Share], *, relaxed: bool
) -> str:
    said = []
    if found.impossible:
        said.append(f"the loops alone leave no motion along {listed(found.impossible)}")
    if found.contradicting:
        said.append(f"{listed(found.contradicting)} ask for motions that rule each other out")
    elif along and found.relaxations:
        more = {r.name: r for r in found.relaxations}
        now = [_with_amount(share.row.words, more.get(share.row.name)) for share in held]
        now = now or [_with_amount(r.words, r) for r in found.relaxations if r.now]
        coming = [r.words for r in found.relaxations if not r.now]
        who = listed(["the loop", *now])
        said.append(f"{who} leave{'' if now else 's'} no more motion along {listed(along)}")
        if coming:
            said.append(f"next would come {listed(coming)}")
    elif along and not relaxed:
        said.append(f"no relaxation of the limits makes {listed(along)} possible")
    elif along:
        said.append(f"{listed(along)} could be met; damping, weights or a later level gave it up")
    return "; ".join(said)


def _with_amount(words: str, relaxation: Relaxation | None) -> str:
    """A limit, with what it lacks where that is a speed."""
    if relaxation is None or not relaxation.unit.endswith(("/s", "/s2")):
        return words
    lacks = f"{relaxation.amount:.3g} {relaxation.unit} short"
    return with_note(Row(name=words, kind="limit"), lacks)
