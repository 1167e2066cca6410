"""What happened in a run, tick by tick, in arrays.

Letters: T ticks, n joints, L loops, K tasks. Row k is the instant before tick k; row T is the end,
so positions have T + 1 rows and commands T.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Annotated, Any, TypeVar, get_type_hints

import numpy as np
from numpy.typing import NDArray

from coopqp.base.qp import Row
from coopqp.base.spec import Array
from coopqp.signal import InputValues, Kind, Moment, Trajectory
from coopqp.solver import Status
from coopqp.task import Mode


@dataclass(frozen=True)
class TickBatch:
    """Many ticks at once, T of them; each field has a row a tick, q [rad, m] one more for the end.

    ``memory`` is the law's before the tick; ``notes`` are remarks on ticks that stood still.
    """

    q: Array
    v: Array
    causes: list[tuple[Status, ...]]
    compiled: NDArray[np.bool_]
    scale: Array
    memory: Array
    notes: dict[int, str] = field(default_factory=dict)

    @staticmethod
    def empty(ticks: int, n: int, remembered: int) -> TickBatch:
        """Arrays for so many ticks, every one optimal."""
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
    """A task, or a part of it with a unit of its own, as the trace needs it."""

    name: str
    unit: str
    tolerance: float
    end: float  # when its reference arrives [s]
    # of the trace, during which it counts; its error is NaN in the others
    rows: slice = field(default_factory=lambda: slice(None))
    # of an impedance: which of the task's rows, its axis of the push, its stiffness [N/m, N m/rad]
    springs: tuple[tuple[int, int, float], ...] = ()
    mode: Mode = "soft"  # mode, priority: as the task says
    priority: int = 0


@dataclass(frozen=True)
class PhaseInfo:
    """A phase as the trace needs it: its first tick, and the arms that do not hold the object."""

    name: str
    first: int
    released: tuple[str, ...]


@dataclass(frozen=True)
class InputTrace:
    """What arrived at an input for each tick, and how it was followed; NaN where nothing did."""

    kind: Kind
    arrived: Array  # shape (T, values)
    sent: Array  # when, shape (T,) [s]
    value: Array  # shape (T, values)
    rate: Array  # shape (T, rates)


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
    """A tick whose answer could not be used: its status, and such as what a task raised."""

    tick: int
    cause: str
    note: str = ""


Phases = Sequence[tuple[PhaseInfo, "Trace"]]


def _same(parts: list[Any], phases: Phases) -> Any:
    return parts[0]


def _ticks(parts: list[Array], phases: Phases) -> Array:
    return np.concatenate(parts)


def _instants(parts: list[Array], phases: Phases) -> Array:
    """A row an instant; the last of one phase and the first of the next are one instant."""
    return np.concatenate([parts[0], *(rows[1:] for rows in parts[1:])])


def _times(parts: list[Array], phases: Phases) -> Array:
    """Time goes on, although it begins anew in each phase."""
    begins = (part.dt * info.first for info, part in phases)
    return _instants([t + begin for t, begin in zip(parts, begins, strict=True)], phases)


def _padded(parts: list[Array], phases: Phases) -> Array:
    """A row a tick; the laws of some phases remember less, and others have a loop less."""
    width = max(rows.shape[1] for rows in parts)
    return np.concatenate([np.pad(rows, ((0, 0), (0, width - rows.shape[1]))) for rows in parts])


def _chained(parts: list[tuple[str, ...]], phases: Phases) -> tuple[str, ...]:
    return tuple(itertools.chain.from_iterable(parts))


def _once(parts: list[tuple[str, ...]], phases: Phases) -> tuple[str, ...]:
    return tuple(dict.fromkeys(_chained(parts, phases)))


def _tasks(parts: list[tuple[TaskInfo, ...]], phases: Phases) -> tuple[TaskInfo, ...]:
    t = _times([part.t for _, part in phases], phases)
    return tuple(
        replace(
            task,
            name=f"{info.name}.{task.name}",
            end=float(t[info.first]) + task.end,
            rows=slice(info.first, info.first + part.ticks + 1),
        )
        for tasks, (info, part) in zip(parts, phases, strict=True)
        for task in tasks
    )


def _rows_of_tasks(parts: list[tuple[str, ...]], phases: Phases) -> tuple[str, ...]:
    named = zip(parts, phases, strict=True)
    return tuple(f"{info.name}.{row}" for rows, (info, _) in named for row in rows)


def _task_errors(parts: list[Array], phases: Phases) -> Array:
    """A column for each phase's tasks, NaN in the other phases."""
    instants, columns = 1 + sum(part.ticks for _, part in phases), []
    for errors, (info, part) in zip(parts, phases, strict=True):
        for error in errors.T:
            columns.append(np.full(instants, np.nan))
            columns[-1][info.first : info.first + part.ticks + 1] = error
    return np.reshape(columns, (len(columns), instants)).T


def _margins(parts: list[dict[Row, Array]], phases: Phases) -> dict[Row, Array]:
    """By limit; one that a phase does not have is infinite there."""
    rests = [np.full(part.ticks, np.inf) for _, part in phases]
    return {
        row: np.concatenate([of.get(row, rest) for of, rest in zip(parts, rests, strict=True)])
        for row in dict.fromkeys(itertools.chain.from_iterable(parts))
    }


def _starts(parts: list[dict[Row, float]], phases: Phases) -> dict[Row, float]:
    """By limit, from the first phase that has it."""
    return {row: left for of in reversed(parts) for row, left in of.items()}


def _points(parts: list[dict[str, Array]], phases: Phases) -> dict[str, Array]:
    return {arm: _instants([of[arm] for of in parts], phases) for arm in parts[0]}


def _signals(parts: list[dict[str, Array]], phases: Phases) -> dict[str, Array]:
    return {name: _ticks([of[name] for of in parts], phases) for name in parts[0]}


def _failures(parts: list[tuple[Failure, ...]], phases: Phases) -> tuple[Failure, ...]:
    return tuple(
        replace(failure, tick=info.first + failure.tick)
        for failures, (info, _) in zip(parts, phases, strict=True)
        for failure in failures
    )


def _inputs(parts: list[dict[str, InputTrace]], phases: Phases) -> dict[str, InputTrace]:
    """By input; NaN in the phases in which nothing follows it."""
    found = {}
    for name in dict.fromkeys(itertools.chain.from_iterable(parts)):
        kind = next(of[name].kind for of in parts if name in of)
        traces = [
            of.get(name) or no_input(kind, part.ticks)
            for of, (_, part) in zip(parts, phases, strict=True)
        ]
        columns = zip(
            *((one.arrived, one.sent, one.value, one.rate) for one in traces), strict=True
        )
        found[name] = InputTrace(kind, *map(np.concatenate, columns))
    return found


def no_input(kind: Kind, ticks: int) -> InputTrace:
    """An input that nothing follows, for ticks of which each is NaN."""
    shapes = ((ticks, kind.values), (ticks,), (ticks, kind.values), (ticks, kind.rates))
    return InputTrace(kind, *(np.full(shape, np.nan) for shape in shapes))


def _phases(parts: list[Any], phases: Phases) -> tuple[PhaseInfo, ...]:
    return tuple(info for info, _ in phases)


@dataclass(frozen=True, kw_only=True)
class Trace:
    """One controller's run; with each field stands how those of several phases are joined."""

    controller: Annotated[str, _same]
    solver: Annotated[str | None, _same]  #: Name of its QP solver; None for laws without one.
    #: "kernel" or "python", whichever is asked first; None for laws without a QP.
    engine: Annotated[str | None, _same]
    dt: Annotated[float, _same]  #: Control period [s].
    kappa: Annotated[float, _same]  #: Gain of the Baumgarte stabilisation [1/s].
    joints: Annotated[tuple[str, ...], _same]  #: Names, shape (n,).
    units: Annotated[tuple[str, ...], _same]  #: Of their coordinates, "rad" or "m".
    lower: Annotated[Array, _same]  #: Position limits, shape (n,) [rad or m].
    upper: Annotated[Array, _same]  #: The same.
    velocity: Annotated[Array, _same]  #: Velocity limits, shape (n,) [rad/s or m/s].
    effort: Annotated[Array, _same]  #: Of motors, 0 for passive joints, shape (n,) [N m or N].
    tasks: Annotated[tuple[TaskInfo, ...], _tasks]  #: In the order of task_error.
    #: Directional: how much of what is missed of each task in the end joints with closed loops can
    #: still bring about, over the start's, shape (K,); 0 where singular, 1 if none is missed.
    manipulability: Annotated[Array, _ticks]
    t: Annotated[Array, _times]  #: Shape (T + 1,) [s].
    #: Positions of the plant's joints, before noise, shape (T + 1, n) [rad or m].
    q: Annotated[Array, _instants]
    #: Commanded velocity, or the plant's after the tick when torques were commanded, shape (T, n)
    #: [rad/s or m/s].
    v: Annotated[Array, _ticks]
    #: The configuration from which each tick decided: the integral of the commands, or what was
    #: measured when torques were commanded, shape (T, n).
    commanded: Annotated[Array, _ticks]
    #: Measured joint positions when each tick decided, shape (T, n); NaN where there are none, as
    #: where joints follow their commands exactly.
    measured: Annotated[Array, _ticks]
    #: The part of the loop error that each tick took for the model's own, loop by loop in the order
    #: of the phase's arms, zero for open ones, shape (T, 6 L) [m, rad].
    loop_offset: Annotated[Array, _padded]
    #: What the law remembered when each tick began, zero beyond what it remembers, shape (T, .);
    #: with t, commanded, loop_offset and the v before it repeats the tick.
    memory: Annotated[Array, _padded]
    position: Annotated[Array, _instants]  #: Of the object, shape (T + 1, 3) [m].
    rotation: Annotated[Array, _instants]  #: Of the object, shape (T + 1, 3, 3).
    loop_position: Annotated[Array, _instants]  #: Largest loop error, shape (T + 1,) [m].
    loop_orientation: Annotated[Array, _instants]  #: The same [rad].
    #: Euclidean norm of each task's error, to its reference, which may be on its way to the goal,
    #: shape (T + 1, K) [the task's unit].
    task_error: Annotated[Array, _task_errors]
    #: The same to the goal, as if the reference were there from the start.
    goal_error: Annotated[Array, _task_errors]
    #: The rows of all tasks, such as "reach.z", R of them.
    task_rows: Annotated[tuple[str, ...], _rows_of_tasks]
    #: Each row's error, value minus reference, shape (T + 1, R) [the task's unit]; 0 for tasks that
    #: ask for a velocity alone.
    e: Annotated[Array, _task_errors]
    #: How fast each row's reference moves, shape (T + 1, R) [unit/s].
    rate: Annotated[Array, _task_errors]
    #: Of each tick, as :func:`coopqp.solver.written` writes it, shape (T,).
    status: Annotated[tuple[str, ...], _chained]
    #: Least share of its rate at which a hard or scaled task ran, else 1, shape (T,).
    scale: Annotated[Array, _ticks]
    #: Of every limit after each tick, by row, shape (T,); negative when violated.
    margins: Annotated[dict[Row, Array], _margins]
    starts: Annotated[dict[Row, float], _starts]  #: The same before the first tick, at rest.
    #: Whether the kernel decided the tick; the plain law decides the others, shape (T,).
    compiled: Annotated[NDArray[np.bool_], _ticks]
    #: Time of each tick, shape (T,) [us]; NaN where many were done at once.
    tick_us: Annotated[Array, _ticks]
    #: Joint origins and hand of each arm for drawing, by arm, shape (T + 1, p, 3) [m].
    points: Annotated[dict[str, Array], _points]
    #: What of the problem the law reads, :attr:`coopqp.controller.Controller.supports`.
    supports: Annotated[frozenset[str], _same]
    failures: Annotated[tuple[Failure, ...], _failures]  #: Ticks that held still, and why.
    #: Names of limits that do not say how far a run stayed away from them.
    unaudited: Annotated[tuple[str, ...], _once] = ()
    #: Names of tasks and limits of which Python filled rows for the kernel.
    rows_in_python: Annotated[tuple[str, ...], _once] = ()
    #: What that took of each tick, shape (T,) [us].
    rows_us: Annotated[Array, _ticks] = field(default_factory=lambda: np.zeros(0))
    #: The plant's signals after each tick, by name, shape (T, .): see the plant.
    signals: Annotated[dict[str, Array], _signals] = field(default_factory=dict)
    #: What arrived from outside, by name.
    inputs: Annotated[dict[str, InputTrace], _inputs] = field(default_factory=dict)
    #: One after the other; none where arms neither let go nor take hold.
    phases: Annotated[tuple[PhaseInfo, ...], _phases] = ()

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
        return len(self.v)

    def moment(self, k: int, t: float) -> Moment:
        """The instant of row k as references see it, t [s] after they set out."""
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


def join(phases: Phases) -> Trace:
    """One trace of a controller's phases, in their order; the time of each begins at zero.

    Every field says how it is joined. The instant between two phases belongs to the first of them:
    a loop is as open as it was before a hand took hold anew.
    """
    joined = {
        name: hint.__metadata__[0]([getattr(part, name) for _, part in phases], phases)
        for name, hint in get_type_hints(Trace, include_extras=True).items()
    }
    return Trace(**joined)
