"""Where tasks want the arms to be, and the configuration nearest to it: inverse kinematics.

A task has a place where e is a function of q with the Jacobian J: not a twist, nor an objective
that is only written as rows, such as joint centring. Inside the limits or without them

    minimise    e' W e + w_c |e_loop|^2 + w_c |negative clearances|^2,   w_c = 30, then 1e4
    subject to  joint limits, and rows that keep the clearances

by bounded least squares (:mod:`coopqp.scenario.bounded_steps`). With a heavy w_c from the start the
steps would crawl along curved valleys. An answer counts only where the loops are closed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from coopqp.assessment.thresholds import within
from coopqp.base.spec import Array
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.state import State
from coopqp.scenario.bounded_steps import BoundedSteps, Stop
from coopqp.signal import InputValues
from coopqp.study.explanation.room import Room
from coopqp.task import Part, Task, TaskStack

#: Finite difference, and how well J must agree with it for a task to have a place.
DIFFERENCE, AGREES = 1e-6, 1e-3
#: Weight of a level of priority relative to the one before it.
PER_LEVEL = 0.1
#: Weights w_c of the stages, steps of each, farthest that a joint goes in one [rad, m].
STAGES, STEPS, STEP = (30.0, 1e4), 60, 0.3
#: Loops open by less are closed, limits violated by less are kept [m, rad].
CLOSED = 2e-4
#: A search ends where all errors are this small a share of the tolerances.
ENOUGH = 0.05
#: Random starts after the first.
RESTARTS = 12
#: Range of random starts of joints without limits, and of starts near by [rad, m].
UNLIMITED, NEAR = 1.5, 0.5


@dataclass(frozen=True)
class PartOfTask:
    """Rows of a task that share a unit; they are ``rows`` of the goal's stack."""

    task: Task
    part: Part
    rows: slice
    name: str

    def size(self, e: Array) -> float:
        """Norm of the part's error [its unit]; e: errors of all rows."""
        return float(np.linalg.norm(e[self.rows]))


Missed = tuple[PartOfTask, float]
"""A part outside its tolerance, with its error."""


class Goal:
    """What tasks with a place, :func:`placed`, ask for at one time t [s].

    Attributes:
        state, stack: up to date after :meth:`look`.
        parts: of all tasks; their references start from the chain's start.
        weights: of the rows, at most 1; those of a later priority count less.
    """

    def __init__(
        self, chain: ClosedChain, tasks: Sequence[Task], t: float, inputs: InputValues | None = None
    ) -> None:
        self.chain, self.tasks, self.t = chain, tuple(tasks), t
        self.state = State(chain, t=t)
        self.state.inputs = inputs or InputValues()
        self.stack = TaskStack(tasks, State(chain))
        self.parts = tuple(parts_of(tasks, chain))
        counts = [_level_weight(task) for task in tasks]
        weights = np.repeat(counts, self.stack.sizes) if tasks else np.zeros(0)
        self.weights = weights / weights.max(initial=1e-12)
        self._counts = np.ones(len(weights))

    def masked(self, kept: Sequence[int]) -> Goal:
        """The same, with weight on some rows only, by their indices."""
        other = self.only(self.tasks)
        other._counts = np.isin(np.arange(len(self.weights)), kept).astype(float)
        other.weights = other.weights * other._counts
        return other

    def only(self, tasks: Sequence[Task]) -> Goal:
        return Goal(self.chain, tasks, self.t, self.state.inputs)

    def look(self, q: Array) -> None:
        self.state.q[:] = q
        self.state.update()
        self.stack.update(self.state)

    def errors(self) -> Array:
        """Error of each part at the last look [the part's unit]."""
        e = self._counts * self.stack.e
        return np.array([part.size(e) for part in self.parts])

    def missed(self, q: Array) -> tuple[Missed, ...]:
        """Parts that miss at a configuration, the most important first."""
        self.look(q)
        pairs = zip(self.parts, self.errors().tolist(), strict=True)
        missed = [(part, e) for part, e in pairs if not within(e, part.part.tolerance)]
        return tuple(sorted(missed, key=lambda p: (p[0].task.level, -p[1] / p[0].part.tolerance)))

    @property
    def miss(self) -> float:
        """Largest error over its tolerance at the last look; reached up to 1."""
        shares = self.errors() / [p.part.tolerance for p in self.parts]
        return float(shares.max(initial=0.0))

    @property
    def open(self) -> float:
        """Largest loop error at the last look [m, rad]."""
        return float(np.abs(self.state.e_loop).max(initial=0.0))


def parts_of(tasks: Sequence[Task], chain: ClosedChain) -> list[PartOfTask]:
    """Every part of every task, with its rows in their stack."""
    parts, at = [], 0
    for task in tasks:
        for part in task.parts(chain):
            name = f"{task.name}.{part.name}" if part.name else task.name
            parts.append(PartOfTask(task, part, slice(at, at + part.rows), name))
            at += part.rows
    return parts


def placed(tasks: Sequence[Task], chain: ClosedChain) -> tuple[Task, ...]:
    """Tasks that have a place."""
    return tuple(task for task in tasks if not task.asks_velocity and _has_place(task, chain))


def _has_place(task: Task, chain: ClosedChain) -> bool:
    """Whether J is the derivative of e near the start."""
    goal, step, sides = Goal(chain, [task], 0.0), DIFFERENCE * np.cos(np.arange(chain.n)), []
    for side in (step, -step, 0.0):
        goal.look(chain.q_start + side)
        sides.append(goal.stack.e.copy())
    slope, difference = goal.stack.J @ step * 2.0, sides[0] - sides[1]
    return bool(np.linalg.norm(slope - difference) <= AGREES * np.linalg.norm(slope) + 1e-12)


def _level_weight(task: Task) -> float:
    """By weight and priority; hard and scaled tasks before all soft ones."""
    if task.mode != "soft":
        return 10.0 * max(task.weight, 1.0)
    return float(max(task.weight, 1e-3) * PER_LEVEL**task.priority)


@dataclass(frozen=True)
class Place:
    """Where a search ended: q, shape (n,), errors e, shape (k,), the goal's miss.

    Valid where loops are closed and limits kept.
    """

    q: Array
    e: Array
    miss: float
    valid: bool

    @property
    def reached(self) -> bool:
        return self.valid and self.miss <= 1.0


class Search:
    """Searches for one goal, inside the limits where they are given."""

    def __init__(self, goal: Goal, room: Room | None = None) -> None:
        n = goal.chain.n
        self.goal, self.room = goal, room if room and room.rows else None
        self._violation = room.violation if room else lambda q: 0.0
        far = np.full(n, np.inf)
        self._bounds = (room.lower, room.upper) if room else (-far, far)
        self._steps = BoundedSteps(n, len(room.rows) if room else 0)
        self._root = np.sqrt(goal.weights)
        tolerances = np.repeat(
            [p.part.tolerance for p in goal.parts], [p.part.rows for p in goal.parts]
        )
        self._small = ENOUGH * tolerances * self._root

    def from_(self, q: Array) -> Place:
        """Descend from a configuration."""
        x = np.clip(q, *self._bounds)
        for weight in STAGES:
            self._down(x, weight)
        return self._place(x)

    def best(self, q: Array, restarts: int = RESTARTS, *, seed: int = 0) -> Place:
        """The best of several starts; the first that reaches the goal ends it."""
        found = self.from_(q)
        rng = np.random.default_rng(seed)
        for i in range(restarts):
            if found.reached:
                break
            other = self.from_(self._begin(rng, q, near=i % 2 == 0))
            if other.valid and (not found.valid or self.cost(other) < self.cost(found)):
                found = other
        return found

    def cost(self, place: Place) -> float:
        """The weighted sum of squares, e' W e."""
        return float((self._root * place.e) @ (self._root * place.e))

    def _begin(self, rng: np.random.Generator, q: Array, *, near: bool) -> Array:
        if near:
            return q + rng.normal(scale=NEAR, size=len(q))
        chain = self.goal.chain
        low = np.where(np.isfinite(chain.lower), chain.lower, chain.q_start - UNLIMITED)
        high = np.where(np.isfinite(chain.upper), chain.upper, chain.q_start + UNLIMITED)
        return rng.uniform(low, high)

    def _down(self, x: Array, weight: float) -> None:
        goal, room, heavy, k = self.goal, self.room, np.sqrt(weight), len(self._root)
        small, closed = self._small, 0.1 * CLOSED * heavy

        def residual(q: Array) -> tuple[Array, Array]:
            goal.look(q)
            r = [self._root * goal.stack.e, heavy * goal.state.e_loop]
            J = [self._root[:, None] * goal.stack.J, heavy * goal.state.J_loop]
            if room:
                rooms, way = room.both(q)
                r.append(heavy * np.minimum(rooms, 0.0))
                J.append(heavy * np.where(rooms[:, None] < 0.0, way, 0.0))
            return np.concatenate(r), np.vstack(J)

        def keep(q: Array) -> tuple[Array, Array]:
            assert room
            rooms, way = room.both(q)
            return -way, np.where(rooms >= 0.0, rooms, 1e6)

        def enough(r: Array) -> bool:
            return bool((np.abs(r[:k]) <= small).all() and np.abs(r[k:]).max(initial=0) <= closed)

        stop = Stop(STEPS, STEP, enough)
        self._steps.descend(x, residual, self._bounds, stop, keep if room else None)

    def _place(self, x: Array) -> Place:
        goal = self.goal
        goal.look(x)
        valid = goal.open < CLOSED and self._violation(x) < CLOSED
        return Place(x.copy(), goal.stack.e.copy(), goal.miss, valid)
