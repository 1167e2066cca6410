"""What would do, and whether it does: amounts by which limits would have to give, tried in a rerun.

The least total excess comes first. A law may stop short with it, where its way leads into a saddle;
then the run is made without limits of place, and the largest overrun on the way is enough.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from coopqp.row import Row
from coopqp.scenario.scenario import Scenario
from coopqp.study.explanation.diagnosis import BlockedByLimits
from coopqp.study.explanation.excess import Excess, excess_at, least_excess
from coopqp.study.explanation.goal import Goal
from coopqp.study.explanation.leg import Leg
from coopqp.study.explanation.rerun import Change, arrival, longer, rerun
from coopqp.study.explanation.room import Room
from coopqp.study.explanation.search import NEAR, Search

#: What is told is more than the least by this share and this much [rad, m], rounded up.
SHARE, MORE = 1.05, 5e-4
#: Digits of an amount.
DIGITS = 2
#: Beginnings of the least excess.
STARTS = 5


@dataclass(frozen=True)
class Need:
    """What one limit would have to give.

    Attributes:
        row: of the limit, or one of them where it moves as a whole.
        amount: [rad or m].
        space: index of the limit in ``Room.limits``; None for a joint's.
    """

    row: Row
    amount: float
    space: int | None = None


@dataclass(frozen=True)
class Cure:
    """Amounts, and what came of trying them.

    Attributes:
        needs: what all limits would have to give, the largest first.
        reached: whether the rerun with exactly these amounts reached the goal; None if untried,
            because a limit has no setting that gives so much.
        left: what the rerun ended off by, as the leg tells; None where it reached.
        time: that it takes then, where that is more than the run has [s].
    """

    needs: tuple[Need, ...]
    reached: bool | None
    left: Leg | None = None
    time: float | None = None


Report = Callable[[float], None]


def cure(
    scenario: Scenario,
    controller: str,
    leg: Leg,
    goal: Goal,
    room: Room,
    blocked: BlockedByLimits,
    report: Report,
) -> Cure | None:
    """Amounts that would do; None where none were found.

    Args:
        scenario: as the controller holds it.
        controller: its name.
        leg: that missed.
        goal: of its tasks.
        room: its limits.
        blocked: where limits hold back, and configurations at the goal.
        report: called with the share that is done.
    """
    least = least_excess(goal, room, starts_at(goal, blocked))
    report(0.5)
    first = _tried(scenario, controller, leg, room, least, goal) if least else None
    if first and first.reached:
        return first
    report(0.7)
    return way_of(scenario, controller, leg, room, goal) or first


def way_of(
    scenario: Scenario, controller: str, leg: Leg, room: Room, goal: Goal | None
) -> Cure | None:
    """What is enough by construction: the overrun of a run without limits of place.

    Args:
        scenario: as the controller holds it.
        controller: its name.
        leg: that missed.
        room: its limits.
        goal: of its tasks, to be given more time; None where that is no help.
    """
    change = Change(without_places=True)
    free = rerun(scenario, controller, leg.phase, change)
    if free.missed and goal:
        free = rerun(scenario, controller, leg.phase, replace(change, longer=longer(leg)))
    if free.missed:
        return None
    return _tried(scenario, controller, leg, room, excess_at(room, free.q), goal)


def starts_at(goal: Goal, blocked: BlockedByLimits) -> list[np.ndarray]:
    """Configurations at the goal: that which was found, and others near by."""
    search, rng = Search(goal), np.random.default_rng(2)
    found = list(blocked.starts)
    for _ in range(STARTS - len(found)):
        other = search.from_(blocked.starts[0] + rng.normal(scale=NEAR, size=goal.chain.n))
        if other.reached:
            found.append(other.q)
    return found


def _tried(
    scenario: Scenario, controller: str, leg: Leg, room: Room, excess: Excess, goal: Goal | None
) -> Cure | None:
    """A rerun with what would have to be given, as it is told."""
    needs = needs_of(room, excess)
    if not needs:
        return None
    change = _change(room, needs)
    if change is None:
        return Cure(needs, None)
    after = rerun(scenario, controller, leg.phase, change)
    if not after.missed:
        return Cure(needs, True)
    if goal:
        late = rerun(scenario, controller, leg.phase, replace(change, longer=longer(leg)))
        if not late.missed:
            return Cure(needs, True, time=arrival(goal, late))
    return Cure(needs, False, after)


def needs_of(room: Room, excess: Excess) -> tuple[Need, ...]:
    """What limits would have to give, as it is told; the largest first."""
    joints = [Need(row, rounded_up(x)) for row, x in excess.joints.items()]
    spaces = [
        Need(room.rows[_deepest(room, excess, owner)], rounded_up(x), owner)
        for owner, x in excess.spaces.items()
    ]
    return tuple(sorted([*joints, *spaces], key=lambda need: -need.amount))


def _deepest(room: Room, excess: Excess, owner: int) -> int:
    """The row of a limit in space that is broken most."""
    own = [i for i, other in enumerate(room.owners) if other == owner]
    return own[int(np.argmin(room.at(excess.q)[own]))]


def _change(room: Room, needs: tuple[Need, ...]) -> Change | None:
    """The limits with so much more room; None where one cannot give it."""
    limits = []
    for need in needs:
        if need.space is not None:
            limit = room.limits[need.space]
            other = limit.eased(need.amount)
            if other is None:
                return None
            limits.append((limit, other))
    joints = {need.row: need.amount for need in needs if need.space is None}
    return Change(joints=joints, limits=tuple(limits))


def rounded_up(amount: float) -> float:
    """An amount as it is told: a little more than the least, in two digits [rad or m]."""
    more = SHARE * amount + MORE
    step = 10.0 ** (math.floor(math.log10(more)) - DIGITS + 1)
    return round(math.ceil(more / step - 1e-9) * step, 9)
