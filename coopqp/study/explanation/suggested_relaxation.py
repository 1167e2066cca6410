"""By how much limits would have to be relaxed for a goal to be reached, tried in a rerun.

First the minimal total violation of the limits with which the goal holds:

    minimise    sum s_j + 4 sum sigma_l                              [rad, and m times 4 rad/m]
    subject to  e(q) = 0,   e_loop(q) = 0
                lower - s <= q <= upper + s,   room_k(q) >= -sigma_l,   s, sigma >= 0

with one s a joint and one sigma a limit in space (a wall moves as a whole), by sequential linear
programs from a configuration at the goal outside the limits; one radian counts as a quarter of a
metre. A law may stop short with it, where its path leads into a saddle; then the run is made
without position limits, and the largest violation on its path is enough.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from coopqp.assessment.limits import audit
from coopqp.base.qp import Row
from coopqp.base.spec import Array
from coopqp.limit import Limit
from coopqp.study.explanation import words
from coopqp.study.explanation.diagnosis import BlockedByLimits
from coopqp.study.explanation.explained_phase import ExplainedPhase, arrival, rerun
from coopqp.study.explanation.goal import (
    NEAR,
    PLACE_UNITS,
    Goal,
    Room,
    Search,
    Share,
    least_relaxation,
    thing_of,
)
from coopqp.study.explanation.words import Needed, RunExplanation

#: Cost of a metre [rad], and of what the equalities are off by.
METRE, OFF = 4.0, 100.0
#: Steps, farthest that a joint goes in one [rad, m], how it shrinks, and where that ends.
STEPS, STEP, SHRINK, SMALLEST = 60, 0.3, 0.6, 1e-5
#: Newton steps after each, and the smallest decrease of the sum that is accepted.
NEWTON, ENOUGH = 2, 1e-6
#: Smallest singular value of the equalities that counts.
CUT = 1e-5
#: A violation below this is not named [rad, m].
NOTHING = 1e-4
#: A relaxation is suggested larger than the minimum by this share and amount [rad, m], rounded up.
SHARE, MORE = 1.05, 5e-4
#: Digits of an amount.
DIGITS = 2
#: Starts of the minimisation.
STARTS = 5


@dataclass(frozen=True)
class Violation:
    """By how much one limit is violated [rad or m].

    ``row`` is its most violated one, ``space`` its index in ``Room.limits``, None for a joint's.
    """

    row: Row
    amount: float
    space: int | None = None


def violations_along(room: Room, qs: Array) -> list[Violation]:
    """The largest violation of each limit along configurations, shape (T, n)."""
    slack, found = np.array([room.slack(q) for q in qs]), []
    for owner in np.unique(room.owners).tolist():
        own = np.flatnonzero(room.owners == owner)
        row = room.all_rows[own[slack[-1, own].argmin()]]
        space = owner - len(room.sides) if owner >= len(room.sides) else None
        found.append(Violation(row, float(-slack[:, own].min()), space))
    return [violation for violation in found if violation.amount > NOTHING]


def _cost(row: Row) -> float:
    return METRE if row.unit == "m" else 1.0


def _total(found: Sequence[Violation]) -> float:
    return sum(violation.amount * _cost(violation.row) for violation in found)


class _Programs:
    """The linear programs whose steps lead to a minimal violation."""

    def __init__(self, goal: Goal, room: Room) -> None:
        self._goal, self._room = goal, room
        costs = dict(zip(room.owners.tolist(), map(_cost, room.all_rows), strict=True))
        self._costs = list(costs.values())

    def shrink(self, start: Array) -> list[Violation] | None:
        """A local minimum near a start; None where the goal is lost."""
        q, step = self._back(start), STEP
        merit, off = self._merit(q)
        if off >= 1.0:
            return None
        for _ in range(STEPS):
            d = self._step(q, step)
            if d is None or step < SMALLEST:
                break
            trial = self._back(q + d)
            trial_merit, off = self._merit(trial)
            if off < 1.0 and trial_merit < merit - ENOUGH:
                q, merit, step = trial, trial_merit, min(STEP, step / SHRINK)
            else:
                step *= SHRINK
        return violations_along(self._room, q[None])

    def _step(self, q: Array, most: float) -> Array | None:
        room, (C, r) = self._room, self._equalities(q)
        U, values, Vt = np.linalg.svd(C, full_matrices=False)
        kept = int((values > CUT).sum())
        equal = Vt[:kept], -(U[:, :kept].T @ r) / values[:kept]
        limits = room.ways(q), room.slack(q)
        found = least_relaxation(equal, limits, room.owners, self._costs, most)
        return found and found[0]

    def _back(self, q: Array) -> Array:
        """Newton steps to where the equalities hold again, so that steps may be long."""
        for _ in range(NEWTON):
            C, r = self._equalities(q)
            q = q - np.linalg.lstsq(C, r, rcond=CUT)[0]
        return q

    def _equalities(self, q: Array) -> tuple[Array, Array]:
        goal = self._goal
        goal.look(q)
        C = np.vstack([goal.state.J_loop, goal.stack.J])
        return C, np.concatenate([goal.state.e_loop, goal.stack.e])

    def _merit(self, q: Array) -> tuple[float, float]:
        """Violation and residual of the equalities; the latter in tolerances as well."""
        off, goal = np.abs(self._equalities(q)[1]).sum(), self._goal
        violations = np.zeros(len(self._costs))
        np.maximum.at(violations, self._room.owners, -self._room.slack(q))
        return float(violations @ self._costs + OFF * off), max(goal.miss, goal.open / 1e-4)


@dataclass(frozen=True)
class SuggestedRelaxation:
    """Relaxations of limits, the largest first, and the rerun with them.

    Attributes:
        after: the rerun; None where a limit cannot be relaxed so far.
        time: that it takes, where that is more than the run has [s].
        untried: name of a limit that has no method for it; else no setting gives so much.
    """

    needs: tuple[Violation, ...]
    after: ExplainedPhase | None
    time: float | None = None
    untried: str = ""

    @property
    def reached(self) -> bool | None:
        return None if self.after is None else not self.after.missed


def by_geometry(
    phase: ExplainedPhase, goal: Goal, found: BlockedByLimits, report: Callable[[float], None]
) -> SuggestedRelaxation | None:
    """Relaxations where limits keep a phase from its goal; None where none were found."""
    needs = minimal_relaxations(goal, phase.room, found)
    report(0.5)
    first = _tried(phase, needs, goal)
    if first and first.reached:
        return first
    report(0.7)
    return by_rerun(phase, goal) or first


def by_rerun(phase: ExplainedPhase, goal: Goal | None) -> SuggestedRelaxation | None:
    """The violations of a run without position limits; with a goal more time is tried as well."""
    chain = phase.scenario.chain
    q, v = np.vstack([chain.q_start] * 2), np.zeros((1, chain.n))
    limits = tuple(  # without those of position, which braking before an end stop is as well
        limit
        for limit in phase.scenario.limits
        if all(row.unit not in PLACE_UNITS for row in audit([limit], chain, q, v, 0.01).margins)
    )
    free = rerun(phase, limits=limits)
    if free.missed and goal:
        free = rerun(phase, longer=True, limits=limits)
    if free.missed:
        return None
    return _tried(phase, _rounded(violations_along(phase.room, free.q)), goal)


def minimal_relaxations(goal: Goal, room: Room, found: BlockedByLimits) -> tuple[Violation, ...]:
    """The smallest found from the configuration at the goal, and from others near by."""
    search, rng = Search(goal), np.random.default_rng(2)
    starts = [found.start]
    for _ in range(STARTS - 1):
        other = search.from_(found.start + rng.normal(scale=NEAR, size=goal.chain.n))
        if other.reached:
            starts.append(other.q)
    programs = _Programs(goal, room)
    minima = [minimum for q in starts if (minimum := programs.shrink(q)) is not None]
    return _rounded(min(minima, key=_total, default=[]))  # nothing where all starts lose the goal


def _tried(
    phase: ExplainedPhase, needs: tuple[Violation, ...], goal: Goal | None
) -> SuggestedRelaxation | None:
    if not needs:
        return None
    limits = phase.scenario.limits
    for need in needs:
        if need.space is not None:
            limit = phase.room.limits[need.space]
            relaxed = limit.relaxed(need.amount)
            if relaxed is None:
                own = type(limit).relaxed is not Limit.relaxed
                return SuggestedRelaxation(needs, None, untried="" if own else need.row.owner)
            limits = tuple(relaxed if other is limit else other for other in limits)
    wider = {need.row: need.amount for need in needs if need.space is None}
    after = rerun(phase, wider=wider, limits=limits)
    if after.missed and goal:
        late = rerun(phase, longer=True, wider=wider, limits=limits)
        if not late.missed:
            return SuggestedRelaxation(needs, late, arrival(goal, late))
    return SuggestedRelaxation(needs, after)


def _rounded(found: Sequence[Violation]) -> tuple[Violation, ...]:
    """A little more than the minimum, rounded up to two digits, the largest first."""
    needs = []
    for violation in found:
        more = SHARE * violation.amount + MORE
        step = 10.0 ** (math.floor(math.log10(more)) - DIGITS + 1)
        needs.append(replace(violation, amount=round(math.ceil(more / step - 1e-9) * step, 9)))
    return tuple(sorted(needs, key=lambda need: -need.amount))


def with_suggestion(
    base: RunExplanation,
    shares: Sequence[Share],
    suggestion: SuggestedRelaxation | None,
    *more: str,
) -> RunExplanation:
    """That limits hold a run back, and which relaxation would do."""
    sentence = "; ".join([words.holding(shares), _said(suggestion, shares), *more])
    if suggestion is None:
        return base.because("limits", sentence, shares)
    needs = tuple(
        Needed(limit=n.row.name, words=n.row.words, amount=n.amount, unit=n.row.unit)
        for n in suggestion.needs
    )
    tried, time = suggestion.reached, suggestion.time
    return base.because("limits", sentence, shares, needed=needs, tried=tried, time=time)


def _said(suggestion: SuggestedRelaxation | None, shares: Sequence[Share]) -> str:
    if suggestion is None:
        return "even without limits of place the law does not get there"
    now = {thing_of(share.row) for share in shares}
    first = [need for need in suggestion.needs if thing_of(need.row) in now]
    later = [need for need in suggestion.needs if thing_of(need.row) not in now]
    text = f"to get there {needed(first)}" if first else "to get there"
    if later:
        text += f"{';' if first else ''} next would come {needed(later, alone=False)}, idle now"
    if suggestion.after is None:
        why = "no setting gives so much"
        if name := suggestion.untried:
            method = "no method relaxed(by), which returns it `by` metres farther out"
            why = f"limit '{name}' has {method}"
        return f"{text} (not tried: {why})"
    if suggestion.after.missed:
        return f"{text}; tried, but then {words.stops(suggestion.after)}"
    time = "" if suggestion.time is None else f" and the run {suggestion.time:.3g} s"
    return f"{text}{time} (tried: reached)"


def needed(needs: Sequence[Violation], *, alone: bool = True) -> str:
    """Limits with their relaxations; the verb with the first."""
    clauses: list[str] = []
    for need in needs:
        name = need.row.words if need.space is None else need.row.owner.replace("_", " ")
        amount = words.size(need.amount, need.row.unit)
        verb = "would need " if alone and not clauses else ""
        clauses.append(f"{name} {verb}{amount} more{'' if need.space is None else ' room'}")
    return words.listed(clauses)
