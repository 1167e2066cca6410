"""One tick: its rows and answer, what held it back, and why it could not do what tasks asked.

In ticks in which the tasks were not followed, multipliers tell what held them back:

    minimise |Z' (J' W (wanted - J v) - sum mu_i n_i)|,   mu_i >= 0

with n_i the limits active in that tick, Z the motions that keep the loops closed. Of a run the
shares mu_i |Z' n_i| are summed over the ticks, each by |J v - wanted|.

A task that wants the rate w and gets u = J v gets the share 1 - |u - w| / max(|w|, |u - w|) of it,
that is s where u = s w.

An explanation of a tick, which is its QP with the names of all rows, has

* hard and scaled tasks that are not met in full, with the share of their rate that they get; where
  there are any, the rest is about them alone, not about later levels,
* task rows that the loops alone rule out, and tasks that ask for motions which rule each other out,
* active limits that hold the tasks back, by force,
* the relaxation of limits with the smallest sum, with which loops and tasks can all hold in this
  tick, by an open solver (HiGHS):

    minimise    sum r
    subject to  J_c v = b,   J_task v = wanted,   lb - r <= v <= ub + r,   G v <= h + r,   r >= 0

Limits in it that are not active now would come next. It is of one tick, a twentieth of the way or
less; :mod:`coopqp.study.explanation.whole` has what would do in all.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from coopqp.assessment.thresholds import AT_LIMIT
from coopqp.base.qp import Row, names_of
from coopqp.base.rank import null_space
from coopqp.base.spec import Array
from coopqp.model.state import State
from coopqp.qp_law.safety import drift_gain
from coopqp.solver import HALTS, Budget, Status, causes_of
from coopqp.study.explanation.diagnosis import contradicting
from coopqp.study.explanation.explained_phase import ExplainedPhase
from coopqp.study.explanation.goal import PLACE_UNITS, Share, forces, shares, thing_of
from coopqp.study.explanation.words import Relaxed, listed, percent, with_note
from coopqp.study.tick_record import NamedBounds, TickRecord
from coopqp.task import Mode, TaskStack

#: Number of ticks of a run that are evaluated at most; error from which one counts [m/s, rad/s].
TICKS, BEHIND = 150, 1e-3
#: A task that lacks more than this share of its rate counts, as does the one that lacks most.
WORTH_COUNTING = 0.02


@dataclass(frozen=True, kw_only=True)
class Asked:
    """A tick without its solver's program.

    Attributes:
        A, b: rows of the closed loops, A v = b.
        lb, ub, G, h: the limits, lb <= v <= ub and G v <= h.
        J, wanted, task_rows: rows of all tasks, J v = wanted.
        modes: soft, hard or scaled, by the task's name.
        v: the answer, followed by shares of scaled tasks if there are any.
        limit_rows: the limits that lb, ub and h come from, in this order.
    """

    causes: tuple[Status, ...]
    dt: float
    A: Array
    b: Array
    lb: Array
    ub: Array
    G: Array
    h: Array
    J: Array
    wanted: Array
    task_rows: Sequence[Row]
    modes: Mapping[str, Mode]
    v: Array
    limit_rows: Sequence[Row]

    @cached_property
    def slack(self) -> Array:
        """Slack of lb, ub and h at the answer."""
        return np.concatenate([self.v - self.lb, self.ub - self.v, self.h - self.G @ self.v])

    def at_limits(self, near: float) -> list[tuple[Row, Array]]:
        """Limits with less slack than ``near``, each with the joint motion that violates it."""
        eye = np.eye(len(self.v))
        ways = np.vstack([-eye, eye, self.G])
        at = np.flatnonzero(self.slack < near).tolist()
        return [(self.limit_rows[i], ways[i]) for i in at]

    def forces(self, near: float, weights: Array | float = 1.0) -> list[tuple[Row, float]]:
        """Forces, :func:`forces`, of the limits with less slack than ``near``."""
        Z, missed = null_space(self.A), self.wanted - self.J @ self.v
        return forces(Z.T @ self.J.T @ (weights * missed), Z, self.at_limits(near))


def asked_then(record: TickRecord) -> Asked:
    """Of a saved tick; hard and scaled tasks are tasks here."""
    qp = record.qp()
    loops = [i for i, row in enumerate(record.equality_rows) if row.kind == "loop"]
    return Asked(
        causes=causes_of(record.status), dt=record.dt,
        A=qp.A[loops], b=qp.b[loops], lb=qp.lb, ub=qp.ub, G=qp.G, h=qp.h,
        J=np.array(record.J).reshape(-1, qp.n), wanted=np.array(record.wanted),
        task_rows=record.task_rows, modes=record.modes, v=np.array(record.answer),
        limit_rows=[*record.lb_rows, *record.ub_rows, *record.inequality_rows],
    )  # fmt: skip


class PhaseTicks:
    """The ticks of a phase whose law commands velocities, evaluated again one by one.

    ``state`` and ``stack`` of tasks are those of the last one.
    """

    def __init__(self, phase: ExplainedPhase) -> None:
        self._phase, problem = phase, phase.problem
        self.state = State(problem.chain)
        self.stack = TaskStack(problem.tasks, State(problem.chain))

    def look(self, k: int) -> Array:
        """Evaluate tick k; what its tasks missed, wanted - J v."""
        state, phase = self.state, self._phase
        state.q[:], state.t = phase.q[k], k * phase.problem.dt
        state.v[:] = phase.v[k - 1] if k else 0.0
        state.inputs = phase.followed(k)
        state.update()
        self.stack.update(state)
        return np.asarray(self.stack.wanted - self.stack.J @ phase.v[k], float)

    @cached_property
    def _limits(self) -> NamedBounds:
        return NamedBounds(self._phase.problem, self.state)

    def forces(self, k: int) -> list[tuple[Row, float]]:
        """What held tick k back, each limit with its force; their sum is what was missed."""
        missed, phase, limits = self.look(k), self._phase, self._limits
        if np.abs(missed).max(initial=0.0) <= BEHIND:
            return []
        limits.update(self.state)
        state, stack, problem = self.state, self.stack, phase.problem
        tick = Asked(
            causes=phase.causes[k], dt=problem.dt,
            A=state.J_loop, b=state.e_loop * -drift_gain(problem, state),
            lb=limits.lb, ub=limits.ub, G=limits.G, h=limits.h,
            J=stack.J, wanted=stack.wanted, task_rows=stack.rows,
            modes={task.name: task.mode for task in problem.tasks}, v=phase.v[k],
            limit_rows=limits.rows,
        )  # fmt: skip
        held = tick.forces(AT_LIMIT, self.stack.weights)
        total, size = sum(amount for _, amount in held), float(np.linalg.norm(missed))
        return [(row, amount / total * size) for row, amount in held if total > 0.0]


def held_up(phase: ExplainedPhase, ticks: range | None = None) -> tuple[Share, ...]:
    """Which limits slowed a run in some ticks or all, the largest share first."""
    look, ticks = PhaseTicks(phase), ticks or range(len(phase.v))
    some = ticks[:: max(1, len(ticks) // TICKS)]
    return shares(force for k in some for force in look.forces(k))


def speed_share(shares: Sequence[Share]) -> float:
    """Share of the limits of speeds and accelerations."""
    rates = (s for s in shares if not s.row.of_place and s.row.unit not in PLACE_UNITS)
    return sum(share.share for share in rates)


@dataclass(frozen=True)
class Unmet:
    """A hard or scaled task that gets only a share of its rate in a tick."""

    task: str
    mode: Mode
    share: float

    @property
    def words(self) -> str:
        return f"{self.mode} task '{self.task}'"


def part_of_rate(got: Array, wanted: Array) -> float:
    """The share of its rate that a task gets."""
    off, size = float(np.linalg.norm(got - wanted)), float(np.linalg.norm(wanted))
    return 1.0 - off / max(size, off, 1e-300)


def relaxed(explained_phases: Sequence[ExplainedPhase]) -> tuple[Relaxed, ...]:
    """Tasks not met in full in relaxed ticks, the most frequent first; none under torque laws."""
    modes: dict[str, Mode] = {}
    ticks, missing = Counter[str](), dict[str, float]()
    for phase in explained_phases:
        if phase.controller.commands_torques:
            break
        missing = {}
        modes |= {task.name: task.mode for task in phase.problem.tasks}
        for k, lacks in _lacks(phase):
            ticks.update(lacks.keys())
            missing = lacks if k == len(phase.v) - 1 else {}
    return tuple(
        Relaxed(task=name, mode=modes[name], ticks=count, missing=missing.get(name, 0.0))
        for name, count in ticks.most_common()
    )


def _lacks(phase: ExplainedPhase) -> Iterator[tuple[int, dict[str, float]]]:
    """Relaxed ticks of a phase, with the share that each task lacks."""
    look = PhaseTicks(phase)
    every = zip(phase.problem.tasks, look.stack.slices, strict=True)
    firm = [(task.name, rows) for task, rows in every if task.mode != "soft"]
    for k in (k for k, causes in enumerate(phase.causes) if Status.TASKS_RELAXED in causes):
        off, wanted = look.look(k), look.stack.wanted
        got = wanted - off
        lacks = {name: 1.0 - part_of_rate(got[rows], wanted[rows]) for name, rows in firm}
        least = min(max(lacks.values(), default=0.0), WORTH_COUNTING)
        yield k, {name: x for name, x in lacks.items() if x >= least > 0.0}


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
#: Causes of a tick whose answer says something of limits and tasks.
CONFLICTS = (Status.INFEASIBLE, Status.LOOP_BUDGET)


@dataclass(frozen=True)
class Relaxation:
    """By how much one limit would have to give.

    Attributes:
        name, words: of the limit's row; what a sentence calls it.
        amount: for this tick [``unit``]: position limits in rad or m, the others per second.
        now: whether it is active in this tick; the others would come next.
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
        contradicting: names of tasks that ask for motions which rule each other out.
        holding: active limits that hold back, the most forceful first.
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
    """Why a saved tick could not do what its tasks asked."""
    tick = asked_then(record)
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
    unmet, first = _unmet(tick, over), _until_missed(tick, over)
    task_rows = [tick.task_rows[i] for i in first]
    tick = replace(tick, J=tick.J[first], wanted=tick.wanted[first], task_rows=task_rows)
    rows, names, over = _Rows(tick), names_of(task_rows), over[first]
    impossible = tuple(names[i] for i in rows.impossible)
    against = rows.contradicting(allowed[first])
    answer = None if against else _relax(tick, rows.kept)
    held = () if against else shares(tick.forces(AT_BOUND))
    holding = tuple(share.row.name for share in held)
    found = Explanation(missed, impossible, answer or (), "", against, holding, unmet)
    along = [names[i] for i in np.flatnonzero(over) if names[i] not in impossible]
    return replace(found, sentence=_sentence(found, along, held, relaxed=answer is not None))


def at_bound(record: TickRecord) -> tuple[Row, ...]:
    """Active limits, each side of a joint and each limit in space once."""
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
    """Task rows up to the first mode, of hard, scaled and soft, that misses any."""
    modes = [tick.modes[row.owner] for row in tick.task_rows]
    missing = {mode for mode, o in zip(modes, over, strict=True) if o}
    order = ("hard", "scaled", "soft")
    first_modes = order[: 1 + min(map(order.index, missing))]
    return [i for i, mode in enumerate(modes) if mode in first_modes]


class _Rows:
    """``kept``: task rows that loops and earlier rows leave open.

    ``impossible``: those that the loops and other rows of the same task rule out.
    """

    def __init__(self, tick: Asked) -> None:
        self._tick, self._owners = tick, [row.owner for row in tick.task_rows]
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

    def contradicting(self, allowed: Array) -> tuple[str, ...]:
        """Tasks that cannot hold together, limits or not; none where they can."""
        possible = [i for i in range(len(allowed)) if i not in self.impossible]
        owners = tuple(dict.fromkeys(self._owners[i] for i in possible))
        A, b, J, wanted = self._tick.A, self._tick.b, self._tick.J, self._tick.wanted

        def fails(some: tuple[str, ...]) -> bool:
            chosen = [i for i in possible if self._owners[i] in some]
            M = np.vstack([A, J[chosen]])
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


def _relax(tick: Asked, kept: Sequence[int]) -> tuple[Relaxation, ...] | None:
    """The smallest with which some task rows hold as well; None where none helps."""
    from scipy.optimize import linprog  # its import takes a sixth of a second

    n, more = len(tick.v), 2 * len(tick.v) + len(tick.h)
    equal = np.vstack([tick.A, tick.J[kept]])
    sides = np.vstack([-np.eye(n), np.eye(n), tick.G])
    bounds = np.concatenate([-tick.lb, tick.ub, tick.h])
    bounded = np.isfinite(bounds)
    result = linprog(
        np.repeat([0.0, 1.0], [n, more]),
        A_ub=np.hstack([sides, -np.eye(more)])[bounded],
        b_ub=bounds[bounded],
        A_eq=np.hstack([equal, np.zeros((len(equal), more))]),
        b_eq=np.concatenate([tick.b, tick.wanted[kept]]),
        bounds=[(None, None)] * n + [(0.0, None)] * more,
    )
    if not result.success:
        return None
    amounts = np.asarray(result.x[n:], float)
    rows = tick.limit_rows if (amounts > NOTHING).any() else ()
    found = [
        Relaxation(
            row.name, x * (tick.dt if row.of_place else 1.0), row.unit, row.words, left < AT_BOUND
        )
        for row, x, left in zip(rows, amounts.tolist(), tick.slack.tolist(), strict=False)
        if x > NOTHING
    ]
    return tuple(sorted(found, key=lambda relaxation: -relaxation.amount))


def _sentence(
    found: Explanation, along: Sequence[str], held: Sequence[Share], *, relaxed: bool
) -> str:
    clauses = [f"{task.words} gets {percent(task.share)} of its rate" for task in found.unmet]
    if found.impossible:
        clauses.append(f"the loops alone leave no motion along {listed(found.impossible)}")
    if found.contradicting:
        clauses.append(f"{listed(found.contradicting)} ask for motions that rule each other out")
    elif along and found.relaxations:
        more = {r.name: r for r in found.relaxations}
        now = [_with_amount(share.row.words, more.get(share.row.name)) for share in held]
        now = now or [_with_amount(r.words, r) for r in found.relaxations if r.now]
        coming = [r.words for r in found.relaxations if not r.now]
        who = listed(["the loop", *now])
        clauses.append(f"{who} leave{'' if now else 's'} no more motion along {listed(along)}")
        if coming:
            clauses.append(f"next would come {listed(coming)}")
    elif along and not relaxed:
        clauses.append(f"no relaxation of the limits makes {listed(along)} possible")
    elif along:
        other = " or the least squares of its rows" if found.unmet else ", weights or a later level"
        clauses.append(f"{listed(along)} could be met; damping{other} gave it up")
    return "; ".join(clauses)


def _with_amount(words: str, relaxation: Relaxation | None) -> str:
    if relaxation is None or not relaxation.unit.endswith(("/s", "/s2")):
        return words
    lacks = f"{relaxation.amount:.3g} {relaxation.unit} short"
    return with_note(Row(name=words, kind="limit"), lacks)
