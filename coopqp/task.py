"""What a task is: an error e(q, t) with as many rows as the task has dimensions.

Letters: n joints, k task rows. A task asks that its error decay, e_dot = -gain e. With

    e_dot = J v - rate

(J the task Jacobian, shape (k, n); rate what the reference's own motion adds, shape (k,)) this
becomes J v = rate - gain e, the rows h_dot of the paper's eq. (32).
"""

from __future__ import annotations

import itertools
import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Annotated, Any, ClassVar, Literal, TypeVar

import numpy as np
from pydantic import Field, ValidationInfo, field_validator

from coopqp.base.errors import InvalidValueError
from coopqp.base.qp import Row
from coopqp.base.spec import Array, NonNegative, Positive, spec, type_name
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.geometry import Turn
from coopqp.model.marker import Marker
from coopqp.model.profile import Profile
from coopqp.model.state import State
from coopqp.program import Primitive, evaluated, markers
from coopqp.signal import Instant, Signal

Mode = Literal["soft", "hard", "scaled"]
Level = tuple[int, int]
"""Sorts tasks: a law that supports modes and priorities lets those of a later level give way."""


def level_of(mode: Mode, priority: int) -> Level:
    """Hard tasks come first, then scaled ones, then soft ones by their priority."""
    rank = ("hard", "scaled", "soft").index(mode)
    return rank, priority if mode == "soft" else 0


@dataclass(frozen=True)
class TaskRows:
    """Where a task writes its rows."""

    e: Array  #: Error, shape (k,) [unit of the task].
    J: Array  #: Task Jacobian, shape (k, n) [unit per rad or m].
    rate: Array  #: J v that keeps the error constant, shape (k,) [unit/s].


Evaluate = Callable[[State, TaskRows], None]

Rows = TypeVar("Rows")


def evaluate_all(each: Sequence[tuple[Callable[[State, Rows], None], Rows]], state: State) -> None:
    """Let bound tasks or limits write their rows at a state, which they cannot write to."""
    state.lock()
    try:
        for evaluate, rows in each:
            evaluate(state, rows)
    finally:
        state.unlock()


#: Units of errors that are lengths, or speeds of such.
LENGTHS = ("m", "m/s")


@dataclass(frozen=True)
class Part:
    """Rows of a task with one unit; an error within the tolerance counts as reached at the end."""

    name: str
    rows: int
    unit: str
    tolerance: float


@dataclass(frozen=True)
class Impedance:
    """How rows yield to a wrench w on the object: mass e_ddot + damping e_dot + stiffness e = w."""

    axes: tuple[int, ...]  # components of w that the rows feel, at the object's origin, world axes
    stiffness: Array  # shape (k,) [N/m, N m/rad]
    # shape (k,) [N s/m, N m s/rad]; None where every mode has the damping_ratio
    damping: Array | None
    damping_ratio: float  # [-]
    mass: Array | None  # shape (k,) [kg, kg m2]; None where it is what object and arms have there


@spec
class Task(ABC):
    """A plug-in in ``tasks/``: what the object, or the joints, shall do."""

    unit: ClassVar[str] = "m"
    """Unit of the error."""
    joint_space: ClassVar[bool] = False
    """Whether J is the identity, zero in rows that ask nothing: it steers joints, no object."""
    all_joints: ClassVar[bool] = False
    """In joint space: whether every row asks something, so that nothing is left free."""
    asks_velocity: ClassVar[bool] = False
    """Whether e is zero and the task asks for a velocity alone; J v - rate counts as its error."""

    of_forces: ClassVar[bool] = False
    """Whether it asks for wrenches h of the hands, J h = rate with J of shape (k, 6 N), e unused:
    see :mod:`coopqp.closed_loop.hands`. Gain has no effect then."""

    name: Annotated[str, Field(validate_default=True)] = ""
    """Your name for it in tables and messages; its type's name if omitted."""
    gain: Positive = 5.0
    """How fast the error decays [1/s]; at most 1/dt."""
    weight: NonNegative = 1.0
    """Cost of a squared error in J v [s2/unit2]."""
    tolerance: Positive = 5e-4
    """Error at the end that still counts as reached [unit]."""
    mode: Mode = "soft"
    """soft: as well as it can; hard: exactly; scaled: in its direction, as fast as it can.
    Where the last two cannot hold they are met as nearly as limits and loops allow."""
    priority: Annotated[int, Field(ge=0, le=9)] = 0
    """Strict level of a soft task, 0 first, after hard and scaled ones; weights count within it."""

    @field_validator("name")
    @classmethod
    def _type_name_if_empty(cls, name: str) -> str:
        return name or type_name(cls)

    @field_validator("mode")
    @classmethod
    def _firm_has_weight(cls, mode: Mode, info: ValidationInfo) -> Mode:
        if mode != "soft" and info.data.get("weight") == 0.0:
            raise ValueError(f"found {mode} with weight 0, needs a weight above 0")
        return mode

    @abstractmethod
    def rows(self, chain: ClosedChain) -> tuple[str, ...]:
        """A name for each row, such as x, y, z; their number is the task's dimension."""

    def bind(self, start: State) -> Evaluate:
        """Fix the reference's start and return the function that fills the rows each tick.

        A task gives this, or its :meth:`geometry` or :meth:`program`.
        """
        program = self.program(start)
        if program is None:
            words = "needs a method bind, geometry or program"
            raise InvalidValueError(f"{type_name(type(self))}: {words}")
        fill = evaluated(program, start)

        def evaluate(state: State, rows: TaskRows) -> None:
            fill(state, rows.e, rows.J, rows.rate)

        return evaluate

    def geometry(self, at: Instant) -> tuple[Primitive, ...]:
        """The rows as primitives of the object, its references setting out at an instant."""
        return ()

    def program(self, start: State) -> tuple[Primitive, ...] | None:
        """The rows as primitives, which the kernel evaluates; None where they are none."""
        return self.geometry(start) or None

    def parts(self, chain: ClosedChain) -> tuple[Part, ...]:
        """The rows by unit, in their order; one part for most tasks."""
        return (Part("", len(self.rows(chain)), self.unit, self.tolerance),)

    def marks(self, at: Instant) -> tuple[Marker, ...]:
        """What pictures show of it: the goal at an instant, not the way there."""
        return markers(self.geometry(at), at)

    def at_goal(self) -> Task:
        """The same task with its reference (``profile``) at the goal at once."""
        moved: dict[str, Any] = {"profile": Profile(kind="step")}
        return replace(self, **moved) if self.way else self

    @property
    def way(self) -> Profile | None:
        """How the reference goes from its start to the goal; None where it is there at once."""
        profile = getattr(self, "profile", None)
        return profile if isinstance(profile, Profile) else None

    @property
    def level(self) -> Level:
        """Where it comes among all tasks."""
        return level_of(self.mode, self.priority)

    @property
    def end(self) -> float:
        """When the profiles, turns and signals in its fields have come to rest, if ever [s]."""
        return max(filter(math.isfinite, _ends(vars(self).values())), default=0.0)

    @property
    def impedance(self) -> Impedance | None:
        """How its rows yield to pushes, by torques alone; None where the error shall decay."""
        return None

    @property
    def curvature(self) -> float:
        """Of the surface from which a length is measured [1/m]; 0 where it is flat, or a point."""
        return 0.0


def _ends(values: Iterable[object]) -> Iterator[float]:
    """When each motion that a task follows comes to rest [s]."""
    for value in values:
        match value:
            case Turn():
                yield value.profile.end
            case Profile():
                yield value.end
            case Signal():
                yield value.rest
            case dict():
                yield from _ends(value.values())


def pose_parts(
    moves: int, turns: int, tolerance: float, tolerance_angle: float
) -> tuple[Part, ...]:
    """Rows of a position [m], then of an orientation [rad]; a part without rows is left out."""
    position = Part("position", moves, "m", tolerance)
    parts = position, Part("orientation", turns, "rad", tolerance_angle)
    return tuple(part for part in parts if part.rows)


class TaskStack:
    """The rows of several tasks in one block, shapes (k,) and (k, n) with k = all rows.

    J has n ``columns``, one a joint unless said otherwise.

    Attributes:
        slices: of each task's rows. sizes: their numbers.
        e, J, rate: as in :class:`TaskRows`.
        wanted: J v that makes the errors decay, rate - gain e.
        weights, gains, hard, priorities: of the rows.
        bound: the function of each task, and where it writes.
    """

    def __init__(self, tasks: Sequence[Task], start: State, columns: int | None = None) -> None:
        self._chain, n = start.chain, start.chain.n if columns is None else columns
        sizes = [len(task.rows(start.chain)) for task in tasks]
        ends = list(itertools.accumulate(sizes, initial=0))
        k = ends[-1]
        self.tasks = tuple(tasks)
        self.slices = tuple(slice(a, b) for a, b in itertools.pairwise(ends))
        self.e, self.rate, self.wanted = np.zeros(k), np.zeros(k), np.zeros(k)
        self.J = np.zeros((k, n))
        self.sizes = tuple(sizes)
        self.weights = np.repeat([float(task.weight) for task in tasks], sizes)
        #: Of the tasks in joint space that ask something of every joint.
        self.joint_weight = sum(float(t.weight) for t in tasks if t.joint_space and t.all_joints)
        self.gains = np.repeat([float(task.gain) for task in tasks], sizes)
        self.hard = np.repeat([task.mode == "hard" for task in tasks], sizes).astype(bool)
        self.priorities = np.repeat([task.priority for task in tasks], sizes).astype(int)
        #: Largest second derivative of each row's error [unit/rad2].
        bounds = (curvature_bounds_of(task, start.chain) for task in tasks)
        self.curvature_bounds = np.array([*itertools.chain(*bounds)], float).reshape(k)
        parts = list(zip(tasks, self.slices, strict=True))
        self._velocities = [part for task, part in parts if task.asks_velocity]
        self.bound: list[tuple[Evaluate, TaskRows]] = []
        for task, part in parts:
            if task.joint_space:
                self.J[part] = np.eye(n)
            block = TaskRows(self.e[part], self.J[part], self.rate[part])
            self.bound.append((task.bind(start), block))

    @cached_property
    def rows(self) -> tuple[Row, ...]:
        """What each row is, such as "task[reach].z"."""
        return tuple(row for task in self.tasks for row in rows_of(task, self._chain))

    def update(self, state: State) -> None:
        evaluate_all(self.bound, state)
        self.wanted[:] = self.rate - self.gains * self.e

    def curvatures(self, v: Array) -> Array:
        """Curvature that J leaves out of each row's cost, times 1 s, at the last v, shape (k,).

        The cost 1/2 sum w g e^2 has the curvature J' W G J, known to a tick, and sum w g e e'',
        which is not; |e''| is at most the reach of the arms for metres, and 1 for radians.

            g_i |e_i| L_i

        For a task that asks for a velocity alone |J v - rate| stands for g |e|.
        """
        sizes = self.gains * np.abs(self.e)
        for part in self._velocities:
            sizes[part] = np.abs(self.J[part].dot(v) - self.rate[part])
        sizes *= self.curvature_bounds
        return sizes

    def curvature(self, v: Array) -> float:
        """All of it in the cost, sum_i w_i g_i |e_i| L_i."""
        return float(self.weights.dot(self.curvatures(v)))


class Programs:
    """The programs of tasks that set out from one unchanging state, each made when first needed."""

    def __init__(self, start: State) -> None:
        self.start = start
        self._made: dict[int, tuple[Task, tuple[Primitive, ...] | None]] = {}

    def of(self, task: Task) -> tuple[Primitive, ...] | None:
        if id(task) not in self._made:
            self._made[id(task)] = task, task.program(self.start)  # its id is taken as long
        return self._made[id(task)][1]


def rows_of(task: Task, chain: ClosedChain) -> tuple[Row, ...]:
    """What each row of a task asks for: a force, or a velocity in the unit of its part."""
    per = "" if task.of_forces else "/s"
    units = [part.unit for part in task.parts(chain) for _ in range(part.rows)]
    return tuple(
        Row(name=f"task[{task.name}].{name}", kind="task", owner=task.name, unit=f"{unit}{per}")
        for name, unit in zip(task.rows(chain), units, strict=True)
    )


def curvature_bounds_of(task: Task, chain: ClosedChain) -> list[float]:
    """L of each row: for metres the reach, more for round surfaces; 1 for angles, 0 for joints."""
    if task.joint_space:
        return [0.0] * len(task.rows(chain))
    length = chain.reach * (1.0 + chain.reach * task.curvature)
    return [
        length if part.unit in LENGTHS else 1.0
        for part in task.parts(chain)
        for _ in range(part.rows)
    ]
