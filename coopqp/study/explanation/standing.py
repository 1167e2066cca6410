"""Why arms that come to rest now are short of their goals: geometry at one instant, in no rerun.

The same diagnosis as of a whole run (:mod:`coopqp.study.explanation.whole`), for who watches: what
limits would have to give is found, and not tried.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from coopqp.assessment.thresholds import within
from coopqp.checked import Array
from coopqp.controller import ControlProblem
from coopqp.study.explanation import words
from coopqp.study.explanation.contradiction import Contradiction
from coopqp.study.explanation.cure import needs_of, starts_at
from coopqp.study.explanation.diagnosis import (
    BlockedByLimits,
    Elsewhere,
    NotBlocked,
    TooFewFreedoms,
    diagnose,
)
from coopqp.study.explanation.excess import least_excess
from coopqp.study.explanation.goal import Goal, PartOfTask, placed
from coopqp.study.explanation.room import Room
from coopqp.task import Task


@dataclass(frozen=True)
class Standing:
    """How arms stand to their goals.

    Attributes:
        reached: whether all goals that are places are within their tolerances.
        blocked: whether geometry keeps the arms from one that is not.
        sentence: in words.
        held_back: words of the limits that hold back, the most forceful first.
    """

    reached: bool
    blocked: bool
    sentence: str
    held_back: tuple[str, ...] = ()


def explain_standing(
    problem: ControlProblem, tasks: Sequence[Task], q: Array, *, rests: bool
) -> Standing:
    """Say what keeps arms from their goals.

    Args:
        problem: with the limits that count.
        tasks: of the problem, each with its reference at its goal.
        q: where the arms are, shape (n,) [rad, m].
        rests: whether they stay there; else it is told how near they can get.
    """
    chain = problem.chain
    goal = Goal(chain, placed(tasks, chain), 0.0)
    goal.look(q)
    missed = _missed(goal)
    if not missed:
        return Standing(True, False, "at every goal" if goal.parts else "")
    return _said(goal, Room(chain, problem.limits, problem.dt), q, rests=rests)


def _missed(goal: Goal) -> list[tuple[PartOfTask, float]]:
    """Parts outside their tolerance, the worst first."""
    found = zip(goal.parts, goal.errors().tolist(), strict=True)
    missed = [(part, error) for part, error in found if not within(error, part.part.tolerance)]
    return sorted(missed, key=lambda pair: -pair[1] / pair[0].part.tolerance)


def _said(goal: Goal, room: Room, q: Array, *, rests: bool) -> Standing:
    missed = _missed(goal)
    short = words.stops_short(*missed[0])
    found = diagnose(goal, room, q)
    if isinstance(found, NotBlocked):
        return Standing(False, False, f"{short}; it can be reached from here")
    if isinstance(found, BlockedByLimits):
        if not rests:
            short = _nearest(goal, found.place.q) or short
        said = [short, words.holding(found.shares), *_needed(goal, room, found)]
        if found.elsewhere:
            said.append(words.elsewhere(found.elsewhere, goal.chain))
    elif isinstance(found, Elsewhere):
        said = [short, words.holding(found.shares), words.elsewhere(found.place, goal.chain)]
    elif isinstance(found, Contradiction):
        said = [words.contradiction(found, missed, ordered=False)]
    elif isinstance(found, TooFewFreedoms):
        said = [short, words.freedoms(found)]
    else:
        said = [words.reach(found)]
    held = tuple(share.row.words for share in getattr(found, "shares", ()))
    return Standing(False, True, "; ".join(said), held)


def _nearest(goal: Goal, q: Array) -> str:
    """How near to the goal a configuration is, as a bound; empty where it is there."""
    goal.look(q)
    missed = _missed(goal)
    if not missed:
        return ""
    part, error = missed[0]
    return f"{part.name} gets no nearer than {words.size(error, part.part.unit)}"


def _needed(goal: Goal, room: Room, found: BlockedByLimits) -> list[str]:
    """What limits would have to give, the least of what was found."""
    excess = least_excess(goal, room, starts_at(goal, found))
    needs = needs_of(room, excess) if excess else ()
    return [f"to get there {words.needed(needs)} (not tried)"] if needs else []
