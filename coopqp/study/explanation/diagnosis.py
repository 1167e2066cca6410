"""Why a goal was not reached, as geometry: limits, reach, contradiction, too few freedoms.

Searches from where the run has ended answer in turn

    inside the limits    reached: geometry is not what blocks
    without limits       reached: the limits block, or only this configuration does
    tasks by themselves  on a free object, then on this robot: which contradict each other
    rank of the task     the loops leave fewer motions than it asks for
    else                 unreachable: how far, and in which direction

A contradiction is a smallest set of tasks, by a deletion filter: on an object that nothing holds it
is one on any robot; else on this one, without limits. A free object has six coordinates,
x = (translation, rotation vector) from where it is now, and the tasks see it with J_task = [1 0]
in a state whose pose is overwritten.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
import pinocchio as pin

from coopqp.assessment.thresholds import BEYOND
from coopqp.base.rank import independent_rows, matrix_rank, null_space
from coopqp.base.spec import Array
from coopqp.scenario.bounded_steps import BoundedSteps, Stop
from coopqp.study.explanation import goal as geometry
from coopqp.study.explanation.goal import (
    Goal,
    PartOfTask,
    Place,
    PositionLimits,
    Search,
    Share,
    shares,
)
from coopqp.task import Task

T = TypeVar("T")

#: Random starts of a free object, steps of each, and the longest step.
FREE_STARTS, FREE_STEPS, FREE_STEP = 6, 80, 0.5
#: Rows belong to the object where J is a combination of the rows of J_task to this share.
OF_OBJECT = 1e-6


@dataclass(frozen=True)
class Contradiction:
    """Two tasks or more that cannot hold together, on any robot if a free object cannot either."""

    tasks: tuple[Task, ...]
    any_robot: bool


def irreducible(tasks: Sequence[T], fails: Callable[[tuple[T, ...]], bool]) -> tuple[T, ...]:
    """A minimal subset that fails, of tasks or names that fail together (deletion filter)."""
    kept = tuple(tasks)
    for task in tasks:
        rest = tuple(other for other in kept if other is not task)
        if rest and fails(rest):
            kept = rest
    return kept


def contradicting(tasks: Sequence[T], fails: Callable[[tuple[T, ...]], bool]) -> tuple[T, ...]:
    """A minimal subset of two or more that fails; none where all hold, or one alone fails."""
    found = irreducible(tasks, fails) if len(tasks) > 1 and fails(tuple(tasks)) else ()
    return found if len(found) > 1 else ()


def _contradiction(goal: Goal, q: Array) -> Contradiction:
    """Fewest tasks, of the object alone if any, that cannot hold together without limits."""
    if goal.chain.n >= 6:
        own = tuple(task for task in goal.tasks if _of_object(goal.only([task])))
        if tasks := contradicting(own, lambda some: _free_fails(goal.only(some))):
            return Contradiction(tasks, any_robot=True)
    tasks = irreducible(goal.tasks, lambda some: not Search(goal.only(some)).best(q).reached)
    return Contradiction(tasks, any_robot=False)


def _of_object(goal: Goal) -> bool:
    chain = goal.chain
    goal.look(chain.q_start + 0.1 * np.sin(1.0 + np.arange(chain.n)))
    J, J_task = goal.stack.J, goal.state.J_task
    left = J.T - J_task.T @ np.linalg.lstsq(J_task.T, J.T, rcond=None)[0]
    return bool(np.linalg.norm(left) <= OF_OBJECT * np.linalg.norm(J))


def _free_fails(goal: Goal) -> bool:
    """Whether the search finds no pose of a free object that fulfils the tasks."""
    state, root, rng = goal.state, np.sqrt(goal.weights), np.random.default_rng(0)
    goal.look(goal.chain.q_start)
    p, R = state.p_WO.copy(), state.R_WO.copy()

    def residual(x: Array) -> tuple[Array, Array]:
        J = np.zeros((6, goal.chain.n))
        J[:3, :3], J[3:, 3:6] = np.eye(3), pin.Jexp3(-x[3:])  # the left Jacobian
        state.place_object(p + x[:3], pin.exp3(x[3:]) @ R, J)
        goal.stack.update(state)
        return root * goal.stack.e, root[:, None] * goal.stack.J[:, :6]

    small = 0.05 * min(part.part.tolerance for part in goal.parts) * float(root.min())
    stop = Stop(FREE_STEPS, FREE_STEP, lambda r: bool(np.abs(r).max() < small))
    steps, far = BoundedSteps(6), np.full(6, np.inf)
    for i in range(FREE_STARTS):
        x = rng.normal(size=6) * np.repeat([0.3 * goal.chain.reach, 1.0], 3) * min(i, 1)
        steps.descend(x, residual, (-far, far), stop)
        residual(x)
        if goal.miss <= 1.0:
            return False
    return True


#: Share of the distance from which on limits, or a nearer restart, are mentioned.
WORTH_TELLING = 0.1
#: Closed configurations at which freedoms are counted, their distance [rad, m], rank tolerance.
POSES, AWAY, RANK = 5, 0.3, 1e-4


@dataclass(frozen=True)
class NotBlocked:
    """The goal can be reached inside the limits from where the run has ended."""

    place: Place


@dataclass(frozen=True)
class BlockedByLimits:
    """The goal is reachable without the limits only."""

    shares: tuple[Share, ...]  # of the limits that hold the search inside them back
    place: Place  # where that ends
    start: Array  # at the goal, without the limits
    elsewhere: Place | None = None  # at the goal inside the limits, not to be reached from here


@dataclass(frozen=True)
class Elsewhere:
    """The goal is reachable inside the limits from another configuration only, at ``place``."""

    shares: tuple[Share, ...]
    place: Place
    tasks: tuple[Task, ...] = ()


@dataclass(frozen=True)
class TooFewFreedoms:
    """The loops leave fewer motions than the one task asks for."""

    tasks: tuple[Task, ...]
    requested: int
    left: int


@dataclass(frozen=True)
class TooFar:
    """One task cannot be met, whatever the limits."""

    goal: Goal  # of that task
    part: PartOfTask  # the part that is farthest off
    gap: Array  # from the nearest place to the goal, rows of the part [the part's unit]
    nearest: Place
    cost: float  # how much the limits add to it [the part's unit], 0 if little
    shares: tuple[Share, ...]  # of the limits in that
    elsewhere: Place | None  # a nearer place in another configuration, if there is one
    in_world: bool  # whether the gap is along the world's x, y and z

    @property
    def tasks(self) -> tuple[Task, ...]:
        return (self.part.task,)

    @property
    def distance(self) -> float:
        return float(np.linalg.norm(self.gap))


Unreachable = Elsewhere | Contradiction | TooFewFreedoms | TooFar
Diagnosis = NotBlocked | BlockedByLimits | Unreachable


def diagnose(goal: Goal, bounds: PositionLimits, q: Array) -> Diagnosis:
    """Which geometric cause keeps tasks that have a place from their goal at q."""
    inside, free = Search(goal, bounds), Search(goal)
    at = inside.from_(q)
    if at.reached:
        return NotBlocked(at)
    near = free.from_(at.q)
    place = near if near.reached else free.best(at.q)
    if place.reached:
        held, other = _held_back(goal, bounds, at.q), inside.best(at.q)
        if other.reached and not (near.reached and bounds.violation(near.q) > BEYOND):
            return Elsewhere(held, other)
        return BlockedByLimits(held, at, place.q, other if other.reached else None)
    contradiction = _contradiction(goal, at.q)
    if len(contradiction.tasks) > 1:
        return contradiction
    alone = goal.only(contradiction.tasks)
    return _too_few(alone, at.q) or _unreachable(alone, bounds, q)


def _held_back(goal: Goal, bounds: PositionLimits, q: Array) -> tuple[Share, ...]:
    goal.look(q)
    Z = null_space(goal.state.J_loop)
    pull = -Z.T @ goal.stack.J.T @ (goal.weights * goal.stack.e)
    return shares(geometry.forces(pull, Z, bounds.at_bound(q)))


def _too_few(goal: Goal, q: Array) -> TooFewFreedoms | None:
    """Where the loops leave fewer motions than the task asks for, and those are reachable."""
    closing, rng = Search(Goal(goal.chain, (), goal.t)), np.random.default_rng(1)
    within, alone = [], []
    for _ in range(POSES):
        place = closing.from_(q + rng.normal(scale=AWAY, size=len(q)))
        if place.valid:
            goal.look(place.q)
            within.append(goal.stack.J @ null_space(goal.state.J_loop))
            alone.append(goal.stack.J.copy())
    if not within:
        return None
    requested = max(matrix_rank(J, RANK) for J in alone)
    best = max(within, key=lambda JZ: matrix_rank(JZ, RANK))
    left = matrix_rank(best, RANK)
    rows = independent_rows(best, max_rows=left)
    if left >= requested or not rows or not Search(goal.masked(rows)).best(q).reached:
        return None
    return TooFewFreedoms(goal.tasks, int(requested), left)


def _unreachable(goal: Goal, bounds: PositionLimits, q: Array) -> TooFar:
    inside, free = Search(goal, bounds), Search(goal)
    at = inside.from_(q)
    here, best = free.from_(at.q), free.best(at.q)
    if not here.valid:
        here = best
    nearer = best.valid and free.cost(best) < (1.0 - WORTH_TELLING) ** 2 * free.cost(here)
    part = max(goal.parts, key=lambda p: p.size(here.e) / p.part.tolerance)
    distance, with_limits = part.size(here.e), part.size(at.e)
    cost = with_limits - distance if at.valid else 0.0
    worth_telling = cost > WORTH_TELLING * with_limits
    return TooFar(
        goal=goal,
        part=part,
        gap=-here.e[part.rows],
        nearest=here,
        cost=cost if worth_telling else 0.0,
        shares=_held_back(goal, bounds, at.q) if worth_telling else (),
        elsewhere=best if nearer else None,
        in_world=_in_world(goal, part, here.q),
    )


def _in_world(goal: Goal, part: PartOfTask, q: Array) -> bool:
    """Whether the part is the world coordinates of an object point: J = J_v + lever x J_w."""
    if part.part.rows != 3 or part.part.unit != "m":
        return False
    goal.look(q)
    J_v, J_w = goal.state.J_task[:3], goal.state.J_task[3:]
    left = (goal.stack.J[part.rows] - J_v).T
    left = left - J_w.T @ np.linalg.lstsq(J_w.T, left, rcond=None)[0]
    return bool(np.linalg.norm(left) < 1e-9 * max(float(np.linalg.norm(J_v)), 1e-9))
