"""What a tick was asked, and its answer: the arrays that an explanation reads."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from coopqp.checked import Array
from coopqp.controller import Command, ControlProblem
from coopqp.qp_law.bounds import Bounds
from coopqp.qp_law.safety import drift_gain
from coopqp.row import Row
from coopqp.solver import Status, causes_of
from coopqp.state import State
from coopqp.study.tick_record import TickRecord, bounding
from coopqp.task import Mode, TaskStack


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
    """What a tick is asked at a state with its joints inside their limits.

    Args:
        problem: what is controlled.
        state: up to date.
        tasks: those of the problem, up to date.
        command: the tick's answer.
    """
    bounds = Bounds(problem.chain, problem.limits, state, problem.dt)
    bounds.update(state)
    return Asked(
        causes=command.causes, dt=problem.dt,
        A=state.J_loop, b=state.e_loop * -drift_gain(problem, state),
        lb=bounds.lb, ub=bounds.ub, G=bounds.G, h=bounds.h,
        J=tasks.J, wanted=tasks.wanted, task_rows=tasks.rows,
        modes={task.name: task.mode for task in problem.tasks}, v=command.v,
        name_limits=lambda: [row for side in bounding(problem, state) for row in side]
        + [*bounds.rows],
    )  # fmt: skip
