"""Which of a task's errors count as its end.

Of a place the last sample. Of a force those of a last stretch, because one sample of a swing says
nothing. Of an impedance that is pushed to the end how far it is from F / K: it was asked to give
way by that.
"""

from __future__ import annotations

import numpy as np

from coopqp.assessment.thresholds import SETTLED
from coopqp.base.spec import Array
from coopqp.trace import TaskInfo, Trace

#: Units of what is asked of the hands' wrenches.
FORCES = ("N", "N m")


def settled(error: Array, unit: str, dt: float) -> Array:
    """The errors that count as the end: the last; of a force the last ``SETTLED`` seconds.

    And of that no more than the last fifth of its time.

    Args:
        error: at the instants for which the task counts.
        unit: of the error.
        dt: control period [s].
    """
    if unit not in FORCES:
        return error[-1:]
    ticks = min(round(SETTLED / dt), (len(error) - 1) // 5)
    return error[-max(ticks, 1) :]


def end_errors(trace: Trace, k: int) -> Array:
    """The errors of task k that count as its end [the task's unit]."""
    last, task = trace.last_instants[k], trace.tasks[k]
    if pushed(trace, k):
        rows = rows_of(trace, task)
        e = trace.e[last, [rows[row] for row, _, _ in task.springs]]
        push = trace.signals["push"][last - 1]
        asked = np.array([push[axis] / stiffness for _, axis, stiffness in task.springs])
        return np.array([np.linalg.norm(e - asked)])
    return settled(trace.task_error[task.rows.start : last + 1, k], task.unit, trace.dt)


def end_error(trace: Trace, k: int) -> float:
    """The largest of them; NaN where it is no number, as files have it."""
    worst = float(end_errors(trace, k).max())
    return worst if np.isfinite(worst) else np.nan


def pushed(trace: Trace, k: int) -> bool:
    """Whether task k is an impedance, and the plant pushes the object to its end."""
    last, push = trace.last_instants[k], trace.signals.get("push")
    return bool(trace.tasks[k].springs and push is not None and last and push[last - 1].any())


def oscillates(trace: Trace, k: int) -> bool:
    """Whether what task k asks for is only passed through, or passed about, at its end."""
    task, errors = trace.tasks[k], end_errors(trace, k)
    last = trace.last_instants[k] + 1
    own = [i for i, row in enumerate(trace.task_rows) if row.rpartition(".")[0] == task.name]
    e = trace.e[last - len(errors) : last, own]
    about = (e.min(axis=0) < -task.tolerance) & (e.max(axis=0) > task.tolerance)
    return bool(errors.min() <= task.tolerance or about.any())


def rows_of(trace: Trace, part: TaskInfo) -> list[int]:
    """Indices of the rows of an impedance's task, of which ``part`` is a part."""
    task = part.name.rpartition(".")[0]
    return [i for i, name in enumerate(trace.task_rows) if name.rpartition(".")[0] == task]
