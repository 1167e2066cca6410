"""Rows of tasks on wrenches of the hands, stacked: C h = wanted."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np

from coopqp.base.qp import Row
from coopqp.base.spec import Array
from coopqp.closed_loop.screw import LENGTH
from coopqp.model.state import State
from coopqp.task import Task, TaskRows, evaluate_all


class WrenchStack:
    """The rows of several tasks with ``of_forces``, whose references begin at a state.

    Attributes:
        tasks: as given.
        rows: such as "task[internal_wrench].squeeze".
        slices: of each task's rows. sizes: their numbers.
        C: shape (r, 6 N), on wrenches of the hands that hold, each at its point, in world axes.
        wanted: shape (r,) [N, N m].
        weights: of the rows; torques count as forces at LENGTH.
        hard: which of them must hold, shape (r,).
        priorities: of the rows, shape (r,).
    """

    def __init__(self, tasks: Sequence[Task], start: State) -> None:
        chain = start.chain
        self.tasks = tuple(tasks)
        self.rows = tuple(
            Row(name=f"task[{task.name}].{name}", kind="task", owner=task.name, unit=unit)
            for task in tasks
            for name, unit in zip(task.rows(chain), _units(task, start), strict=True)
        )
        self.sizes = tuple(len(task.rows(chain)) for task in tasks)
        ends = list(itertools.accumulate(self.sizes, initial=0))
        self.slices = tuple(slice(a, b) for a, b in itertools.pairwise(ends))
        self.C, self.wanted = np.zeros((ends[-1], 6 * chain.holding)), np.zeros(ends[-1])
        turns = np.array([row.unit == "N m" for row in self.rows], bool)
        self.weights = np.repeat([float(task.weight) for task in tasks], self.sizes)
        self.weights[turns] /= LENGTH**2
        self.hard = np.repeat([task.mode == "hard" for task in tasks], self.sizes).astype(bool)
        self.priorities = np.repeat([task.priority for task in tasks], self.sizes).astype(int)
        e = np.zeros(ends[-1])
        self._evaluate = [
            (task.bind(start), TaskRows(e[part], self.C[part], self.wanted[part]))
            for task, part in zip(tasks, self.slices, strict=True)
        ]

    def update(self, state: State) -> None:
        """Fill all rows for a state."""
        evaluate_all(self._evaluate, state)

    def error(self, h: Array) -> Array:
        """C h - wanted, shape (r,), for wrenches of the hands that hold, shape (N, 6) [N, N m]."""
        return np.asarray(self.C @ np.ravel(h) - self.wanted, float)


def _units(task: Task, start: State) -> list[str]:
    return [part.unit for part in task.parts(start.chain) for _ in range(part.rows)]
