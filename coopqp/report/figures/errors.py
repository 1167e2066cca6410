"""How far each task is from its goal, and from its reference on the way there; open loops."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from coopqp.assessment.thresholds import LOOP_CLOSED, LOOP_CLOSED_ANGLE
from coopqp.base.spec import Array
from coopqp.report import curves
from coopqp.report.cells import length
from coopqp.report.curves import Figure, Json
from coopqp.report.figures.chart import ALWAYS, Chart
from coopqp.trace import Trace

FLOOR = 1e-12  # smallest value on log scales [m, rad]; less is drawn here
MOST_FIRST = 3  # tasks that are shown first


def task_errors(chart: Chart) -> tuple[list[Figure], list[Figure]]:
    """Of the tasks that miss their goal most, then of the others in their order; and of the rest.

    Each to its goal, and beside it to its reference where that is on its way.
    """
    count = len(chart.any.tasks)
    order = sorted(range(count), key=lambda i: -max(1.0, _missed(chart, i)))
    first = sorted(order[:MOST_FIRST])
    parts = [(i in first, _of_task(chart, i)) for i in range(count)]
    shown, rest = (
        [f for is_first, of in parts if is_first is kind for f in of] for kind in (True, False)
    )
    return shown, rest


def _missed(chart: Chart, i: int) -> float:
    """What is left of a task's error at the end, at worst, in its tolerance; NaN is the worst."""
    task = chart.any.tasks[i]
    ends = [trace.goal_error[task.rows, i][-1] for trace in chart.traces.values()]
    return float(np.nan_to_num(np.max(ends), nan=np.inf)) / task.tolerance


def _of_task(chart: Chart, i: int) -> list[Figure]:
    name, traces = chart.any.tasks[i].name, chart.traces.values()
    goal = _error(chart, i, f"'{name}': error to the goal", lambda trace: trace.goal_error)
    if all(np.array_equal(t.goal_error[:, i], t.task_error[:, i], equal_nan=True) for t in traces):
        return [goal]
    reference = f"'{name}': error to the moving reference"
    return [goal, _error(chart, i, reference, lambda trace: trace.task_error)]


def _error(chart: Chart, i: int, title: str, of: Callable[[Trace], Array]) -> Figure:
    task = chart.any.tasks[i]
    scale, unit = length(1.0, task.unit)
    lines = chart.lines(lambda trace: scale * of(trace)[task.rows, i])
    arrives = [curves.upright(task.end, "reference arrives")] if 0 < task.end < chart.end else []
    good = scale * task.tolerance
    return _log(chart, title, unit, lines, scale, good, "reached", *arrives, rows=task.rows)


def loop_errors(chart: Chart) -> list[Figure]:
    """How far apart the arms carry the object."""
    kappa = f"κ = {chart.any.kappa:g} 1/s"
    position = chart.lines(lambda trace: 1e3 * trace.loop_position)
    turn = chart.lines(lambda trace: 1e3 * trace.loop_orientation)
    parts = (
        ("position", "mm", position, 1e3 * LOOP_CLOSED),
        ("orientation", "mrad", turn, 1e3 * LOOP_CLOSED_ANGLE),
    )
    return [
        _log(chart, f"Loop error, {what}, {kappa}", unit, lines, 1e3, good, "closed")
        for what, unit, lines, good in parts
    ]


def _log(
    chart: Chart,
    title: str,
    unit: str,
    lines: dict[str, Array],
    scale: float,
    good: float,
    word: str,
    *levels: Json,
    rows: slice = ALWAYS,
) -> Figure:
    """On a log scale, with the bound below which errors are good."""
    floor = scale * FLOOR
    lines = {name: np.maximum(y, floor) for name, y in lines.items()}
    shown = curves.log_window(list(lines.values()), floor, good)
    bound = curves.level(good, f"counts as {word}: {good:.3g}", log=True)
    return chart.figure(title, unit, lines, shown, bound, *levels, log=True, rows=rows)
