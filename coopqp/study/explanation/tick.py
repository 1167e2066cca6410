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
  tick, one for each of lb <= v, v <= ub and G v <= h.

Limits in it that are not active now would come next. It is of one tick, a twentieth of the way or
less; :mod:`coopqp.study.explanation.whole` has what would do in all.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from coopqp.assessment.thresholds import AT_LIMIT
from coopqp.base.qp import QP, Row, names_of
from coopqp.base.rank import null_space
from coopqp.base.spec import Array
from coopqp.model.state import State
from coopqp.solver import HALTS, Budget, Status, causes_of, norm
from coopqp.study.explanation import goal as geometry
from coopqp.study.explanation.diagnosis import contradicting
from coopqp.study.explanation.explained_phase import ExplainedPhase
from coopqp.study.explanation.goal import Share, forces, least_relaxation, shares
from coopqp.study.explanation.words import Relaxed, listed, percent, with_note
from coopqp.study.tick_record import NamedBounds, TickRecord
from coopqp.task import Mode, TaskStack

#: Number of ticks of a run that are evaluated at most; error from which one counts [m/s, rad/s].
TICKS, BEHIND = 150, 1e-3
#: A task that lacks more than this share of its rate counts, as does the one that lacks most.
WORTH_COUNTING = 0.02


@dataclass(frozen=True, kw_only=True)
class TickRows:
    """The rows of a tick and its answer v: A v = b of loops, J v = wanted of tasks, limits."""

    A: Array
    J: Array
    wanted: Array
    limits: QP | NamedBounds
    limit_rows: Sequence[Row]
    v: Array

    @cached_property
    def left(self) -> Array:
        """What lb, ub and h leave at v = 0."""
        return np.concatenate([-self.limits.lb, self.limits.ub, self.limits.h])

    @cached_property
    def ways(self) -> Array:
        """The joint motion that violates each limit."""
        eye = np.eye(len(self.v))
        return np.vstack([-eye, eye, self.limits.G])

    @cached_property
    def slack(self) -> Array:
        """What limits leave at the answer."""
        return self.left - self.ways @ self.v

    def at_limits(self, near: float) -> list[tuple[Row, Array]]:
        """Limits with less slack than ``near``, each with the joint motion that violates it."""
        at = np.flatnonzero(self.slack < near).tolist()
        return [(self.limit_rows[i], self.ways[i]) for i in at]

    def forces(self, near: float, weights: Array | float = 1.0) -> list[tuple[Row, float]]:
        """Forces, :func:`forces`, of the limits with less slack than ``near``."""
        Z, missed = null_space(self.A), self.wanted - self.J @ self.v
        return forces(Z.T @ self.J.T @ (weights * missed), Z, self.at_limits(near))


def _rows_then(record: TickRecord) -> tuple[TickRows, Array]:
    """Of a saved tick, and b; hard and scaled tasks are tasks here."""
    qp = record.qp()
    loops = [i for i, row in enumerate(record.equality_rows) if row.kind == "loop"]
    tick = TickRows(
        A=qp.A[loops], J=np.array(record.J).reshape(-1, qp.n), wanted=np.array(record.wanted),
        limits=qp, limit_rows=[*record.lb_rows, *record.ub_rows, *record.inequality_rows],
        v=np.array(record.answer),
    )  # fmt: skip
    return tick, qp.b[loops]


class PhaseTicks:
    """The ticks of a phase whose law commands velocities, evaluated again one by one.

    ``state`` and ``stack`` of tasks are those of the last one; ``counted`` are the rows of tasks
    that count.
    """

    def __init__(self, phase: ExplainedPhase) -> None:
        self._phase, problem = phase, phase.problem
        self.state = State(problem.chain)
        self.stack = TaskStack(problem.tasks, State(problem.chain))
        names = {task.name for task in phase.counted}
        self.counted = [i for i, row in enumerate(self.stack.rows) if row.owner in names]

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
        own, limits, stack = self.counted, self._limits, self.stack
        missed = self.look(k)[own]
        if np.abs(missed).max(initial=0.0) <= BEHIND:
            return []
        limits.update(self.state)
        tick = TickRows(
            A=self.state.J_loop, J=stack.J[own], wanted=stack.wanted[own], v=self._phase.v[k],
            limits=limits, limit_rows=limits.rows,
        )  # fmt: skip
        held = tick.forces(AT_LIMIT, stack.weights[own])
        total, size = sum(amount for _, amount in held), float(np.linalg.norm(missed))
        return [(row, amount / total * size) for row, amount in held if total > 0.0]


def held_up(phase: ExplainedPhase, ticks: range | None = None) -> tuple[Share, ...]:
    """Which limits slowed a run in some ticks or all, the largest share first."""
    look, ticks = PhaseTicks(phase), ticks or range(len(phase.v))
    some = ticks[:: max(1, len(ticks) // TICKS)]
    return shares(force for k in some for force in look.forces(k))


def speed_share(shares: Sequence[Share]) -> float:
    """Share of the limits of speeds and accelerations."""
    rates = (s for s in shares if not s.row.of_place and s.row.unit not in geometry.PLACE_UNITS)
    return sum(share.share for share in rates)


@dataclass(frozen=True)
class Unmet:
    """A hard or scaled task that gets only a share of its rate in a tick."""

    task: str
    mode: Mode
    share: float


def _part_of_rate(got: Array, wanted: Array) -> float:
    off, size = float(np.linalg.norm(got - wanted)), float(np.linalg.norm(wanted))
    return 1.0 - off / max(size, off, HELD)


def relaxed(phases: Sequence[ExplainedPhase]) -> tuple[Relaxed, ...]:
    """Tasks not met in full in relaxed ticks, the most frequent first; none under torque laws."""
    modes: dict[str, Mode] = {}
    ticks, missing = Counter[str](), dict[str, float]()
    for phase in phases if not phases[0].controller.commands_torques else ():
        missing, look = {}, PhaseTicks(phase)
        every = zip(phase.problem.tasks, look.stack.slices, strict=True)
        firm = [(task, rows) for task, rows in every if task.mode != "soft"]
        modes |= {task.name: task.mode for task, _ in firm}
        for k, causes in enumerate(phase.causes):
            is_last, is_relaxed = k == len(phase.v) - 1, Status.TASKS_RELAXED in causes
            if not is_last and not is_relaxed:
                continue
            off, wanted = look.look(k), look.stack.wanted
            got = wanted - off
            lacks = {task.name: 1.0 - _part_of_rate(got[own], wanted[own]) for task, own in firm}
            worst = max(lacks.values(), default=0.0) if is_relaxed else WORTH_COUNTING
            counts_from = min(worst, WORTH_COUNTING)
            lacks = {name: lack for name, lack in lacks.items() if lack >= counts_from > 0.0}
            ticks.update(lacks.keys() if is_relaxed else ())
            missing = lacks if is_last else {}
    return tuple(
        Relaxed(task=name, mode=modes[name], ticks=count, missing=missing.get(name, 0.0))
        for name, count in ticks.most_common()
    )


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
    """By how much one limit would have to give."""

    name: str  # of the limit's row
    amount: float  # for this tick [``unit``]: position limits in rad or m, the others per second
    unit: str
    words: str = ""  # what a sentence calls it
    now: bool = True  # whether it is active in this tick; the others would come next


@dataclass(frozen=True)
class Explanation:
    """Why a tick could not do what its tasks asked."""

    missed: tuple[str, ...]  # task rows that the answer misses
    impossible: tuple[str, ...]  # those that the loops alone rule out, whatever the limits
    # the smallest that would let all others hold; empty when nothing is missed
    relaxations: tuple[Relaxation, ...]
    sentence: str
    # names of tasks that ask for motions which rule each other out
    contradicting: tuple[str, ...] = ()
    holding: tuple[str, ...] = ()  # active limits that hold back, the most forceful first
    unmet: tuple[Unmet, ...] = ()  # hard and scaled tasks that are not met in full


def explain(record: TickRecord) -> Explanation:
    """Why a saved tick could not do what its tasks asked."""
    causes = causes_of(record.status)
    if halts := [cause for cause in causes if cause in HALTS]:
        return Explanation(
            (), (), (), f"the controller was not evaluated; the loop {halts[0].value}"
        )
    if not causes[0].usable and causes[0] not in CONFLICTS:
        return Explanation((), (), (), f"the tick stands still: {causes[0].value}")
    missed = _missed(record)
    if not missed.any():
        return Explanation((), (), (), "every task row was met")
    missed_names = tuple(record.task_rows[i].name for i in np.flatnonzero(missed))
    unmet, record = _unmet(record, missed), _until_missed(record, missed)
    tick, b = _rows_then(record)
    names, open_rows, impossible = names_of(record.task_rows), *_possible(tick, record.task_rows)
    against = _contradiction(record, tick, b, impossible)
    held = () if against else shares(tick.forces(AT_BOUND))
    answer = None if against else _relaxations(record, tick, b, open_rows)
    result = Explanation(
        missed=missed_names,
        impossible=tuple(names[i] for i in impossible),
        relaxations=answer or (),
        sentence="",
        contradicting=against,
        holding=tuple(share.row.name for share in held),
        unmet=unmet,
    )
    along = [names[i] for i in np.flatnonzero(_missed(record)) if i not in impossible]
    return replace(result, sentence=_sentence(result, along, held, relaxed=answer is not None))


def at_bound(record: TickRecord) -> tuple[Row, ...]:
    """Active limits, each side of a joint and each limit in space once."""
    tick, _ = _rows_then(record)
    return tuple({geometry.thing_of(row): row for row, _ in tick.at_limits(AT_BOUND)}.values())


def _allowed(record: TickRecord) -> Array:
    """What each task row may be off by and count as met."""
    exact = {"hard", "scaled"} if "TASKS_RELAXED" in record.status else {"hard"}
    firm = [record.modes[row.owner] in exact for row in record.task_rows]
    return np.where(firm, HELD, MISSED + MISSED_SHARE * np.abs(record.wanted))


def _missed(record: TickRecord) -> NDArray[np.bool_]:
    J = np.array(record.J).reshape(-1, len(record.answer))
    return np.asarray(np.abs(J @ record.answer - record.wanted) > _allowed(record))


def _unmet(record: TickRecord, missed: NDArray[np.bool_]) -> tuple[Unmet, ...]:
    """Hard tasks that miss rows, then scaled ones, each with the share of its rate."""
    owners = np.array([row.owner for row in record.task_rows])
    got, wanted = np.array(record.J) @ record.answer, np.array(record.wanted)
    return tuple(
        Unmet(name, mode, _part_of_rate(got[owners == name], wanted[owners == name]))
        for mode in ("hard", "scaled")
        for name in dict.fromkeys(owners[missed].tolist())
        if record.modes[name] == mode
    )


def _until_missed(record: TickRecord, missed: NDArray[np.bool_]) -> TickRecord:
    """With task rows up to the first mode, of hard, scaled and soft, that misses any."""
    levels = [("hard", "scaled", "soft").index(record.modes[r.owner]) for r in record.task_rows]
    first = np.flatnonzero(levels <= np.min(np.array(levels)[missed])).tolist()
    J, wanted, rows = record.J, record.wanted, record.task_rows
    own = [J[i] for i in first], [wanted[i] for i in first], [rows[i] for i in first]
    return replace(record, J=own[0], wanted=own[1], task_rows=own[2])


def _possible(tick: TickRows, task_rows: Sequence[Row]) -> tuple[list[int], list[int]]:
    """Task rows that loops and other rows leave open, and impossible ones."""
    kept, impossible = list[int](), list[int]()
    own = known = loops = np.linalg.qr(tick.A.T)[0].T
    for i, row in enumerate(tick.J):
        if i and task_rows[i].owner != task_rows[i - 1].owner:
            own = loops
        more = _spanned(own, row)
        if more is None:
            impossible.append(i)
            continue
        own, more = more, _spanned(known, row)
        if more is not None:
            kept.append(i)
            known = more
    return kept, impossible


def _spanned(basis: Array, row: Array) -> Array | None:
    """Orthonormal rows that span one more; None where that is spanned already."""
    left = row - basis.T @ (basis @ row)
    left -= basis.T @ (basis @ left)  # what rounding has left
    size = norm(left)
    adds = size > IMPOSSIBLE * max(norm(row), 1e-12)
    return np.concatenate([basis, left[None] / size]) if adds else None


def _contradiction(
    record: TickRecord, tick: TickRows, b: Array, impossible: Sequence[int]
) -> tuple[str, ...]:
    """Tasks that cannot hold together, limits or not; none where they can."""
    possible = [i for i in range(len(tick.J)) if i not in impossible]
    owners, allowed = [record.task_rows[i].owner for i in possible], _allowed(record)[possible]
    rows = tick.A, b, tick.J[possible], tick.wanted[possible]
    return contradicting_rows(*rows, owners, allowed, IMPOSSIBLE)


def contradicting_rows(
    A: Array, b: Array, J: Array, wanted: Array, owners: Sequence[str], allowed: Array, cut: float
) -> tuple[str, ...]:
    """Owners of rows J v = wanted that A v = b lets hold one by one, but not together.

    Rows may be off by what is ``allowed``; smaller shares of the largest singular value than
    ``cut`` are no motion.
    """

    def fails(some: tuple[str, ...]) -> bool:
        chosen = [i for i, owner in enumerate(owners) if owner in some]
        M, r = np.vstack([A, J[chosen]]), np.concatenate([b, wanted[chosen]])
        off = M @ np.linalg.lstsq(M, r, rcond=cut)[0] - r
        return bool((np.abs(off[len(b) :]) > allowed[chosen]).any())

    return contradicting(tuple(dict.fromkeys(owners)), fails)


def _relaxations(
    record: TickRecord, tick: TickRows, b: Array, kept: Sequence[int]
) -> tuple[Relaxation, ...] | None:
    """The smallest with which some task rows hold as well; None where none helps."""
    equal = np.vstack([tick.A, tick.J[kept]]), np.concatenate([b, tick.wanted[kept]])
    count = len(tick.left)
    result = least_relaxation(equal, (tick.ways, tick.left), np.arange(count), [1.0] * count)
    if result is None:
        return None
    rows = zip(tick.limit_rows, result[1].tolist(), tick.slack.tolist(), strict=False)
    relaxations = [
        Relaxation(
            row.name, x * (record.dt if row.of_place else 1.0), row.unit, row.label, left < AT_BOUND
        )
        for row, x, left in rows
        if x > NOTHING
    ]
    return tuple(sorted(relaxations, key=lambda relaxation: -relaxation.amount))


def _sentence(
    result: Explanation, along: Sequence[str], held: Sequence[Share], *, relaxed: bool
) -> str:
    clauses = [
        f"{task.mode} task '{task.task}' gets {percent(task.share)} of its rate"
        for task in result.unmet
    ]
    if result.impossible:
        clauses.append(f"the loops alone leave no motion along {listed(result.impossible)}")
    if result.contradicting:
        clauses.append(f"{listed(result.contradicting)} ask for motions that rule each other out")
    elif along and result.relaxations:
        more = {r.name: r for r in result.relaxations}
        now = [_with_amount(share.row.label, more.get(share.row.name)) for share in held]
        now = now or [_with_amount(r.words, r) for r in result.relaxations if r.now]
        coming = [r.words for r in result.relaxations if not r.now]
        who = listed(["the loop", *now])
        clauses.append(f"{who} leave{'' if now else 's'} no more motion along {listed(along)}")
        if coming:
            clauses.append(f"the next limits would be {listed(coming)}")
    elif along and not relaxed:
        clauses.append(f"no relaxation of the limits makes {listed(along)} possible")
    elif along:
        other = " or the least squares of its rows"
        other = other if result.unmet else ", weights or a later level"
        clauses.append(f"{listed(along)} could be met; damping{other} gave it up")
    return "; ".join(clauses)


def _with_amount(limit: str, relaxation: Relaxation | None) -> str:
    if relaxation is None or not relaxation.unit.endswith(("/s", "/s2")):
        return limit
    lacks = f"{relaxation.amount:.3g} {relaxation.unit} short"
    return with_note(Row(name=limit, kind="limit"), lacks)
