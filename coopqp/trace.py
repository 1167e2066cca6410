"""What happened in a run, tick by tick, in arrays.

Letters: T ticks, n joints, L loops, K tasks. Row k is the instant before tick k; row T is the end,
so positions have T + 1 rows and commands T.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coopqp.checked import Array


@dataclass(frozen=True)
class TaskInfo:
    """A task, or a part of it with a unit of its own, as the trace needs it.

    Attributes:
        name, unit, tolerance: as the task says.
        end: when its reference arrives [s].
        rows: of the trace, during which it counts; its error is NaN in the others.
    """

    name: str
    unit: str
    tolerance: float
    end: float
    rows: slice = field(default_factory=lambda: slice(None))


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
class Failure:
    """A tick whose answer could not be used."""

    tick: int
    cause: str


@dataclass(frozen=True, kw_only=True)
class Trace:
    """One controller's run.

    Attributes:
        controller: its name.
        solver: name of its QP solver; None for laws without one.
        dt: control period [s]. kappa: gain of the drift correction [1/s].
        joints: names, shape (n,). units: of their coordinates, "rad" or "m".
        lower, upper, velocity, effort: the limits, shape (n,) [rad or m; rad/s or m/s; N m or N];
            no effort for passive joints.
        tasks: in the order of task_error.
        t: shape (T + 1,) [s].
        q: shape (T + 1, n) [rad or m].
        v: commanded velocity, or the plant's after the tick when torques were commanded, shape
            (T, n) [rad/s or m/s].
        position: of the object, shape (T + 1, 3) [m].
        rotation: of the object, shape (T + 1, 3, 3).
        loop_position, loop_orientation: largest loop error, shape (T + 1,) [m], [rad].
        task_error: Euclidean norm of each task's error, shape (T + 1, K) [the task's unit].
        usable: whether the tick's answer was used, shape (T,).
        inaccurate: whether it was used although not optimal to the declared accuracy, shape (T,).
        status: what became of each tick, names of :class:`coopqp.solver.Status`, shape (T,).
        scale: least share of its speed at which a scaled task ran, shape (T,).
        margins: of every limit after each tick, by name, shape (T,); negative when violated.
        tick_us: time of a tick, kinematics to verified command, shape (T,) [us].
        points: joint origins and hand of each arm for drawing, by arm, shape (T + 1, p, 3) [m].
        failures: ticks that held still, and why.
        phases: one after the other; none where arms neither let go nor take hold.
        signals: what the plant told after each tick, by name, shape (T, .): see the plant.
    """

    controller: str
    solver: str | None
    dt: float
    kappa: float
    joints: tuple[str, ...]
    units: tuple[str, ...]
    lower: Array
    upper: Array
    velocity: Array
    effort: Array
    tasks: tuple[TaskInfo, ...]
    t: Array
    q: Array
    v: Array
    position: Array
    rotation: Array
    loop_position: Array
    loop_orientation: Array
    task_error: Array
    usable: NDArray[np.bool_]
    inaccurate: NDArray[np.bool_]
    status: tuple[str, ...]
    scale: Array
    margins: dict[str, Array]
    tick_us: Array
    points: dict[str, Array]
    failures: tuple[Failure, ...]
    signals: dict[str, Array] = field(default_factory=dict)
    phases: tuple[PhaseInfo, ...] = ()

    @property
    def ticks(self) -> int:
        """T."""
        return len(self.v)

    @property
    def final_error(self) -> Array:
        """Each task's error at the end of the time for which it counts, shape (K,)."""
        ends = [self.task_error[task.rows, k][-1] for k, task in enumerate(self.tasks)]
        return np.array(ends, float)


#: Arrays of a trace with a row for each instant, and with one for each tick.
AT_INSTANTS = ("q", "position", "rotation", "loop_position", "loop_orientation")
IN_TICKS = ("v", "usable", "inaccurate", "scale", "tick_us")


def join(phases: Sequence[tuple[PhaseInfo, Trace]]) -> Trace:
    """One trace of a controller's phases.

    The instant between two phases belongs to the first of them: a loop is as open as it was before
    a hand took hold anew.

    Args:
        phases: in their order, each with its own trace, whose time begins at zero.
    """
    infos, legs = [info for info, _ in phases], [leg for _, leg in phases]
    first, at = legs[0], [info.first for info in infos]
    t = _instants([leg.t + first.dt * k for leg, k in zip(legs, at, strict=True)])
    tasks, errors = _tasks_of(phases, t)
    values: dict[str, Any] = {
        name: _instants([getattr(leg, name) for leg in legs]) for name in AT_INSTANTS
    }
    for name in IN_TICKS:
        values[name] = np.concatenate([getattr(leg, name) for leg in legs])
    return replace(
        first,
        **values,
        t=t,
        tasks=tasks,
        task_error=errors,
        status=tuple(status for leg in legs for status in leg.status),
        margins=_margins(legs),
        points={arm: _instants([leg.points[arm] for leg in legs]) for arm in first.points},
        failures=tuple(
            replace(failure, tick=k + failure.tick)
            for leg, k in zip(legs, at, strict=True)
            for failure in leg.failures
        ),
        signals={
            name: np.concatenate([leg.signals[name] for leg in legs]) for name in first.signals
        },
        phases=tuple(infos),
    )


def _instants(rows: Sequence[Array]) -> Array:
    """Rows of all legs; the last of one and the first of the next are one instant."""
    return np.concatenate([rows[0], *(row[1:] for row in rows[1:])])


def _tasks_of(
    phases: Sequence[tuple[PhaseInfo, Trace]], t: Array
) -> tuple[tuple[TaskInfo, ...], Array]:
    """Every phase's tasks, and their errors, NaN in the other phases."""
    tasks, errors = [], []
    for info, leg in phases:
        rows = slice(info.first, info.first + leg.ticks + 1)
        for k, task in enumerate(leg.tasks):
            name, end = f"{info.name}.{task.name}", float(t[info.first]) + task.end
            tasks.append(replace(task, name=name, end=end, rows=rows))
            errors.append(np.full(len(t), np.nan))
            errors[-1][rows] = leg.task_error[:, k]
    return tuple(tasks), np.stack(errors, axis=1)


def _margins(legs: Sequence[Trace]) -> dict[str, Array]:
    """Margins by limit; one that a phase does not have is infinite there."""
    names = dict.fromkeys(name for leg in legs for name in leg.margins)
    nothing = [np.full(leg.ticks, np.inf) for leg in legs]
    return {
        name: np.concatenate(
            [leg.margins.get(name, rest) for leg, rest in zip(legs, nothing, strict=True)]
        )
        for name in names
    }
