"""Torque of each motor and the wrenches on the object, where the plant tells them."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from coopqp.report import curves
from coopqp.report.curves import Figure, Window
from coopqp.report.figures.chart import Chart
from coopqp.report.figures.joints import joint_order
from coopqp.trace import Trace


def torques(chart: Chart) -> list[Figure]:
    """One a motor, those of two equal arms side by side."""
    told = _told(chart)
    if not told:
        return []
    motors = [i for i in joint_order(chart.chain) if chart.any.effort[i] > 0.0]
    return [_torque(chart, i, told) for i in motors]


def forces(chart: Chart) -> list[Figure]:
    """At the cut of the loop and between the hands, as far as told."""
    told, figures = _told(chart), []
    for signal, part, title, unit in (
        ("internal_wrench", slice(3), "Internal force, largest of the hands", "N"),
        ("internal_wrench", slice(3, 6), "Internal moment, largest of the hands", "N m"),
        ("cut_wrench", slice(3), "Constraint force at the cut", "N"),
    ):
        lines = {
            name: np.linalg.norm(
                told[name].signals[signal].reshape(told[name].ticks, -1, 6)[:, :, part], axis=2
            ).max(axis=1)
            for name in chart.names
            if name in told and signal in told[name].signals
        }
        if lines:
            figures.append(chart.plain(title, unit, lines))
    return figures


def _told(chart: Chart) -> dict[str, Trace]:
    return {name: trace for name, trace in chart.traces.items() if "tau" in trace.signals}


def _torque(chart: Chart, i: int, told: Mapping[str, Trace]) -> Figure:
    joint, limit = chart.any.joints[i], float(chart.any.effort[i])
    what, unit = ("Force", "N") if chart.any.units[i] == "m" else ("Torque", "N m")
    title = f"{what} of {joint}"
    lines = {
        name: told[name].signals["tau"][:, told[name].joints.index(joint)]
        for name in chart.names
        if name in told and joint in told[name].joints
    }
    if not np.isfinite(limit):
        return chart.plain(title, f"{unit}, no limit", lines)
    shown = Window(-1.15 * limit, 1.15 * limit)
    levels = [
        curves.level(-limit, f"-{limit:.3g}", above=False),
        curves.level(limit, f"{limit:.3g}"),
    ]
    return Figure(
        title=title,
        unit=unit,
        data=chart.beyond_limits(shown, -limit, limit) + chart.curves(lines),
        layout=chart.layout(curves.linear(shown), *levels),
    )
