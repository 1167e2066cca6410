"""The tasks of a problem as levels of rows, in the order of the plain law."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from coopqp.kernel.flat import Flat
from coopqp.model.geometry import Reference
from coopqp.model.state import State
from coopqp.program import Programs, sees_twist
from coopqp.task import Task, TaskStack, levers_of


@dataclass(frozen=True)
class Filled:
    """A task whose rows Python fills, for the kernel to read.

    Attributes:
        stack: of this task alone.
        level, at: where its rows go: level, and the first of its rows.
        joints: whether J is the identity, so that the task has no rows there.
    """

    stack: TaskStack
    level: int
    at: int
    joints: bool

    @property
    def bound(self) -> tuple[Any, ...]:
        """What the kernel is to read, and where it goes."""
        (task,) = self.stack.tasks
        weight, gain = float(task.weight), float(task.gain)
        block = self.stack.e, self.stack.J, self.stack.rate
        return *block, self.level, self.at, self.joints, weight, gain


@dataclass
class _Rows:
    """Numbers of a level's rows, one each."""

    gain: list[float] = field(default_factory=list)
    weight: list[float] = field(default_factory=list)
    lever: list[float] = field(default_factory=list)
    asks_velocity: list[float] = field(default_factory=list)
    twist: list[float] = field(default_factory=list)
    share: list[float] = field(default_factory=list)

    def take(self, task: Task, levers: list[float], share: int, *, twist: bool) -> None:
        count = len(levers)
        self.gain += [float(task.gain)] * count
        self.weight += [float(task.weight)] * count
        self.lever += levers
        self.asks_velocity += [float(task.asks_velocity)] * count
        self.twist += [float(twist)] * count
        self.share += [float(share)] * count


@dataclass(frozen=True)
class Group:
    """The tasks of one level, by their modes.

    Attributes:
        soft, hard, scaled: those of each mode; later levels have soft ones alone.
    """

    soft: Sequence[Task]
    hard: Sequence[Task] = ()
    scaled: Sequence[Task] = ()


class Levels:
    """Tasks level by level.

    Args:
        groups: a level each.
        programs: of tasks, from the state from which their references set out.

    Attributes:
        flat: each level's numbers.
        primitives: the tasks that the kernel evaluates itself, as numbers.
        filled: the others.
        arriving: references whose place is an input and nothing else, and whose primitive each is;
            the kernel reads the input itself.
        followed: other references that signals move.
    """

    def __init__(self, groups: Sequence[Group], programs: Programs) -> None:
        self.flat: list[Flat] = []
        self.primitives: list[Flat] = []
        self.filled: list[Filled] = []
        self.arriving: list[tuple[int, Reference]] = []
        self.followed: list[tuple[int, Reference]] = []
        self._programs, self._start = programs, programs.start
        for level, group in enumerate(groups):
            self.flat.append(self._level(level, group))

    @property
    def compiled(self) -> bool:
        """Whether no rows are Python's."""
        return not self.filled

    @property
    def in_python(self) -> tuple[str, ...]:
        """Names of the tasks whose rows are."""
        return tuple(task.name for filled in self.filled for task in filled.stack.tasks)

    def follow(self, state: State) -> None:
        """Move the references that follow signals; kinematics need not be up to date."""
        state.lock()
        try:
            for _, reference in self.followed:
                reference.update(state)
        finally:
            state.unlock()

    def update(self, state: State) -> None:
        """Fill what Python fills, at a state."""
        self.follow(state)
        for task in self.filled:
            task.stack.update(state)

    def _level(self, level: int, group: Group) -> Flat:
        rows, joint_weight = _Rows(), 0.0
        first = list[float]()
        for task in group.hard:
            first.append(float(len(rows.gain)))
            self._take(level, task, rows)
        hard = len(rows.gain)
        for share, task in enumerate(group.scaled):
            self._take(level, task, rows, share)
        exact = len(rows.gain)
        for task in group.soft:
            joints = task.joint_space and task.all_joints
            self._take(level, task, rows, joints=joints)
            joint_weight += float(task.weight) if joints else 0.0
        numbers = {name: np.array(values, float) for name, values in vars(rows).items()}
        sizes = {"hard": hard, "exact": exact, "shares": len(group.scaled)}
        return {
            **numbers,
            **{name: float(size) for name, size in sizes.items()},
            "task": np.array(first),
            "joint_weight": joint_weight,
        }

    def _take(
        self, level: int, task: Task, rows: _Rows, share: int = -1, *, joints: bool = False
    ) -> None:
        """Add a task's rows to a level, as primitives where it has any."""
        program, at = self._programs.of(task), len(rows.gain)
        levers = levers_of(task, self._start.chain)
        if program is None or not all(p.compiles and p.of_joints == joints for p in program):
            self.filled.append(Filled(TaskStack([task], self._start), level, at, joints))
            if not joints:
                rows.take(task, levers, share, twist=False)
            return
        for primitive in program:
            if primitive.reference.follows:
                of_kind = self.arriving if primitive.reference.arrives else self.followed
                of_kind.append((len(self.primitives), primitive.reference))
            self.primitives.append(
                {
                    **primitive.flat(),
                    "level": float(level),
                    "at": float(at),
                    "weight": float(task.weight),
                    "gain": float(task.gain),
                }
            )
            at += len(primitive.rows)
        if not joints:
            count = at - len(rows.gain)
            rows.take(task, levers[:count], share, twist=sees_twist(program))
