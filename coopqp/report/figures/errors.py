"""How far each task is from its goal, and from its reference on the way there; open loops."""

from __future__ import annotations

import numpy as np

from coopqp.assessment.thresholds import LOOP_CLOSED, LOOP_CLOSED_ANGLE
from coopqp.checked import Array
from coopqp.report import curves
from coopqp.report.cells import length
from coopqp.report.curves import Figure
from coopqp.report.figures.chart import Chart

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
    same = all(
        np.array_equal(trace.goal_error[:, i], trace.task_error[:, i], equal_nan=True)
        for trace in traces
    )
    goal = _error(chart, i, f"'{name}': error to the goal", "goal_error")
    reference = f"'{name}': error to the moving reference"
    return [goal] if same else [goal, _error(chart, i, reference, "task_error")]


def _error(chart: Chart, i: int, title: str, field: str) -> Figure:
    task = chart.any.tasks[i]
    scale, unit = length(1.0, task.unit)

    def error(name: str) -> Array:
        values: Array = getattr(chart.traces[name], field)[task.rows, i]
        return scale * values

    arrives = 0 < task.end < chart.end
    return chart.log(
        title,
        unit,
        {name: error(name) for name in chart.names},
        scale * FLOOR,
        *([curves.upright(task.end, "reference arrives")] if arrives else []),
        good=(scale * task.tolerance, "counts as reached"),
        rows=task.rows,
    )


def loop_errors(chart: Chart) -> list[Figure]:
    """How far apart the arms carry the object."""
    kappa = f"κ = {chart.any.kappa:g} 1/s"
    return [
        chart.log(
            f"Loop error, position, {kappa}",
            "mm",
            chart.lines(lambda trace: 1e3 * trace.loop_position),
            1e3 * FLOOR,
            good=(1e3 * LOOP_CLOSED, "counts as closed"),
        ),
        chart.log(
            f"Loop error, orientation, {kappa}",
            "mrad",
            chart.lines(lambda trace: 1e3 * trace.loop_orientation),
            1e3 * FLOOR,
            good=(1e3 * LOOP_CLOSED_ANGLE, "counts as closed"),
        ),
    ]
