"""What a tick was asked, and its answer: kept, now, or looked at again; what held it back.

In ticks in which the tasks were not followed, multipliers tell what held them back:

    minimise |Z' (J' W (wanted - J v) - sum mu_i n_i)|,   mu_i >= 0

with n_i the limits at their bound in that tick, Z the motions that keep the loops closed. Of a run
the shares mu_i |Z' n_i| are summed over the ticks, each by |J v - wanted|.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from coopqp.assessment.thresholds import AT_LIMIT
from coopqp.base.qp import Row
from coopqp.base.rank import null_space
from coopqp.base.spec import Array
from coopqp.controller import Command, ControlProblem
from coopqp.model.state import State
from coopqp.qp_law.bounds import Bounds
from coopqp.qp_law.safety import drift_gain
from coopqp.solver import Status, causes_of
from coopqp.study.explanation.explained_phase import ExplainedPhase
from coopqp.study.explanation.room import PLACE_UNITS
from coopqp.study.explanation.shares import Share, forces, shares
from coopqp.study.tick_record import NamedBounds, TickRecord
from coopqp.task import Mode, TaskStack

#: Most ticks of a run that are looked at, and what one is off by to count [m/s, rad/s].
TICKS, BEHIND = 150, 1e-3


@dataclass(frozen=True, kw_only=True)
class Asked:
    """A tick without its solver's program.

    Attributes:
        causes: what became of it.
        dt: control period [s].
        A, b: rows of the closed loops, A v = b.
        lb, ub, G, h: the limits, lb <= v <= ub and G v <= h.
        J, wanted, task_rows: rows of all tasks, J v = wanted.
        modes: soft, hard or scaled, by the task's name.
        v: the answer; beside velocities it may have the shares of scaled tasks.
        name_limits: finds ``limit_rows``, which few need.
    """

    causes: tuple[Status, ...]
    dt: float
    A: Array
    b: Array
    lb: Array
    ub: Array
    G: Array
    h: Array
    J: Array
    wanted: Array
    task_rows: Sequence[Row]
    modes: Mapping[str, Mode]
    v: Array
    name_limits: Callable[[], Sequence[Row]]

    @cached_property
    def slack(self) -> Array:
        """What the answer leaves of lb, ub and h."""
        return np.concatenate([self.v - self.lb, self.ub - self.v, self.h - self.G @ self.v])

    @cached_property
    def limit_rows(self) -> Sequence[Row]:
        """The limits that lb, ub and h come from, in this order."""
        return self.name_limits()

    def at_limits(self, near: float) -> list[tuple[Row, Array]]:
        """Those that the answer is so near to, each with the joint motion that breaks it."""
        eye = np.eye(len(self.v))
        ways = np.vstack([-eye, eye, self.G])
        at = np.flatnonzero(self.slack < near).tolist()
        return [(self.limit_rows[i], ways[i]) for i in at]

    def forces(self, near: float, weights: Array | float = 1.0) -> list[tuple[Row, float]]:
        """What holds the tasks back of what the answer is so near to, by :func:`forces`."""
        Z, missed = null_space(self.A), self.wanted - self.J @ self.v
        return forces(Z.T @ self.J.T @ (weights * missed), Z, self.at_limits(near))


def asked_then(record: TickRecord) -> Asked:
    """What a kept tick was asked; hard and scaled tasks are tasks here."""
    qp = record.qp()
    loops = [i for i, row in enumerate(record.equality_rows) if row.kind == "loop"]
    return Asked(
        causes=causes_of(record.status), dt=record.dt,
        A=qp.A[loops], b=qp.b[loops], lb=qp.lb, ub=qp.ub, G=qp.G, h=qp.h,
        J=np.array(record.J).reshape(-1, qp.n), wanted=np.array(record.wanted),
        task_rows=record.task_rows, modes=record.modes, v=np.array(record.answer),
        name_limits=lambda: [*record.lb_rows, *record.ub_rows, *record.inequality_rows],
    )  # fmt: skip


def asked_now(problem: ControlProblem, state: State, tasks: TaskStack, command: Command) -> Asked:
    """What a tick is asked at a state with its joints inside their limits, and its answer.

    State and tasks are up to date.
    """
    bounds = Bounds(problem.chain, problem.limits, state, problem.dt)
    bounds.update(state)
    return Asked(
        causes=command.causes, dt=problem.dt,
        A=state.J_loop, b=state.e_loop * -drift_gain(problem, state),
        lb=bounds.lb, ub=bounds.ub, G=bounds.G, h=bounds.h,
        J=tasks.J, wanted=tasks.wanted, task_rows=tasks.rows,
        modes={task.name: task.mode for task in problem.tasks}, v=command.v,
        name_limits=lambda: NamedBounds(problem, state).rows,
    )  # fmt: skip


class TickBatch:
    """The ticks of a leg, whose law commands velocities, looked at again one by one.

    State and stack of tasks are those of the last that was looked at.
    """

    def __init__(self, leg: ExplainedPhase) -> None:
        self._leg, problem = leg, leg.problem
        self.state = State(problem.chain)
        self.stack = TaskStack(problem.tasks, State(problem.chain))

    def look(self, k: int) -> Array:
        """Bring all to tick k; what its tasks missed, wanted - J v."""
        state, leg = self.state, self._leg
        state.q[:], state.t = leg.q[k], k * leg.problem.dt
        state.v[:] = leg.v[k - 1] if k else 0.0
        state.inputs = leg.followed(k)
        state.update()
        self.stack.update(state)
        return np.asarray(self.stack.wanted - self.stack.J @ leg.v[k], float)

    @cached_property
    def _limits(self) -> NamedBounds:
        return NamedBounds(self._leg.problem, self.state)

    def forces(self, k: int) -> list[tuple[Row, float]]:
        """What held tick k back, each limit with its force; their sum is what was missed."""
        missed, leg, stack, state = self.look(k), self._leg, self.stack, self.state
        if np.abs(missed).max(initial=0.0) <= BEHIND:
            return []
        limits = self._limits
        limits.update(state)
        tick = Asked(
            causes=leg.causes[k], dt=leg.problem.dt,
            A=state.J_loop, b=state.e_loop * -drift_gain(leg.problem, state),
            lb=limits.lb, ub=limits.ub, G=limits.G, h=limits.h,
            J=stack.J, wanted=stack.wanted, task_rows=stack.rows, modes={}, v=leg.v[k],
            name_limits=lambda: limits.rows,
        )  # fmt: skip
        found = tick.forces(AT_LIMIT, stack.weights)
        total, size = sum(amount for _, amount in found), float(np.linalg.norm(missed))
        return [(row, amount / total * size) for row, amount in found if total > 0.0]


def held_up(leg: ExplainedPhase, ticks: range | None = None) -> tuple[Share, ...]:
    """Which limits held a run up in some ticks or all, the largest share first."""
    look, ticks = TickBatch(leg), ticks or range(len(leg.v))
    some = ticks[:: max(1, len(ticks) // TICKS)]
    return shares(force for k in some for force in look.forces(k))


def speed_share(shares: Sequence[Share]) -> float:
    """What limits of speeds and accelerations, and of no place, have of the force."""
    rates = (s for s in shares if not s.row.of_place and s.row.unit not in PLACE_UNITS)
    return sum(share.share for share in rates)
