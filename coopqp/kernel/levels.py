"""The tasks of a problem as levels of rows, in the order of the plain law."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from coopqp.kernel.flat import Flat
from coopqp.qp_law.law import QPLaw
from coopqp.state import State
from coopqp.task import Task, TaskStack


@dataclass(frozen=True)
class Filled:
    """Rows of a task that Python fills, for the kernel to read.

    Attributes:
        e, J, rate: the task's part of a stack.
        level, at: where they go: level, and its first row.
        joints: whether J is the identity, so that the task has no rows there.
        weight, gain: of the task.
    """

    e: np.ndarray[tuple[int], np.dtype[np.float64]]
    J: np.ndarray[tuple[int, int], np.dtype[np.float64]]
    rate: np.ndarray[tuple[int], np.dtype[np.float64]]
    level: int
    at: int
    joints: bool
    weight: float
    gain: float


@dataclass
class _Rows:
    """Numbers of a level's rows, one each."""

    gain: list[float] = field(default_factory=list)
    weight: list[float] = field(default_factory=list)
    lever: list[float] = field(default_factory=list)
    asks_velocity: list[float] = field(default_factory=list)

    def take(self, task: Task, levers: np.ndarray[tuple[int], np.dtype[np.float64]]) -> None:
        count = len(levers)
        self.gain += [float(task.gain)] * count
        self.weight += [float(task.weight)] * count
        self.lever += levers.tolist()
        self.asks_velocity += [float(task.asks_velocity)] * count


class Levels:
    """The levels of a plain law, with its own stacks of rows.

    Args:
        law: whose tasks; its stacks are shared, so that a tick that is handed over to it finds
            them as they are.

    Attributes:
        flat: each level's numbers.
        filled: the rows that are read from the stacks.
    """

    def __init__(self, law: QPLaw) -> None:
        self.flat: list[Flat] = []
        self.filled: list[Filled] = []
        self._stacks = (*law.stacks, law.exact.hard)
        for level, soft in enumerate(law.stacks):
            hard = law.exact.hard if level == 0 else None
            self.flat.append(self._level(level, hard, soft))

    def update(self, state: State) -> None:
        """Fill the rows at a state."""
        for stack in self._stacks:
            stack.update(state)

    def _level(self, level: int, hard: TaskStack | None, soft: TaskStack) -> Flat:
        rows, joint_weight = _Rows(), 0.0
        for stack in (hard, soft) if hard else (soft,):
            for task, part in zip(stack.tasks, stack.slices, strict=True):
                joints = stack is soft and whole_joint_space(task)
                block = stack.e[part], stack.J[part], stack.rate[part]
                weight, gain = float(task.weight), float(task.gain)
                self.filled.append(Filled(*block, level, len(rows.gain), joints, weight, gain))
                if joints:
                    joint_weight += weight
                else:
                    rows.take(task, stack.levers[part])
        return {
            "gain": np.array(rows.gain),
            "weight": np.array(rows.weight),
            "lever": np.array(rows.lever),
            "asks_velocity": np.array(rows.asks_velocity),
            "twist": np.zeros(len(rows.gain)),
            "hard": float(len(hard.e) if hard else 0),
            "joint_weight": joint_weight,
        }


def whole_joint_space(task: Task) -> bool:
    """Whether a task's J is the identity in all rows, so that it decides whatever is left."""
    return task.joint_space and task.all_joints
