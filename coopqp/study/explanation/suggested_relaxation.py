"""What would do, and whether it does: amounts by which limits would have to give, tried in a rerun.

The least total excess comes first. A law may stop short with it, where its way leads into a saddle;
then the run is made without limits of place, and the largest overrun on the way is enough.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from coopqp.study.explanation import words
from coopqp.study.explanation.answer import Needed, RunExplanation
from coopqp.study.explanation.diagnosis import BlockedByLimits
from coopqp.study.explanation.explained_phase import ExplainedPhase
from coopqp.study.explanation.goal import Goal
from coopqp.study.explanation.minimal_violation import Violation, excess_at, least_excess
from coopqp.study.explanation.rerun import arrival, rerun, without_places
from coopqp.study.explanation.room import Room
from coopqp.study.explanation.search import NEAR, Search
from coopqp.study.explanation.shares import Share, thing_of

#: What is told is more than the least by this share and this much [rad, m], rounded up.
SHARE, MORE = 1.05, 5e-4
#: Digits of an amount.
DIGITS = 2
#: Beginnings of the least excess.
STARTS = 5


@dataclass(frozen=True)
class SuggestedRelaxation:
    """Amounts, and what came of trying them.

    Attributes:
        needs: what all limits would have to give, the largest first.
        after: the rerun with exactly these amounts; None if untried, because a limit has no
            setting that gives so much.
        time: that it takes then, where that is more than the run has [s].
    """

    needs: tuple[Violation, ...]
    after: ExplainedPhase | None
    time: float | None = None

    @property
    def reached(self) -> bool | None:
        """Whether the rerun reached the goal; None without one."""
        return None if self.after is None else not self.after.missed


def by_geometry(
    leg: ExplainedPhase, goal: Goal, found: BlockedByLimits, report: Callable[[float], None]
) -> SuggestedRelaxation | None:
    """Amounts that would do where limits keep a leg from its goal; None where none were found."""
    needs = least_needs(goal, leg.room, found)
    report(0.5)
    first = _tried(leg, needs, goal)
    if first and first.reached:
        return first
    report(0.7)
    return by_rerun(leg, goal) or first


def by_rerun(leg: ExplainedPhase, goal: Goal | None) -> SuggestedRelaxation | None:
    """What is enough by construction: the overrun of a run without limits of place.

    Where the goal is given, more time is tried as well.
    """
    limits = without_places(leg.scenario)
    free = rerun(leg, limits=limits)
    if free.missed and goal:
        free = rerun(leg, longer=True, limits=limits)
    if free.missed:
        return None
    return _tried(leg, _told(excess_at(leg.room, free.q)), goal)


def least_needs(goal: Goal, room: Room, found: BlockedByLimits) -> tuple[Violation, ...]:
    """The least of what was found from the configuration at the goal, and from others near by."""
    search, rng = Search(goal), np.random.default_rng(2)
    starts = [found.start]
    for _ in range(STARTS - 1):
        other = search.from_(found.start + rng.normal(scale=NEAR, size=goal.chain.n))
        if other.reached:
            starts.append(other.q)
    return _told(least_excess(goal, room, starts))


def _tried(
    leg: ExplainedPhase, needs: tuple[Violation, ...], goal: Goal | None
) -> SuggestedRelaxation | None:
    """A rerun with what would have to be given, as it is told."""
    if not needs:
        return None
    limits = leg.scenario.limits
    for need in needs:
        if need.space is not None:
            limit = leg.room.limits[need.space]
            relaxed = limit.relaxed(need.amount)
            if relaxed is None:
                return SuggestedRelaxation(needs, None)
            limits = tuple(relaxed if other is limit else other for other in limits)
    wider = {need.row: need.amount for need in needs if need.space is None}
    after = rerun(leg, wider=wider, limits=limits)
    if after.missed and goal:
        late = rerun(leg, longer=True, wider=wider, limits=limits)
        if not late.missed:
            return SuggestedRelaxation(needs, late, arrival(goal, late))
    return SuggestedRelaxation(needs, after)


def _told(found: Sequence[Violation]) -> tuple[Violation, ...]:
    """What limits would have to give, as it is told; the largest first."""
    told = [replace(excess, amount=_rounded_up(excess.amount)) for excess in found]
    return tuple(sorted(told, key=lambda need: -need.amount))


def _rounded_up(amount: float) -> float:
    """An amount as it is told: a little more than the least, in two digits [rad or m]."""
    more = SHARE * amount + MORE
    step = 10.0 ** (math.floor(math.log10(more)) - DIGITS + 1)
    return round(math.ceil(more / step - 1e-9) * step, 9)


def with_cure(
    base: RunExplanation, shares: Sequence[Share], cure: SuggestedRelaxation | None, *more: str
) -> RunExplanation:
    """That limits hold a run back, and what would do."""
    said = "; ".join([words.holding(shares), _said(cure, shares), *more])
    if cure is None:
        return base.because("limits", said, shares)
    needed = tuple(
        Needed(limit=n.row.name, words=n.row.words, amount=n.amount, unit=n.row.unit)
        for n in cure.needs
    )
    return base.because("limits", said, shares, needed=needed, tried=cure.reached, time=cure.time)


def _said(cure: SuggestedRelaxation | None, shares: Sequence[Share]) -> str:
    """What would do, and whether it was seen to."""
    if cure is None:
        return "even without limits of place the law does not get there"
    now = {thing_of(share.row) for share in shares}
    first = [need for need in cure.needs if thing_of(need.row) in now]
    later = [need for need in cure.needs if thing_of(need.row) not in now]
    text = f"to get there {needed(first)}" if first else "to get there"
    if later:
        text += (
            f"{'; next' if first else ' next'} would come {needed(later, alone=False)}, idle now"
        )
    if cure.after is None:
        return f"{text} (not tried: no setting gives so much)"
    if cure.after.missed:
        return f"{text}; tried, but then {words.stops(cure.after)}"
    time = "" if cure.time is None else f" and the run {cure.time:.3g} s"
    return f"{text}{time} (tried: reached)"


def needed(needs: Sequence[Violation], *, alone: bool = True) -> str:
    """Amounts that limits would have to give, each beside its limit; the verb with the first."""
    said: list[str] = []
    for need in needs:
        name = need.row.words if need.space is None else need.row.owner.replace("_", " ")
        amount = words.size(need.amount, need.row.unit)
        verb = "would need " if alone and not said else ""
        said.append(f"{name} {verb}{amount} more{'' if need.space is None else ' room'}")
    return words.listed(said)
