"""Inverse kinematics inside or without the limits: the configuration nearest to a goal.

    minimise    e' W e + w_c |e_loop|^2 + w_c |room below zero|^2,   w_c = 30, then 1e4
    subject to  the bounds of the joints, and rows that keep the rooms there are

by bounded least squares (:mod:`coopqp.scenario.bounded_steps`). With a heavy w_c from the start the
steps would crawl along curved valleys. An answer counts only where the loops are closed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from coopqp.base.spec import Array
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
    """Where a search ended: q, the rows' errors e, shapes (n,) and (k,), and the goal's miss.

    It is valid where loops are closed and limits kept.
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
    """Searches for one goal, inside the limits where they are given."""

    def __init__(self, goal: Goal, room: Room | None = None) -> None:
        n = goal.chain.n
        self.goal, self.room = goal, room if room and room.rows else None
        self._overrun = room.overrun if room else lambda q: 0.0
        far = np.full(n, np.inf)
        self._bounds = (room.lower, room.upper) if room else (-far, far)
        self._steps = BoundedSteps(n, len(room.rows) if room else 0)
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
            """Rows that keep what room there is."""
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
        valid = goal.open < CLOSED and self._overrun(x) < CLOSED
        return Place(x.copy(), goal.stack.e.copy(), goal.miss, valid)
