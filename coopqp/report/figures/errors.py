"""How far each task is from its goal, and from its reference on the way there; open loops."""

from __future__ import annotations

import numpy as np

from coopqp.checked import Array
from coopqp.hold import CLOSED_ORIENTATION, CLOSED_POSITION
from coopqp.report import curves
from coopqp.report.cells import length
from coopqp.report.curves import Figure
from coopqp.report.figures.chart import Chart

FLOOR = 1e-12  # smallest value on log scales [m, rad]; less is drawn here


def task_errors(chart: Chart) -> list[Figure]:
    """Of each task to its goal, and beside it to its reference where that is on its way."""
    figures = []
    for i in range(len(chart.any.tasks)):
        name = chart.any.tasks[i].name
        same = all(
            np.array_equal(trace.goal_error[:, i], trace.task_error[:, i], equal_nan=True)
            for trace in chart.traces.values()
        )
        figures.append(_error(chart, i, f"'{name}': error to the goal", "goal_error"))
        if not same:
            title = f"'{name}': error to the moving reference"
            figures.append(_error(chart, i, title, "task_error"))
    return figures


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
            good=(1e3 * CLOSED_POSITION, "counts as closed"),
        ),
        chart.log(
            f"Loop error, orientation, {kappa}",
            "mrad",
            chart.lines(lambda trace: 1e3 * trace.loop_orientation),
            1e3 * FLOOR,
            good=(1e3 * CLOSED_ORIENTATION, "counts as closed"),
        ),
    ]
