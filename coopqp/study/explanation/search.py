"""Inverse kinematics inside or without the limits: the configuration nearest to a goal.

    minimise    e' W e + w_c |e_loop|^2 + w_c |room below zero|^2,   w_c = 30, then 1e4
    subject to  the bounds of the joints, and rows that keep the rooms there are

by bounded least squares (:mod:`coopqp.scenario.bounded_steps`). With a heavy w_c from the start the
steps would crawl along curved valleys. An answer counts only where the loops are closed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from coopqp.checked import Array
from coopqp.rank import null_space
from coopqp.scenario.bounded_steps import BoundedSteps, Stop
from coopqp.study.explanation.goal import Goal
from coopqp.study.explanation.room import Room

#: Weights w_c of the stages, steps of each, farthest that a joint goes in one [rad, m].
STAGES, STEPS, STEP = (30.0, 1e4), 60, 0.3
#: Loops open by less are closed, limits overrun by less are kept [m, rad].
CLOSED = 2e-4
#: A search ends where all is this small a share of the tolerances.
ENOUGH = 0.05
#: Random beginnings after the first.
RESTARTS = 12
#: How far a joint without limits is turned at random [rad, m], and near beginnings are away.
UNLIMITED, NEAR = 1.5, 0.5


@dataclass(frozen=True)
class Place:
    """Where a search ended.

    Attributes:
        q: configuration, shape (n,).
        e: errors of the rows, shape (k,).
        miss: largest error of a part over its tolerance.
        valid: whether loops are closed and limits kept.
    """

    q: Array
    e: Array
    miss: float
    valid: bool

    @property
    def reached(self) -> bool:
        """Whether all tasks hold there."""
        return self.valid and self.miss <= 1.0


class Search:
    """Searches for one goal.

    Args:
        goal: of the tasks.
        room: the limits; none when None.
    """

    def __init__(self, goal: Goal, room: Room | None = None) -> None:
        n = goal.chain.n
        self.goal, self.room = goal, room
        self._rooms = len(room.rows) if room else 0
        self._bounds = (
            (room.lower, room.upper) if room else (np.full(n, -np.inf), np.full(n, np.inf))
        )
        self._steps = BoundedSteps(n, self._rooms)
        self._root = np.sqrt(goal.weights)
        tolerances = np.repeat(
            [p.part.tolerance for p in goal.parts], [p.part.rows for p in goal.parts]
        )
        self._small = ENOUGH * tolerances * self._root

    def from_(self, q: Array) -> Place:
        """The way down from a configuration."""
        x = np.clip(q, *self._bounds)
        for weight in STAGES:
            self._down(x, weight)
        return self._place(x)

    def best(self, q: Array, restarts: int = RESTARTS, *, seed: int = 0) -> Place:
        """The best of several beginnings; the first that reaches the goal ends it."""
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
        heavy, k = np.sqrt(weight), len(self._root)
        small, closed = self._small, 0.1 * CLOSED * heavy

        def residual(q: Array) -> tuple[Array, Array]:
            goal = self.goal
            goal.look(q)
            r = [self._root * goal.stack.e, heavy * goal.state.e_loop]
            J = [self._root[:, None] * goal.stack.J, heavy * goal.state.J_loop]
            if self._rooms:
                broken, way = self._below(q)
                r.append(heavy * broken)
                J.append(heavy * way)
            return np.concatenate(r), np.vstack(J)

        def enough(r: Array) -> bool:
            return bool((np.abs(r[:k]) <= small).all() and np.abs(r[k:]).max(initial=0) <= closed)

        stop = Stop(STEPS, STEP, enough)
        self._steps.descend(x, residual, self._bounds, stop, self._keep if self._rooms else None)

    def _below(self, q: Array) -> tuple[Array, Array]:
        """Rooms below zero, and how they change; zero where there is room."""
        assert self.room
        rooms, way = self.room.at(q), self.room.gradient(q)
        self._last = rooms, way, q.copy()
        below = rooms < 0.0
        return np.where(below, rooms, 0.0), np.where(below[:, None], way, 0.0)

    def _keep(self, q: Array) -> tuple[Array, Array]:
        """Rows that keep what room there is."""
        assert self.room
        rooms, way, at = self._last
        if not np.array_equal(at, q):
            rooms, way = self.room.at(q), self.room.gradient(q)
        return -way, np.where(rooms >= 0.0, rooms, 1e6)

    def _place(self, x: Array) -> Place:
        goal = self.goal
        goal.look(x)
        valid = goal.open < CLOSED and (not self.room or self.room.overrun(x) < CLOSED)
        return Place(x.copy(), goal.stack.e.copy(), goal.miss, valid)


def free_of_loops(goal: Goal, q: Array) -> Array:
    """Orthonormal basis Z of the motions that keep the loops closed at q, shape (n, f)."""
    goal.look(q)
    return null_space(goal.state.J_loop)
