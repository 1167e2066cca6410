"""Why a goal was not reached, as geometry: limits, reach, contradiction, too few freedoms.

Searches from where the run has ended answer in turn

    inside the limits    it is reached: geometry is not what blocks
    without limits       it is reached: the limits block, or only this configuration does
    tasks by themselves  on a free object, then on this robot: which contradict each other
    rank of the task     the loops leave fewer motions than it asks for
    else                 out of reach: how far, and which way
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from coopqp.assessment.thresholds import BEYOND
from coopqp.base.rank import independent_rows, null_space
from coopqp.base.spec import Array
from coopqp.study.explanation.contradiction import (
    Contradiction,
    on_a_free_object,
    on_this_robot,
)
from coopqp.study.explanation.goal import Goal, PartOfTask
from coopqp.study.explanation.room import Room
from coopqp.study.explanation.search import Place, Search
from coopqp.study.explanation.shares import Share, forces, shares

#: Limits that cost less of the distance are not told of; a restart nearer by this is.
WORTH_TELLING = 0.1
#: Closed configurations at which the freedoms are counted, how far they are off, and the cut.
POSES, AWAY, RANK = 5, 0.3, 1e-4


@dataclass(frozen=True)
class NotBlocked:
    """The goal can be reached inside the limits from where the run has ended."""

    place: Place


@dataclass(frozen=True)
class BlockedByLimits:
    """The goal can be reached without the limits, and not with them.

    Attributes:
        shares: of the limits that hold back where the search inside them ends.
        place: where that is.
        start: a configuration at the goal, outside the limits.
        elsewhere: one at the goal inside the limits, that cannot be reached from here.
    """

    shares: tuple[Share, ...]
    place: Place
    start: Array
    elsewhere: Place | None = None


@dataclass(frozen=True)
class Elsewhere:
    """The goal can be reached inside the limits, but from another configuration only.

    The limits hold back here by their shares; the place is at the goal.
    """

    shares: tuple[Share, ...]
    place: Place


@dataclass(frozen=True)
class TooFewFreedoms:
    """The loops leave fewer motions than the goal's one task asks for."""

    goal: Goal
    asked: int
    left: int


@dataclass(frozen=True)
class OutOfReach:
    """One task cannot be met, whatever the limits.

    Attributes:
        goal: of that task.
        part: the one that is farthest off.
        gap: from the nearest place to the goal, rows of the part [the part's unit].
        nearest: that place.
        cost: by how much the limits keep it farther off [the part's unit]; 0 if not worth telling.
        shares: of these limits.
        elsewhere: a nearer place in another configuration, if there is one.
        in_world: whether the gap is along the world's x, y and z.
    """

    goal: Goal
    part: PartOfTask
    gap: Array
    nearest: Place
    cost: float
    shares: tuple[Share, ...]
    elsewhere: Place | None
    in_world: bool

    @property
    def distance(self) -> float:
        """How far out of reach [the part's unit]."""
        return float(np.linalg.norm(self.gap))


Unreachable = Elsewhere | Contradiction | TooFewFreedoms | OutOfReach
Diagnosis = NotBlocked | BlockedByLimits | Unreachable


def diagnose(goal: Goal, room: Room, q: Array) -> Diagnosis:
    """What geometry says of a run that has ended at q, of all its tasks that have a place."""
    inside, free = Search(goal, room), Search(goal)
    at = inside.from_(q)
    if at.reached:
        return NotBlocked(at)
    near = free.from_(at.q)
    found = near if near.reached else free.best(at.q)
    if found.reached:
        return _blocked(goal, room, inside, at, near, found)
    tasks = on_a_free_object(goal)
    if len(tasks) > 1:
        return Contradiction(tasks, any_robot=True)
    tasks = on_this_robot(goal, at.q) if len(goal.tasks) > 1 else goal.tasks
    if len(tasks) > 1:
        return Contradiction(tasks, any_robot=False)
    alone = goal.only(tasks)
    return _too_few(alone, at.q) or _out_of_reach(alone, room, q)


def _blocked(
    goal: Goal, room: Room, inside: Search, at: Place, near: Place, found: Place
) -> BlockedByLimits | Elsewhere:
    """By the limits, or only in this configuration."""
    held = held_back(goal, room, at.q)
    other = inside.best(at.q)
    other_or_none = other if other.reached else None
    if other_or_none and not (near.reached and room.overrun(near.q) > BEYOND):
        return Elsewhere(held, other)
    return BlockedByLimits(held, at, found.q, other_or_none)


def held_back(goal: Goal, room: Room, q: Array) -> tuple[Share, ...]:
    """Shares of the limits that hold the goal back at a configuration."""
    goal.look(q)
    Z = null_space(goal.state.J_loop)
    pull = -Z.T @ goal.stack.J.T @ (goal.weights * goal.stack.e)
    return shares(forces(pull, Z, room.at_bound(q)))


def _too_few(goal: Goal, q: Array) -> TooFewFreedoms | None:
    """Whether the loops leave less than the task asks for, and all of that can be had."""
    rows, asked, left = _generic_rank(goal, q)
    if left >= asked or not rows:
        return None
    if not Search(goal.masked(rows)).best(q).reached:
        return None
    return TooFewFreedoms(goal, asked, left)


def _generic_rank(goal: Goal, q: Array) -> tuple[list[int], int, int]:
    """Independent rows of the task within the loops, how many it has and how many are left."""
    closing, rng = Search(Goal(goal.chain, (), goal.t)), np.random.default_rng(1)
    within, alone = [], []
    for _ in range(POSES):
        place = closing.from_(q + rng.normal(scale=AWAY, size=len(q)))
        if place.valid:
            goal.look(place.q)
            within.append(goal.stack.J @ null_space(goal.state.J_loop))
            alone.append(goal.stack.J.copy())
    if not within:
        return [], 0, 0
    asked = max(np.linalg.matrix_rank(J, rtol=RANK) for J in alone)
    best = max(within, key=lambda JZ: int(np.linalg.matrix_rank(JZ, rtol=RANK)))
    left = int(np.linalg.matrix_rank(best, rtol=RANK))
    return independent_rows(best, most=left), int(asked), left


def _out_of_reach(goal: Goal, room: Room, q: Array) -> OutOfReach:
    """How far, on the branch where the run has ended."""
    inside, free = Search(goal, room), Search(goal)
    at = inside.from_(q)
    here, best = free.from_(at.q), free.best(at.q)
    if not here.valid:
        here = best
    nearer = best.valid and free.cost(best) < (1.0 - WORTH_TELLING) ** 2 * free.cost(here)
    part = max(goal.parts, key=lambda p: p.size(here.e) / p.part.tolerance)
    distance, with_limits = part.size(here.e), part.size(at.e)
    cost = with_limits - distance if at.valid else 0.0
    told = cost > WORTH_TELLING * with_limits
    return OutOfReach(
        goal=goal,
        part=part,
        gap=-here.e[part.rows],
        nearest=here,
        cost=cost if told else 0.0,
        shares=held_back(goal, room, at.q) if told else (),
        elsewhere=best if nearer else None,
        in_world=_in_world(goal, part, here.q),
    )


def _in_world(goal: Goal, part: PartOfTask, q: Array) -> bool:
    """Whether the part's rows are the world's coordinates of a point of the object.

    Its Jacobian is then that of the object's origin but for a lever times the angular one.
    """
    if part.part.rows != 3 or part.part.unit != "m":
        return False
    goal.look(q)
    J_v, J_w = goal.state.J_task[:3], goal.state.J_task[3:]
    left = (goal.stack.J[part.rows] - J_v).T
    left = left - J_w.T @ np.linalg.lstsq(J_w.T, left, rcond=None)[0]
    return bool(np.linalg.norm(left) < 1e-9 * max(float(np.linalg.norm(J_v)), 1e-9))
