"""Why a tick could not do what its tasks asked, by name.

A tick is kept as its QP with the names of all rows. Four things are told of it:

* hard and scaled tasks that are not met in full, with the share of their rate that they get; where
  there are any the rest is told of them alone, and not of what comes after them,
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
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from coopqp.checked import Array
from coopqp.row import Row, names_of
from coopqp.solver import HALTS, Budget, Status
from coopqp.study.explanation.asked import Asked, asked_then
from coopqp.study.explanation.contradiction import contradicting
from coopqp.study.explanation.shares import Share, shares, thing_of
from coopqp.study.explanation.unmet import Unmet, part_of_rate
from coopqp.study.explanation.words import listed, with_note
from coopqp.study.tick_record import TickRecord

Mask = NDArray[np.bool_]

#: A relaxation below this is nothing [rad/s, m/s].
NOTHING = 1e-7

#: A task row is missed by more than this [rad/s, m/s], and by more than a share of what is wanted:
#: the damping holds ordinary ticks back by some percent of it.
MISSED, MISSED_SHARE = 1e-4, 0.02

#: Rows of a hard task are missed by more than this [rad/s, m/s].
HELD = Budget().equality

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
        unmet: hard and scaled tasks that are not met in full.
    """

    missed: tuple[str, ...]
    impossible: tuple[str, ...]
    relaxations: tuple[Relaxation, ...]
    sentence: str
    contradicting: tuple[str, ...] = ()
    holding: tuple[str, ...] = ()
    unmet: tuple[Unmet, ...] = ()


def explain(record: TickRecord) -> Explanation:
    """Why, as far as one tick can tell."""
    return explain_asked(asked_then(record))


def explain_asked(tick: Asked) -> Explanation:
    """The same of a tick that nobody kept."""
    causes = tick.causes
    if halts := [cause for cause in causes if cause in HALTS]:
        return Explanation((), (), (), f"the law was not asked; the loop {halts[0].value}")
    status = causes[0]
    if not status.usable and status not in CONFLICTS:
        return Explanation((), (), (), f"the tick stands still: {status.value}")
    allowed = _allowed(tick)
    over = np.abs(tick.J @ tick.v - tick.wanted) > allowed
    missed = tuple(row.name for row, o in zip(tick.task_rows, over, strict=True) if o)
    if not missed:
        return Explanation((), (), (), "nothing was in the way: every task row was met")
    unmet = _unmet(tick, over)
    first = _until_missed(tick, over)
    tick, allowed, over = _with_rows(tick, first), allowed[first], over[first]
    J, wanted, names = tick.J, tick.wanted, names_of(tick.task_rows)
    rows = _Rows(tick)
    impossible = tuple(names[i] for i in rows.impossible)
    against = rows.contradicting(wanted, allowed)
    answer = None if against else _relax(tick, J[rows.kept], wanted[rows.kept])
    relaxations = _named(tick, answer) if answer is not None else ()
    held = () if against else shares(tick.forces(AT_BOUND))
    found = Explanation(
        missed, impossible, relaxations, "", against, tuple(s.row.name for s in held), unmet
    )
    along = [names[i] for i in np.flatnonzero(over) if names[i] not in impossible]
    return replace(found, sentence=_sentence(found, along, held, relaxed=answer is not None))


def at_bound(record: TickRecord) -> tuple[Row, ...]:
    """The limits that the answer is at, each side of a joint and each thing in space once."""
    tick = asked_then(record)
    return tuple({thing_of(row): row for row, _ in tick.at_limits(AT_BOUND)}.values())


def _allowed(tick: Asked) -> Array:
    """What each task row may be off by and count as met."""
    exact = {"hard", "scaled"} if Status.TASKS_RELAXED in tick.causes else {"hard"}
    firm = [tick.modes[row.owner] in exact for row in tick.task_rows]
    return np.where(firm, HELD, MISSED + MISSED_SHARE * np.abs(tick.wanted))


def _unmet(tick: Asked, over: Mask) -> tuple[Unmet, ...]:
    """Hard tasks that miss rows, then scaled ones, each with the share of its rate."""
    owners, got = np.array([row.owner for row in tick.task_rows]), tick.J @ tick.v
    return tuple(
        Unmet(name, mode, part_of_rate(got[owners == name], tick.wanted[owners == name]))
        for mode in ("hard", "scaled")
        for name in dict.fromkeys(owners[over].tolist())
        if tick.modes[name] == mode
    )


def _until_missed(tick: Asked, over: Mask) -> list[int]:
    """Task rows up to the first of hard, scaled and soft that misses any: later ones give way."""
    modes = [tick.modes[row.owner] for row in tick.task_rows]
    missing = {mode for mode, o in zip(modes, over, strict=True) if o}
    order = ("hard", "scaled", "soft")
    heeded = order[: 1 + min(map(order.index, missing))]
    return [i for i, mode in enumerate(modes) if mode in heeded]


def _with_rows(tick: Asked, kept: Sequence[int]) -> Asked:
    rows = [tick.task_rows[i] for i in kept]
    return replace(tick, J=tick.J[kept], wanted=tick.wanted[kept], task_rows=rows)


class _Rows:
    """Which task rows the loops leave, and which only repeat or contradict others.

    Attributes:
        kept: rows that loops and rows before them leave open.
        impossible: rows that loops and other rows of the same task rule out.
    """

    def __init__(self, tick: Asked) -> None:
        self._owners = [row.owner for row in tick.task_rows]
        self._loops, self._J = (tick.A, tick.b), tick.J
        self.kept: list[int] = []
        self.impossible: list[int] = []
        own = kept = loops = np.linalg.qr(tick.A.T)[0].T
        for i, row in enumerate(tick.J):
            if i and self._owners[i] != self._owners[i - 1]:
                own = loops
            more = _spanned(own, row)
            if more is None:
                self.impossible.append(i)
                continue
            own, more = more, _spanned(kept, row)
            if more is not None:
                self.kept.append(i)
                kept = more

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

        return contradicting(owners, fails)


def _spanned(basis: Array, row: Array) -> Array | None:
    """Orthonormal rows that span one more; None where that is spanned already."""
    left = row - basis.T @ (basis @ row)
    left -= basis.T @ (basis @ left)  # what rounding has left
    size = float(np.linalg.norm(left))
    if not size > IMPOSSIBLE * max(float(np.linalg.norm(row)), 1e-12):
        return None
    return np.vstack([basis, left / size])


def _relax(tick: Asked, J: Array, wanted: Array) -> Array | None:
    """R of [lb; ub; h], or None when no relaxation helps."""
    from scipy.optimize import linprog  # which takes a sixth of a second to come

    n, p = len(tick.v), len(tick.h)
    equal = np.vstack([tick.A, J])
    zeros = np.zeros((len(equal), 2 * n + p))
    eye, none = np.eye(n), np.zeros((n, n))
    rows = [
        np.hstack([-eye, -eye, none, np.zeros((n, p))]),
        np.hstack([eye, none, -eye, np.zeros((n, p))]),
        np.hstack([tick.G, np.zeros((p, 2 * n)), -np.eye(p)]),
    ]
    bounded = np.concatenate([-tick.lb, tick.ub, tick.h])
    kept = np.isfinite(bounded)
    result = linprog(
        np.concatenate([np.zeros(n), np.ones(2 * n + p)]),
        A_ub=np.vstack(rows)[kept],
        b_ub=bounded[kept],
        A_eq=np.hstack([equal, zeros]),
        b_eq=np.concatenate([tick.b, wanted]),
        bounds=[(None, None)] * n + [(0.0, None)] * (2 * n + p),
    )
    return np.asarray(result.x[n:], float) if result.success else None


def _named(tick: Asked, r: Array) -> tuple[Relaxation, ...]:
    if not (r > NOTHING).any():
        return ()
    at = tick.slack < AT_BOUND
    found = [
        Relaxation(
            row.name,
            float(amount) * (tick.dt if row.of_place else 1.0),
            row.unit,
            row.words,
            bool(now),
        )
        for row, amount, now in zip(tick.limit_rows, r, at, strict=True)
        if amount > NOTHING
    ]
    return tuple(sorted(found, key=lambda relaxation: -relaxation.amount))


def _sentence(
    found: Explanation, along: Sequence[str], held: Sequence[Share], *, relaxed: bool
) -> str:
    said = [f"{task.words} gets {task.percent} of its rate" for task in found.unmet]
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
        other = " or the least squares of its rows" if found.unmet else ", weights or a later level"
        said.append(f"{listed(along)} could be met; damping{other} gave it up")
    return "; ".join(said)


def _with_amount(words: str, relaxation: Relaxation | None) -> str:
    """A limit, with what it lacks where that is a speed."""
    if relaxation is None or not relaxation.unit.endswith(("/s", "/s2")):
        return words
    lacks = f"{relaxation.amount:.3g} {relaxation.unit} short"
    return with_note(Row(name=words, kind="limit"), lacks)
