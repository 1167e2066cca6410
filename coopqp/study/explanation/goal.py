"""Goals and position limits as geometry, and the configuration nearest to a goal.

A task has a place where e is a function of q with the Jacobian J: not a twist, nor an objective
that is only written as rows, such as joint centring. Inside the limits or without them

    minimise    e' W e + w_c |e_loop|^2 + w_c |negative clearances|^2,   w_c = 30, then 1e4
    subject to  joint limits, and rows that keep the clearances

by bounded least squares (:mod:`coopqp.scenario.bounded_steps`). With a heavy w_c from the start the
steps would crawl along curved valleys. An answer counts only where the loops are closed. Joint
limits bound q; limits in space give a clearance (:meth:`coopqp.limit.Limit.clearance`); those of
speeds are not in here.

Which limits hold the tasks back is said by multipliers. Where e' W e is minimal subject to closed
loops and limits, with n_i the joint motion that violates limit i,

    J' W e + J_c' lambda + sum mu_i n_i = 0,   mu_i >= 0

Projected on Z = null(J_c) the mu_i are a non-negative least squares problem. The share of limit i
is mu_i |Z' n_i|.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from coopqp.assessment.limits import audit
from coopqp.assessment.thresholds import within
from coopqp.base.qp import Row
from coopqp.base.spec import Array
from coopqp.controller import ControlProblem
from coopqp.execution import instants
from coopqp.limit import Clearance, DistanceBounds, Limit, LimitRows, Program
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.state import State
from coopqp.scenario.bounded_steps import BoundedSteps, Stop
from coopqp.signal import InputValues
from coopqp.task import Part, Task, TaskStack

PLACE_UNITS = ("m", "rad")
#: This near to it a limit is at its bound [rad, m].
AT_BOUND = 1e-4
#: A limit with a smaller share is idle, and never named.
IDLE = 0.01


class PositionLimits:
    """The position limits of a problem, with the programs of the limits where these are known.

    Attributes:
        lower, upper: of the joints, infinite without limits, shape (n,) [rad, m].
        sides: the row of each finite joint bound, by index and side.
        limits, rows: limits in space, and rows of their p clearances.
        all_rows: of the s sides, then of the clearances.
        owners: index of what each of these rows belongs to: a side, or s and an index in limits.
    """

    def __init__(self, problem: ControlProblem, programs: Sequence[Program | None] = ()) -> None:
        chain = self.chain = problem.chain
        self._dt = problem.dt
        self.lower, self.upper = np.full(chain.n, -np.inf), np.full(chain.n, np.inf)
        self.sides: dict[tuple[int, str], Row] = {}
        self.limits: list[Limit] = []
        self._state = State(chain)
        self._kept: tuple[Array, Array, Array] | None = None
        q, v = np.vstack([chain.q_start] * 2), np.zeros((1, chain.n))
        for limit, program in itertools.zip_longest(problem.limits, programs):
            if isinstance(program, DistanceBounds) or limit.clearance(chain) is not None:
                self.limits.append(limit)
                continue
            for row, margin in audit([limit], chain, q, v, problem.dt).margins.items():
                if row.joint and row.side and row.unit in PLACE_UNITS:
                    self._bound(row, float(margin[0]))

    def _bound(self, row: Row, margin: float) -> None:
        i, below = self.chain.joint_names.index(row.joint), row.side == "lower"
        end = float(self.chain.q_start[i]) + (-margin if below else margin)
        if end > self.lower[i] if below else end < self.upper[i]:
            (self.lower if below else self.upper)[i] = end
            # Two limits of one place, such as braking before a stop, are one to people.
            label = row.label.rpartition(" of ")[2]
            self.sides[i, str(row.side)] = replace(row, label=label)

    @cached_property
    def _spaces(self) -> list[tuple[tuple[Row, ...], Clearance, Callable[[State], Array]]]:
        """Rows, clearances and their gradient of each limit in space."""
        spaces = []
        for limit in self.limits:
            if left := limit.clearance(self.chain):
                rows = limit.rows(self.chain)[: len(left(self._state))]
                spaces.append((rows, left, _slope(limit, self.chain, self._dt, len(rows))))
        return spaces

    @cached_property
    def rows(self) -> tuple[Row, ...]:
        return tuple(row for rows, _, _ in self._spaces for row in rows)

    @cached_property
    def all_rows(self) -> tuple[Row, ...]:
        return (*self.sides.values(), *self.rows)

    @cached_property
    def owners(self) -> NDArray[np.intp]:
        sides = len(self.sides)
        spaces = (sides + i for i, (rows, _, _) in enumerate(self._spaces) for _ in rows)
        return np.array([*range(sides), *spaces], np.intp)

    def at(self, q: Array) -> Array:
        """Clearances of the limits in space at a configuration, shape (p,) [m]."""
        if self._spaces and not np.array_equal(self._state.q, q):
            self._state.q[:] = q
            self._state.update()
        left = (left(self._state) for _, left, _ in self._spaces)
        return np.concatenate([np.zeros(0), *left])

    def both(self, q: Array) -> tuple[Array, Array]:
        """Clearances and their gradient, shape (p, n), cached until q changes."""
        if self._kept is None or not np.array_equal(self._kept[2], q):
            clearances = self.at(q)
            slopes = (slope(self._state) for _, _, slope in self._spaces)
            self._kept = clearances, np.vstack([np.zeros((0, len(q))), *slopes]), q.copy()
        return self._kept[:2]

    def slack(self, q: Array) -> Array:
        """What all rows have left at a configuration, shape (s + p,) [rad, m]."""
        sides = [
            q[i] - self.lower[i] if side == "lower" else self.upper[i] - q[i]
            for i, side in self.sides
        ]
        return np.concatenate([sides, self.at(q)])

    def ways(self, q: Array) -> Array:
        """The joint motion that violates each row, shape (s + p, n)."""
        eye = np.eye(len(q))
        sides = [-eye[i] if side == "lower" else eye[i] for i, side in self.sides]
        return np.vstack([*sides, -self.both(q)[1]])

    def violation(self, q: Array) -> float:
        """Largest violation at a configuration [rad, m]."""
        return -float(self.slack(q).min(initial=0.0))

    def at_bound(self, q: Array) -> list[tuple[Row, Array]]:
        """Active limits, each with the joint motion that violates it."""
        found = zip(self.all_rows, self.slack(q), self.ways(q), strict=True)
        return [(row, way) for row, left, way in found if left < AT_BOUND]


def _slope(limit: Limit, chain: ClosedChain, dt: float, count: int) -> Callable[[State], Array]:
    """Gradient of a limit's clearances, shape (count, n)."""
    tighten, p = limit.bind(chain, dt), len(limit.rows(chain))
    G, h, (lb, ub) = np.zeros((p, chain.n)), np.zeros(p), np.zeros((2, chain.n))

    def slope(state: State) -> Array:
        lb[:] = ub[:] = 0.0  # at rest the rows of a limit are those of its clearances
        tighten(state, LimitRows(lb, ub, G, h))
        return -G[:count]

    return slope


@dataclass(frozen=True)
class Share:
    """The row of a limit, with its share of all limits' forces, 0 to 1."""

    row: Row
    share: float


def forces(pull: Array, Z: Array, ways: Sequence[tuple[Row, Array]]) -> list[tuple[Row, float]]:
    """mu_i |Z' n_i| of limits with joint motions n_i, which balance pull = -Z' J' W e."""
    from scipy.optimize import nnls  # its import takes a sixth of a second

    within = [(row, Z.T @ way) for row, way in ways]
    within = [(row, way) for row, way in within if np.linalg.norm(way) > 1e-9]
    if not within:
        return []
    columns = np.column_stack([way for _, way in within])
    amounts = nnls(columns, pull)[0] * np.linalg.norm(columns, axis=0)
    return [(row, float(amount)) for (row, _), amount in zip(within, amounts, strict=True)]


def least_relaxation(
    equal: tuple[Array, Array],
    limits: tuple[Array, Array],
    owners: NDArray[np.intp],
    costs: Sequence[float],
    max_step: float = np.inf,
) -> tuple[Array, Array] | None:
    """A motion d with the cheapest relaxations r of limits, by an open solver (HiGHS).

        minimise    costs' r
        subject to  A d = b,   W d - r[owners] <= left,   r >= 0,   |d_i| <= max_step

    ``equal`` is A and b, ``limits`` is W and left. None where no relaxation is enough.
    """
    from scipy.optimize import linprog  # its import takes a sixth of a second

    (A, b), (W, left), n, count = equal, limits, limits[0].shape[1], len(costs)
    bounded = np.isfinite(left)
    result = linprog(
        np.concatenate([np.zeros(n), costs]),
        A_ub=np.hstack([W, -np.eye(count)[owners]])[bounded],
        b_ub=left[bounded],
        A_eq=np.hstack([A, np.zeros((len(A), count))]),
        b_eq=b,
        bounds=[(-max_step, max_step)] * n + [(0.0, None)] * count,
    )
    return (result.x[:n], result.x[n:]) if result.success else None


def shares(forces: Iterable[tuple[Row, float]]) -> tuple[Share, ...]:
    """The limits' shares, largest first; forces on corners or sides of one limit are summed."""
    by_thing: dict[str, list[tuple[Row, float]]] = {}
    for row, amount in forces:
        by_thing.setdefault(thing_of(row), []).append((row, amount))
    sums = [sum(amount for _, amount in own) for own in by_thing.values()]
    total = max(sum(sums), 1e-300)
    leaders = [max(own, key=lambda one: one[1])[0] for own in by_thing.values()]
    every = (Share(row, amount / total) for row, amount in zip(leaders, sums, strict=True))
    return tuple(sorted((s for s in every if s.share >= IDLE), key=lambda share: -share.share))


def thing_of(row: Row) -> str:
    """What a row is a side or a corner of: a joint's row itself, else the limit."""
    return row.name if row.joint or row.side else row.owner


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
        firm = [10.0 * max(task.weight, 1.0) for task in tasks]  # hard and scaled ones come first
        soft = [max(task.weight, 1e-3) * PER_LEVEL**task.priority for task in tasks]
        counts = np.where([task.mode == "soft" for task in tasks], soft, firm)
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
    asked = [(task, part) for task in tasks for part in task.parts(chain)]
    named = zip(asked, instants.parts_of(tasks, chain), strict=True)
    return [PartOfTask(task, part, rows, info.name) for (task, part), (info, rows) in named]


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


@dataclass(frozen=True)
class Place:
    """Where a search ended."""

    q: Array  # shape (n,)
    e: Array  # errors, shape (k,)
    miss: float  # the goal's
    valid: bool  # whether loops are closed and limits kept

    @property
    def reached(self) -> bool:
        return self.valid and self.miss <= 1.0


class Search:
    """Searches for one goal, inside the limits where they are given."""

    def __init__(self, goal: Goal, bounds: PositionLimits | None = None) -> None:
        n = goal.chain.n
        self.goal, self.bounds = goal, bounds if bounds and bounds.rows else None
        self._violation = bounds.violation if bounds else lambda q: 0.0
        far = np.full(n, np.inf)
        self._box = (bounds.lower, bounds.upper) if bounds else (-far, far)
        self._steps = BoundedSteps(n, len(bounds.rows) if bounds else 0)
        self._root = np.sqrt(goal.weights)
        tolerances = [p.part.tolerance for p in goal.parts for _ in range(p.part.rows)]
        self._small = ENOUGH * np.array(tolerances) * self._root

    def from_(self, q: Array) -> Place:
        x = np.clip(q, *self._box)
        for weight in STAGES:
            self._down(x, weight)
        goal = self.goal
        goal.look(x)
        valid = goal.open < CLOSED and self._violation(x) < CLOSED
        return Place(x.copy(), goal.stack.e.copy(), goal.miss, valid)

    def best(self, q: Array) -> Place:
        """The best of several starts; the first that reaches the goal ends it."""
        best, rng = self.from_(q), np.random.default_rng(0)
        for i in range(RESTARTS):
            if best.reached:
                break
            other = self.from_(self._begin(rng, q, near=i % 2 == 0))
            if other.valid and (not best.valid or self.cost(other) < self.cost(best)):
                best = other
        return best

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
        goal, bounds, heavy, k = self.goal, self.bounds, np.sqrt(weight), len(self._root)
        small, closed = self._small, 0.1 * CLOSED * heavy

        def residual(q: Array) -> tuple[Array, Array]:
            goal.look(q)
            r = [self._root * goal.stack.e, heavy * goal.state.e_loop]
            J = [self._root[:, None] * goal.stack.J, heavy * goal.state.J_loop]
            if bounds:
                clearances, way = bounds.both(q)
                r.append(heavy * np.minimum(clearances, 0.0))
                J.append(heavy * np.where(clearances[:, None] < 0.0, way, 0.0))
            return np.concatenate(r), np.vstack(J)

        def keep(q: Array) -> tuple[Array, Array]:
            assert bounds
            clearances, way = bounds.both(q)
            return -way, np.where(clearances >= 0.0, clearances, 1e6)

        def enough(r: Array) -> bool:
            return bool((np.abs(r[:k]) <= small).all() and np.abs(r[k:]).max(initial=0) <= closed)

        stop = Stop(STEPS, STEP, enough)
        self._steps.descend(x, residual, self._box, stop, keep if bounds else None)
