"""Whether a hard task ends farther off than as a soft one of priority 0.

Where a rollout rests short of a hard task, it goes on from there twice: with that task soft, of
priority 0, the other soft ones one priority lower and the rest as it is, and as it was. Both begin
at the same pose, so that the way there has no part in it: what is asked is whether the hard task
rests nearest among the poses around. It does by any law that puts hard tasks above soft ones, for
whatever is below a level takes nothing from it; this holds one task at a time, too, where several
are hard.
"""

from __future__ import annotations

import copy
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from coopqp.controller import ControlProblem, Law
from coopqp.model.state import Memory, State
from coopqp.task import Task, TaskStack

from . import signs
from .draw import LAW
from .driving import record_of
from .signs import Record

TICKS = 400  # of each of the two; the least gain, 8.3 / s at 5 ms, leaves e^-17 of an error
NEARER, SHARE = 2e-4, 0.01  # how much farther off counts: this [m, rad], and more than this share
LOWEST = 9  # priority


def missed_hard_tasks(problem: ControlProblem, state: State, record: Record) -> list[int]:
    """Hard tasks that a rollout rests short of, so that they could be nearer; their indices."""
    moves = any(task.asks_velocity for task in problem.tasks) or not _rests(state, record)
    hard = [i for i, task in enumerate(problem.tasks) if task.mode == "hard"]
    if moves or not hard or problem.on_infeasible != "scale":
        return []
    errors = _errors(problem, state)
    return [i for i in hard if errors[i] > NEARER]


def worse_than_soft(law: Law, state: State, i: int) -> Iterator[str]:
    """In words, if the i-th task is farther off than it is as a soft one; where both rest."""
    problem = law.problem
    soft = _goes_on(LAW.unprepared(as_soft(problem, problem.tasks[i])), _from(state), i)
    if soft is None or soft > _allowed(_errors(problem, state)[i]):
        return
    hard = _goes_on(law, _from(state, copy.copy(state.memory)), i)
    if hard is not None and soft < _allowed(hard):
        yield (
            f"{problem.tasks[i].name} rests {1e3 * hard:.4g} mm or mrad off, "
            f"{1e3 * soft:.4g} as soft of priority 0"
        )


def as_soft(problem: ControlProblem, firm: Task) -> ControlProblem:
    """The same with a firm task as the first of the soft ones."""

    def softened(task: Task) -> Task:
        if task is firm:
            return replace(task, mode="soft", priority=0)
        if task.mode == "soft":
            return replace(task, priority=min(task.priority + 1, LOWEST))
        return task

    return replace(problem, tasks=tuple(map(softened, problem.tasks)))


def _from(state: State, memory: Memory | None = None) -> State:
    """A state of its own that begins where another one is."""
    own = State(state.chain, state.q.copy(), state.t, memory)
    own.v[:] = state.v
    return own


def _allowed(hard: float) -> float:
    """Below this a soft task is nearer than a hard one [m, rad]."""
    return hard - max(NEARER, SHARE * hard)


def _goes_on(law: Law, state: State, i: int) -> float | None:
    """A task's error where a law comes to rest [m, rad]; None where it does not."""
    made, record = law.run(state, TICKS), record_of(law.problem)
    record.q, record.v = made.q, made.v
    return float(_errors(law.problem, state)[i]) if _rests(state, record) else None


def _rests(state: State, record: Record) -> bool:
    return signs.outside(record) <= signs.EXCESS and signs.at_rest(record)


def _errors(problem: ControlProblem, state: State) -> list[float]:
    """Error of each task, its rows in m and rad, as the law weighs them."""
    stack = TaskStack(problem.tasks, State(problem.chain))
    stack.update(state)
    return [float(np.linalg.norm(stack.e[rows])) for rows in stack.slices]
