"""What happened in a run, tick by tick, in arrays.

Letters: T ticks, n joints, L loops, K tasks. Row k is the instant before tick k; row T is the end,
so positions have T + 1 rows and commands T.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from coopqp.base.qp import Row
from coopqp.base.spec import Array
from coopqp.signal import InputValues, Kind, Moment, Trajectory
from coopqp.solver import Status
from coopqp.task import Mode


@dataclass(frozen=True)
class TickBatch:
    """Many ticks at once, T of them.

    Attributes:
        q: before each and at the end, shape (T + 1, n) [rad, m].
        v: of each command, shape (T, n) [rad/s, m/s].
        causes: what became of each.
        compiled: whether the kernel decided it, shape (T,).
        scale: least share of its rate at which a hard or scaled task ran, else 1, shape (T,).
        memory: what the law remembered when each began, shape (T, .).
        notes: what else is to be said of a tick that stood still, by tick.
    """

    q: Array
    v: Array
    causes: list[tuple[Status, ...]]
    compiled: NDArray[np.bool_]
    scale: Array
    memory: Array
    notes: dict[int, str] = field(default_factory=dict)

    @staticmethod
    def room(ticks: int, n: int, remembered: int) -> TickBatch:
        """Arrays for so many ticks, every one optimal.

        Args:
            ticks: T.
            n: joints.
            remembered: how many numbers the law remembers.
        """
        return TickBatch(
            np.zeros((ticks + 1, n)),
            np.zeros((ticks, n)),
            [(Status.OPTIMAL,)] * ticks,
            np.zeros(ticks, bool),
            np.ones(ticks),
            np.zeros((ticks, remembered)),
        )


@dataclass(frozen=True)
class TaskInfo:
    """A task, or a part of it with a unit of its own, as the trace needs it.

    Attributes:
        name, unit, tolerance: as the task says.
        end: when its reference arrives [s].
        rows: of the trace, during which it counts; its error is NaN in the others.
        springs: of an impedance, which of the task's rows each is, its axis of the push, and its
            stiffness [N/m, N m/rad].
        mode, priority: as the task says.
    """

    name: str
    unit: str
    tolerance: float
    end: float
    rows: slice = field(default_factory=lambda: slice(None))
    springs: tuple[tuple[int, int, float], ...] = ()
    mode: Mode = "soft"
    priority: int = 0


@dataclass(frozen=True)
class PhaseInfo:
    """A phase as the trace needs it.

    Attributes:
        name: of the phase.
        first: its first tick.
        released: the arms that do not hold the object.
    """

    name: str
    first: int
    released: tuple[str, ...]


@dataclass(frozen=True)
class InputTrace:
    """What arrived at an input, and what was made of it.

    Attributes:
        kind: of its values.
        arrived: what arrived for each tick, NaN where nothing did, shape (T, values).
        sent: when that was sent, NaN where nothing was, shape (T,) [s].
        value: what was followed in each tick, shape (T, values).
        rate: how that moved, shape (T, rates).
    """

    kind: Kind
    arrived: Array
    sent: Array
    value: Array
    rate: Array


def followed(inputs: Mapping[str, InputTrace], k: int) -> InputValues:
    """What was made of the inputs in a tick; after the last as in it."""
    found = InputValues()
    for name, kept in inputs.items():
        row = min(k, len(kept.value) - 1)
        if row >= 0 and np.isfinite(kept.value[row]).all():
            found[name] = Trajectory(kept.kind, kept.value[row])
            found[name].rate[:] = kept.rate[row]
    return found


@dataclass(frozen=True)
class Failure:
    """A tick whose answer could not be used.

    Attributes:
        tick: which.
        cause: what its status says.
        note: what else is to be said, such as what a task raised.
    """

    tick: int
    cause: str
    note: str = ""


Legs = Sequence[tuple["PhaseInfo", "Trace"]]


def _same(legs: Legs, name: str) -> Any:
    """What all phases have in common."""
    return getattr(legs[0][1], name)


def _instants(legs: Legs, name: str) -> Any:
    """A row an instant; the last of one phase and the first of the next are one instant."""
    return _chained([getattr(leg, name) for _, leg in legs])


def _ticks(legs: Legs, name: str) -> Any:
    """A row a tick."""
    return np.concatenate([getattr(leg, name) for _, leg in legs])


def _memories(legs: Legs, name: str) -> Array:
    """A row a tick; the laws of some phases remember less."""
    rows = [getattr(leg, name) for _, leg in legs]
    most = max(row.shape[1] for row in rows)
    return np.concatenate([np.pad(row, ((0, 0), (0, most - row.shape[1]))) for row in rows])


def _statuses(legs: Legs, name: str) -> tuple[str, ...]:
    return tuple(status for _, leg in legs for status in getattr(leg, name))


def _times(legs: Legs, name: str) -> Array:
    """Time goes on, although it begins anew in each phase."""
    return _chained([getattr(leg, name) + leg.dt * info.first for info, leg in legs])


def _tasks(legs: Legs, name: str) -> tuple[TaskInfo, ...]:
    """Every phase's tasks."""
    t = _times(legs, "t")
    return tuple(
        replace(
            task,
            name=f"{info.name}.{task.name}",
            end=float(t[info.first]) + task.end,
            rows=slice(info.first, info.first + leg.ticks + 1),
        )
        for info, leg in legs
        for task in getattr(leg, name)
    )


def _rows_of_tasks(legs: Legs, name: str) -> tuple[str, ...]:
    """Every phase's rows of tasks."""
    return tuple(f"{info.name}.{row}" for info, leg in legs for row in getattr(leg, name))


def _task_errors(legs: Legs, name: str) -> Array:
    """A column for each phase's tasks, NaN in the other phases."""
    instants, columns = len(_times(legs, "t")), []
    for info, leg in legs:
        rows = slice(info.first, info.first + leg.ticks + 1)
        for error in getattr(leg, name).T:
            columns.append(np.full(instants, np.nan))
            columns[-1][rows] = error
    return np.reshape(columns, (len(columns), instants)).T


def _margins(legs: Legs, name: str) -> dict[Row, Array]:
    """By limit; one that a phase does not have is infinite there."""
    margins = [getattr(leg, name) for _, leg in legs]
    rows = dict.fromkeys(row for of in margins for row in of)
    nothing = [np.full(leg.ticks, np.inf) for _, leg in legs]
    return {
        row: np.concatenate(
            [
                getattr(leg, name).get(row, rest)
                for (_, leg), rest in zip(legs, nothing, strict=True)
            ]
        )
        for row in rows
    }


def _names(legs: Legs, name: str) -> tuple[str, ...]:
    """Of any phase."""
    return tuple(dict.fromkeys(found for _, leg in legs for found in getattr(leg, name)))


def _starts(legs: Legs, name: str) -> dict[Row, float]:
    """By limit, from the first phase that has it."""
    return {row: left for _, leg in reversed(legs) for row, left in getattr(leg, name).items()}


def _points(legs: Legs, name: str) -> dict[str, Array]:
    return {
        arm: _chained([getattr(leg, name)[arm] for _, leg in legs])
        for arm in getattr(legs[0][1], name)
    }


def _failures(legs: Legs, name: str) -> tuple[Failure, ...]:
    return tuple(
        replace(failure, tick=info.first + failure.tick)
        for info, leg in legs
        for failure in getattr(leg, name)
    )


def _signals(legs: Legs, name: str) -> dict[str, Array]:
    return {
        signal: np.concatenate([getattr(leg, name)[signal] for _, leg in legs])
        for signal in getattr(legs[0][1], name)
    }


def _inputs(legs: Legs, name: str) -> dict[str, InputTrace]:
    """By input; NaN in the phases in which nothing follows it."""
    found = {}
    for key in dict.fromkeys(key for _, leg in legs for key in getattr(leg, name)):
        given = [getattr(leg, name).get(key) for _, leg in legs]
        kind = next(part.kind for part in given if part)
        parts = []
        for (_, leg), part in zip(legs, given, strict=True):
            parts.append(part or no_input(kind, leg.ticks))
        arrays = (
            np.concatenate([getattr(part, field) for part in parts])
            for field in ("arrived", "sent", "value", "rate")
        )
        found[key] = InputTrace(kind, *arrays)
    return found


def no_input(kind: Kind, ticks: int) -> InputTrace:
    """An input that nothing follows, for ticks of which each is NaN."""
    shapes = ((ticks, kind.values), (ticks,), (ticks, kind.values), (ticks, kind.rates))
    return InputTrace(kind, *(np.full(shape, np.nan) for shape in shapes))


def _phases(legs: Legs, name: str) -> tuple[PhaseInfo, ...]:
    return tuple(info for info, _ in legs)


def _chained(rows: Sequence[Array]) -> Array:
    return np.concatenate([rows[0], *(row[1:] for row in rows[1:])])


@dataclass(frozen=True, kw_only=True)
class Trace:
    """One controller's run.

    Attributes:
        controller: its name.
        solver: name of its QP solver; None for laws without one.
        engine: "kernel" or "python", whichever is asked first; None for laws without a QP.
        dt: control period [s]. kappa: gain of the drift correction [1/s].
        joints: names, shape (n,). units: of their coordinates, "rad" or "m".
        lower, upper, velocity, effort: the limits, shape (n,) [rad or m; rad/s or m/s; N m or N];
            no effort for passive joints.
        tasks: in the order of task_error.
        leverage: how much of what is missed of each task in the end joints with closed loops can
            still bring about, over the start's, shape (K,); 0 where singular, 1 if none is missed.
        t: shape (T + 1,) [s].
        q: what the plant's joints did, before noise, shape (T + 1, n) [rad or m].
        v: commanded velocity, or the plant's after the tick when torques were commanded, shape
            (T, n) [rad/s or m/s].
        commanded: the configuration from which each tick decided: the integral of the commands,
            or what was measured when torques were commanded, shape (T, n).
        measured: where the sensors said that the joints are when each tick decided, shape (T, n);
            NaN where they said nothing, as where joints do exactly as told.
        gap: the part of the loop error that each tick took for the model's own, loop by loop in
            the order of the phase's arms, zero for open ones, shape (T, 6 L) [m, rad].
        memory: what the law remembered when each tick began, zero beyond what it remembers, shape
            (T, .); with t, commanded, gap and the v before it repeats the tick.
        position: of the object, shape (T + 1, 3) [m].
        rotation: of the object, shape (T + 1, 3, 3).
        loop_position, loop_orientation: largest loop error, shape (T + 1,) [m], [rad].
        task_error: Euclidean norm of each task's error, to its reference, which may be on its way
            to the goal, shape (T + 1, K) [the task's unit].
        goal_error: the same to the goal, as if the reference were there from the start.
        task_rows: the rows of all tasks, such as "reach.z", R of them.
        e: each row's error to its reference, value minus reference, shape (T + 1, R) [the task's
            unit]; 0 for tasks that ask for a velocity alone.
        rate: how fast each row's reference moves, shape (T + 1, R) [unit/s].
        usable: whether the tick's answer was used, shape (T,).
        inaccurate: whether it was used although not optimal to the declared accuracy, shape (T,).
        status: what became of each tick, as :func:`coopqp.solver.written` writes it, shape (T,).
        scale: least share of its rate at which a hard or scaled task ran, else 1, shape (T,).
        margins: of every limit after each tick, by row, shape (T,); negative when violated.
        starts: the same before the first tick, at rest.
        unaudited: names of limits that do not say how far a run stayed away from them.
        compiled: whether the kernel decided the tick; the plain law decides the others, shape (T,).
        rows_in_python: names of tasks and limits of which Python filled rows for the kernel.
        tick_us: time of each tick, shape (T,) [us]; NaN where many were done at once.
        points: joint origins and hand of each arm for drawing, by arm, shape (T + 1, p, 3) [m].
        supports: what of the problem the law reads, :attr:`coopqp.controller.Controller.supports`.
        failures: ticks that held still, and why.
        phases: one after the other; none where arms neither let go nor take hold.
        signals: what the plant told after each tick, by name, shape (T, .): see the plant.
        inputs: what arrived from outside, by name.
    """

    controller: str = field(metadata={"join": _same})
    solver: str | None = field(metadata={"join": _same})
    engine: str | None = field(metadata={"join": _same})
    dt: float = field(metadata={"join": _same})
    kappa: float = field(metadata={"join": _same})
    joints: tuple[str, ...] = field(metadata={"join": _same})
    units: tuple[str, ...] = field(metadata={"join": _same})
    lower: Array = field(metadata={"join": _same})
    upper: Array = field(metadata={"join": _same})
    velocity: Array = field(metadata={"join": _same})
    effort: Array = field(metadata={"join": _same})
    tasks: tuple[TaskInfo, ...] = field(metadata={"join": _tasks})
    leverage: Array = field(metadata={"join": _ticks})
    t: Array = field(metadata={"join": _times})
    q: Array = field(metadata={"join": _instants})
    v: Array = field(metadata={"join": _ticks})
    commanded: Array = field(metadata={"join": _ticks})
    measured: Array = field(metadata={"join": _ticks})
    gap: Array = field(metadata={"join": _ticks})
    memory: Array = field(metadata={"join": _memories})
    position: Array = field(metadata={"join": _instants})
    rotation: Array = field(metadata={"join": _instants})
    loop_position: Array = field(metadata={"join": _instants})
    loop_orientation: Array = field(metadata={"join": _instants})
    task_error: Array = field(metadata={"join": _task_errors})
    goal_error: Array = field(metadata={"join": _task_errors})
    task_rows: tuple[str, ...] = field(metadata={"join": _rows_of_tasks})
    e: Array = field(metadata={"join": _task_errors})
    rate: Array = field(metadata={"join": _task_errors})
    usable: NDArray[np.bool_] = field(metadata={"join": _ticks})
    inaccurate: NDArray[np.bool_] = field(metadata={"join": _ticks})
    status: tuple[str, ...] = field(metadata={"join": _statuses})
    scale: Array = field(metadata={"join": _ticks})
    margins: dict[Row, Array] = field(metadata={"join": _margins})
    starts: dict[Row, float] = field(metadata={"join": _starts})
    compiled: NDArray[np.bool_] = field(metadata={"join": _ticks})
    tick_us: Array = field(metadata={"join": _ticks})
    points: dict[str, Array] = field(metadata={"join": _points})
    supports: frozenset[str] = field(metadata={"join": _same})
    failures: tuple[Failure, ...] = field(metadata={"join": _failures})
    unaudited: tuple[str, ...] = field(metadata={"join": _names}, default=())
    rows_in_python: tuple[str, ...] = field(metadata={"join": _names}, default=())
    signals: dict[str, Array] = field(metadata={"join": _signals}, default_factory=dict)
    inputs: dict[str, InputTrace] = field(metadata={"join": _inputs}, default_factory=dict)
    phases: tuple[PhaseInfo, ...] = field(metadata={"join": _phases}, default=())

    def __repr__(self) -> str:
        end = f"{self.t[-1]:g} s" if len(self.t) else "nothing"
        return f"Trace({self.controller}, {self.ticks} ticks, {end}, {len(self.joints)} joints)"

    @property
    def keeps_limits(self) -> bool:
        """Whether its controller promises to keep the scenario's limits."""
        return "limits" in self.supports

    @property
    def orders_tasks(self) -> bool:
        """Whether its controller lets tasks of later levels give way to those before."""
        return {"modes", "priorities"} <= self.supports

    @property
    def ticks(self) -> int:
        """T."""
        return len(self.v)

    def moment(self, k: int, t: float) -> Moment:
        """An instant as references see it.

        Args:
            k: row.
            t: since they set out [s].
        """
        return Moment(t, followed(self.inputs, k))

    @property
    def last_instants(self) -> tuple[int, ...]:
        """The last row for which each task counts."""
        return tuple(range(len(self.t))[task.rows][-1] for task in self.tasks)


Kept = TypeVar("Kept")


def read_only(kept: Kept) -> Kept:
    """The same, with views of its arrays that nobody can write to."""
    found: Any = kept
    if isinstance(kept, np.ndarray):
        found = kept.view()
        found.flags.writeable = False
    elif isinstance(kept, dict):
        found = {key: read_only(value) for key, value in kept.items()}
    elif isinstance(kept, Trace | InputTrace):
        found = replace(kept, **{of.name: read_only(getattr(kept, of.name)) for of in fields(kept)})
    return found  # type: ignore[no-any-return]


def join(phases: Legs) -> Trace:
    """One trace of a controller's phases.

    Every field says how it is joined; there is no default, so that none is forgotten. The instant
    between two phases belongs to the first of them: a loop is as open as it was before a hand took
    hold anew.

    Args:
        phases: in their order, each with its own trace, whose time begins at zero.
    """
    return Trace(**{part.name: part.metadata["join"](phases, part.name) for part in fields(Trace)})
