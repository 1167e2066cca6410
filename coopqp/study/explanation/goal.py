"""Where tasks want the arms to be in the end: their errors at any configuration, and the loops'.

A task has a place where e is a function of q with the Jacobian J. A twist has none, and neither
have wishes that are only written as rows, such as joint centring.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from coopqp.assessment.thresholds import within
from coopqp.base.spec import Array
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.state import State
from coopqp.signal import InputValues
from coopqp.task import Part, Task, TaskStack

#: A step and how well J must agree with the differences of e for a task to have a place.
STEP, AGREES = 1e-6, 1e-3
#: What a level of priority counts less than the one before it, and hard tasks more than all.
PER_LEVEL = 0.1


@dataclass(frozen=True)
class PartOfTask:
    """Rows of a task that share a unit; they are ``rows`` of the goal's stack."""

    task: Task
    part: Part
    rows: slice
    name: str

    def size(self, e: Array) -> float:
        """Its error, of those of all rows [its unit]."""
        return float(np.linalg.norm(e[self.rows]))


Missed = tuple[PartOfTask, float]
"""A part outside its tolerance, with its error."""


class Goal:
    """What tasks with a place, :func:`placed`, ask for at one time t [s].

    Attributes:
        state, stack: up to date after :meth:`look`.
        parts: of all tasks; their references set out from the chain's start.
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
        """The same, but only some rows count, by their indices."""
        other = self.only(self.tasks)
        other._counts = np.isin(np.arange(len(self.weights)), kept).astype(float)
        other.weights = other.weights * other._counts
        return other

    def only(self, tasks: Sequence[Task]) -> Goal:
        """The same for some of the tasks."""
        return Goal(self.chain, tasks, self.t, self.state.inputs)

    def look(self, q: Array) -> None:
        """Bring state and stack to a configuration."""
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
        """How far the loops are open at the last look [m, rad]."""
        return float(np.abs(self.state.e_loop).max(initial=0.0))


def parts_of(tasks: Sequence[Task], chain: ClosedChain) -> list[PartOfTask]:
    """Every part of every task, with its rows in their stack."""
    found, at = [], 0
    for task in tasks:
        for part in task.parts(chain):
            name = f"{task.name}.{part.name}" if part.name else task.name
            found.append(PartOfTask(task, part, slice(at, at + part.rows), name))
            at += part.rows
    return found


def placed(tasks: Sequence[Task], chain: ClosedChain) -> tuple[Task, ...]:
    """Those that have a place."""
    return tuple(task for task in tasks if not task.asks_velocity and _has_place(task, chain))


def _has_place(task: Task, chain: ClosedChain) -> bool:
    """Whether J is the derivative of e near the start."""
    goal, step, sides = Goal(chain, [task], 0.0), STEP * np.cos(np.arange(chain.n)), []
    for side in (step, -step, 0.0):
        goal.look(chain.q_start + side)
        sides.append(goal.stack.e.copy())
    slope, difference = goal.stack.J @ step * 2.0, sides[0] - sides[1]
    return bool(np.linalg.norm(slope - difference) <= AGREES * np.linalg.norm(slope) + 1e-12)


def _level_weight(task: Task) -> float:
    """A soft task by weight and priority; the others before all soft ones."""
    if task.mode != "soft":
        return 10.0 * max(task.weight, 1.0)
    return float(max(task.weight, 1e-3) * PER_LEVEL**task.priority)
