"""What would be needed in all: the least total excess of the limits with which a goal holds.

    minimise    sum s_j + 4 sum sigma_l                              [rad, and m times 4 rad/m]
    subject to  e(q) = 0,   e_loop(q) = 0
                lower - s <= q <= upper + s,   room_k(q) >= -sigma_l,   s, sigma >= 0

with one s a joint and one sigma a limit in space (a wall moves as a whole). By sequential quadratic
programs from a configuration where the equalities hold already: begin outside the limits and
shrink. One radian counts as a quarter of a metre.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from coopqp.base.qp import QP, Row, Rows
from coopqp.base.spec import Array
from coopqp.solver import Solution
from coopqp.solvers import Daqp
from coopqp.study.explanation.goal import Goal
from coopqp.study.explanation.room import Room

#: Cost of a metre [rad], of a step [1/rad], and of what the equalities are off by.
METRE, PROXIMAL, OFF = 4.0, 0.05, 100.0
#: Steps, farthest that a joint goes in one [rad, m], how it shrinks, and where that ends.
STEPS, STEP, SHRINK, SMALLEST = 60, 0.3, 0.6, 1e-5
#: Newton steps after each, and a fall of the sum below which a step was none.
NEWTON, ENOUGH = 2, 1e-6
#: Singular values of the equalities below this ask nothing.
CUT = 1e-5
#: An excess below this is not named [rad, m].
NOTHING = 1e-4


@dataclass(frozen=True)
class Violation:
    """By how much one limit is exceeded.

    Attributes:
        row: of the limit, or the one that is broken most where it moves as a whole.
        amount: [rad or m].
        space: index of the limit in ``Room.limits``; None for a joint's.
    """

    row: Row
    amount: float
    space: int | None = None


def least_excess(goal: Goal, room: Room, starts: Sequence[Array]) -> list[Violation]:
    """The least of several local minima; none where the goal is lost from all starts.

    At these configurations the goal holds and the loops are closed.
    """
    programs = _Programs(goal, room)
    found = [excess for q in starts if (excess := programs.shrink(q)) is not None]
    return min(found, key=_total, default=[])


def excess_at(room: Room, qs: Array) -> list[Violation]:
    """The largest excess of each limit along configurations, shape (T, n)."""
    found = []
    for (i, side), row in room.sides.items():
        out = room.lower[i] - qs[:, i] if side == "lower" else qs[:, i] - room.upper[i]
        found.append(Violation(row, float(out.max())))
    rooms = np.array([room.at(q) for q in qs])
    for space in dict.fromkeys(room.owners):
        own = np.flatnonzero(np.array(room.owners) == space)
        row = room.rows[own[rooms[-1, own].argmin()]]
        found.append(Violation(row, float(-rooms[:, own].min()), space))
    return [excess for excess in found if excess.amount > NOTHING]


def _total(found: Sequence[Violation]) -> float:
    return sum(
        x.amount * (METRE if x.space is not None or x.row.unit == "m" else 1.0) for x in found
    )


class _Programs:
    """The quadratic program of a step; its variables are d, s and sigma."""

    def __init__(self, goal: Goal, room: Room) -> None:
        self._goal, self._room = goal, room
        n, k = goal.chain.n, len(room.limits)
        self._equal = len(goal.state.e_loop) + len(goal.stack.e)
        self._low = np.flatnonzero(np.isfinite(room.lower))
        self._high = np.flatnonzero(np.isfinite(room.upper))
        p = len(self._low) + len(self._high) + len(room.rows)
        variables = [f"d[{i}]" for i in range(n)] + [f"s[{i}]" for i in range(n + k)]
        self._qp = qp = QP(
            Rows(
                _numbered("joint", variables),
                _numbered("limit", [f"limit[{i}]" for i in range(p)]),
                _numbered("task", [f"goal[{i}]" for i in range(self._equal)]),
            )
        )
        np.fill_diagonal(qp.P, np.repeat([2.0 * PROXIMAL, 1e-6], [n, n + k]))
        per_joint = [METRE if unit == "m" else 1.0 for unit in goal.chain.joint_units]
        qp.q[n:] = [*per_joint, *[METRE] * k]
        qp.lb[n:], qp.ub[n:] = 0.0, 1e3
        self._fill_sides()
        self._solution = Solution(qp)
        self._solve = Daqp().open(qp, self._solution)

    def _fill_sides(self) -> None:
        """What does not change: d_j - s_j <= room, and the same below."""
        low, high, n = self._low, self._high, self._goal.chain.n
        joints, rows = np.concatenate([low, high]), np.arange(len(low) + len(high))
        self._qp.G[rows, joints] = np.repeat([-1.0, 1.0], [len(low), len(high)])
        self._qp.G[rows, n + joints] = -1.0
        spaces = len(joints) + np.arange(len(self._room.owners))
        self._qp.G[spaces, 2 * n + np.array(self._room.owners, int)] = -1.0

    def shrink(self, start: Array) -> list[Violation] | None:
        """A local minimum near a start; None where the goal is lost."""
        q, step = self._back(start), STEP
        merit, off = self._merit(q)
        if off >= 1.0:
            return None
        for _ in range(STEPS):
            d = self._step(q, step)
            if d is None or step < SMALLEST:
                break
            trial = self._back(q + d)
            trial_merit, off = self._merit(trial)
            if off < 1.0 and trial_merit < merit - ENOUGH:
                q, merit, step = trial, trial_merit, min(STEP, step / SHRINK)
            else:
                step *= SHRINK
        return excess_at(self._room, q[None])

    def _back(self, q: Array) -> Array:
        """Newton steps to where the equalities hold again, so that long steps can be taken."""
        for _ in range(NEWTON):
            C, r = self._equalities(q)
            q = q - np.linalg.lstsq(C, r, rcond=CUT)[0]
        return q

    def _equalities(self, q: Array) -> tuple[Array, Array]:
        """Jacobian and residual of loops and goal."""
        goal = self._goal
        goal.look(q)
        C = np.vstack([goal.state.J_loop, goal.stack.J])
        return C, np.concatenate([goal.state.e_loop, goal.stack.e])

    def _merit(self, q: Array) -> tuple[float, float]:
        """Excess and what the equalities are off by; the latter in tolerances as well."""
        room, goal = self._room, self._goal
        goal.look(q)
        joints = np.maximum(room.lower - q, q - room.upper).clip(0.0)
        total = float(joints @ self._qp.q[len(q) : 2 * len(q)])
        spaces = np.zeros(len(room.limits))
        np.maximum.at(spaces, np.array(room.owners, int), -room.at(q))
        off = np.abs(np.concatenate([goal.state.e_loop, goal.stack.e])).sum()
        missed = max(goal.miss, goal.open / 1e-4)
        return total + METRE * float(spaces.sum()) + OFF * float(off), missed

    def _step(self, q: Array, farthest: float) -> Array | None:
        room, qp, n = self._room, self._qp, len(q)
        C, r = self._equalities(q)
        U, values, Vt = np.linalg.svd(C, full_matrices=False)
        kept = int((values > CUT).sum())
        qp.A[:], qp.b[:] = 0.0, 0.0
        qp.A[:kept, :n] = Vt[:kept]
        qp.b[:kept] = -(U[:, :kept].T @ r) / values[:kept]
        qp.lb[:n], qp.ub[:n] = -farthest, farthest
        low, high = self._low, self._high
        sides = q[low] - room.lower[low], room.upper[high] - q[high]
        qp.h[:] = np.concatenate([*sides, room.at(q)])
        qp.G[len(low) + len(high) :, :n] = -room.gradient(q)
        qp.seal()
        self._solve()
        return self._solution.v[:n].copy() if self._solution.status.usable else None


def _numbered(kind: str, names: Sequence[str]) -> tuple[Row, ...]:
    return tuple(Row(name=name, kind=kind) for name in names)  # type: ignore[arg-type]
