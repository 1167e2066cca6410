"""How much room the joints have: margin, the paper's criterion, speed, acceleration."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from coopqp.assessment.assessment import accelerations
from coopqp.assessment.limits import beyond
from coopqp.base.spec import Array
from coopqp.metrics.limit_criterion import limit_criterion
from coopqp.report import curves
from coopqp.report.curves import Figure, Window
from coopqp.report.figures.chart import Chart
from coopqp.trace import Trace

MOST_SHARE = 3.0  # times the limit, beyond which shares need a log scale
SMALL = 1e-3  # smallest share on a log scale
MOST_CRITERION = 3.0  # times the calmest line's largest value, beyond which lines are cut off


def limit_figures(chart: Chart) -> list[Figure]:
    """Margin by unit, criterion, speed and acceleration."""
    speed, acceleration = chart.lines(speed_share), chart.lines(acceleration_share)
    what = "what the loop for robots allows"
    return [
        *(_margin(chart, unit) for unit in joint_units(chart.traces.values())),
        *_criterion(chart),
        _shares(chart, "Speed of the fastest joint", "its limit", speed, "speed limit"),
        _shares(chart, "Largest acceleration of a joint", what, acceleration, "allowed"),
    ]


def joint_units(traces: Iterable[Trace]) -> tuple[str, ...]:
    """The units that the joints of some trace have, "rad" before "m"."""
    return tuple(sorted({unit for trace in traces for unit in trace.units}, reverse=True))


def margin(trace: Trace, unit: str) -> Array:
    """Distance of the joint nearest to its limit, of those with a unit, shape (T + 1,) [unit]."""
    counts = np.array(trace.units) == unit
    least: Array = 0.0 - beyond(trace)[:, counts].max(axis=1)
    return least


def criterion(trace: Trace) -> Array:
    """What the null-space term of the paper shall keep small, shape (T + 1,)."""
    return limit_criterion(trace)["quadratic"]


def speed_share(trace: Trace) -> Array:
    """Speed of the fastest joint over its limit, at each tick, shape (T,)."""
    share: Array = (np.abs(trace.v) / trace.velocity).max(axis=1)
    return share


def acceleration_share(trace: Trace) -> Array:
    """Largest acceleration of a joint over what the loop for robots allows, shape (T,)."""
    share: Array = accelerations(trace).share.max(axis=1, initial=0.0)
    return share


def _margin(chart: Chart, unit: str) -> Figure:
    lines = chart.lines(lambda trace: margin(trace, unit) if unit in trace.units else None)
    best = max(0.1, *(float(y[np.isfinite(y)].max(initial=0.0)) for y in lines.values()))
    shown = curves.window(0.0, best, list(lines.values()), best)
    shown = Window(min(shown.bottom, -0.15 * best), shown.top)
    return chart.figure(
        f"Margin of the {'sliding joint' if unit == 'm' else 'joint'} nearest to its limit",
        f"{unit}, negative beyond the limit",
        lines,
        shown,
        curves.level(0.0, "limit", above=False),
        allowed=(0.0, np.inf),
        notes=curves.off_chart(shown, lines, unit),
    )


def _criterion(chart: Chart) -> list[Figure]:
    """None where no joint has a range."""
    lines = chart.lines(criterion)
    if not any(y.any() for y in lines.values()):
        return []
    top = MOST_CRITERION * min(float(y.max()) for y in lines.values())
    shown = Window(0.0, curves.window(0.0, top / MOST_CRITERION, list(lines.values()), top).top)
    unit, notes = (
        "1, smaller is farther from limits on the whole",
        curves.off_chart(shown, lines, ""),
    )
    return [chart.figure("Joint-limit criterion φ", unit, lines, shown, notes=notes)]


def _shares(chart: Chart, title: str, what: str, lines: dict[str, Array], bound: str) -> Figure:
    """Shares of a bound at each tick; on a log scale where some are far beyond it."""
    most = max(float(y.max(initial=0.0)) for y in lines.values())
    log = most > MOST_SHARE
    shown = Window(SMALL, 3.0 * most) if log else Window(0.0, max(1.25, 1.1 * most))
    lines = {name: np.maximum(y, SMALL) for name, y in lines.items()} if log else lines
    level, allowed = curves.level(1.0, bound, log=log), (-np.inf, 1.0)
    return chart.figure(
        title, f"share of {what}", lines, shown, level, allowed=allowed, log=log, steps=True
    )
