"""What happened in a run, tick by tick, in arrays.

Letters: T ticks, n joints, L loops, K tasks. Row k is the instant before tick k; row T is the end,
so positions have T + 1 rows and commands T.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class TaskInfo:
    """A task, or a part of it with a unit of its own, as the trace needs it."""

    name: str
    unit: str
    tolerance: float
    end: float


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
        joints: names, shape (n,).
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
        signals: what the plant told after each tick, by name, shape (T, .): see the plant.
    """

    controller: str
    solver: str | None
    dt: float
    kappa: float
    joints: tuple[str, ...]
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

    @property
    def ticks(self) -> int:
        """T."""
        return len(self.v)
