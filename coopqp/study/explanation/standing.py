"""Why arms that come to rest now are short of their goals: geometry at one instant, in no rerun.

The same diagnosis as of a whole run (:mod:`coopqp.study.explanation.whole`), for who watches: what
limits would have to give is found, and not tried.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from coopqp.base.spec import Array
from coopqp.controller import ControlProblem
from coopqp.study.explanation import words
from coopqp.study.explanation.diagnosis import BlockedByLimits, NotBlocked, diagnose
from coopqp.study.explanation.goal import Goal, placed
from coopqp.study.explanation.room import Room
from coopqp.study.explanation.suggested_relaxation import least_needs, needed
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
    missed = goal.missed(q)
    if not missed:
        return Standing(True, False, "at every goal" if goal.parts else "")
    short, room = words.stops_short(*missed[0]), Room(problem)
    found = diagnose(goal, room, q)
    if isinstance(found, NotBlocked):
        return Standing(False, False, f"{short}; it can be reached from here")
    held = tuple(share.row.words for share in getattr(found, "shares", ()))
    if not isinstance(found, BlockedByLimits):
        # At one instant nobody knows which law acts, and which task it puts first.
        said = words.geometry(found, missed, chain, ordered=False)
        return Standing(False, True, said, held)
    if not rests and (nearest := goal.missed(found.place.q)):
        part, error = nearest[0]
        short = f"{part.name} gets no nearer than {words.size(error, part.part.unit)}"
    parts = [short, words.holding(found.shares)]
    if needs := least_needs(goal, room, found):
        parts.append(f"to get there {needed(needs)} (not tried)")
    if found.elsewhere:
        parts.append(words.elsewhere(found.elsewhere, chain))
    return Standing(False, True, "; ".join(parts), held)
