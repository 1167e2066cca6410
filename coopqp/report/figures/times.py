"""How long a tick takes: quartiles as a box, 1 and 99 percent as whiskers, the slowest a cross.

Ticks in C++ and ticks in Python have a figure each: they are no measure of each other.
"""

from __future__ import annotations

import html
import math
from itertools import chain as joined

import numpy as np

from coopqp.base.spec import Array
from coopqp.report import curves
from coopqp.report.cells import LANGUAGES, tick_times_in
from coopqp.report.curves import Figure, Json
from coopqp.report.figures.chart import Chart

MOST_TICKS = 5  # as many as fit side by side on a narrow page


def tick_times(chart: Chart) -> list[Figure]:
    """One for each language in which ticks were timed, with a box a controller."""
    timed = {name: tick_times_in(chart.traces[name]) for name in chart.names}
    found = []
    for language in LANGUAGES:
        times = {name: of[language] for name, of in timed.items() if language in of}
        if times:
            found.append(_figure(chart, language, times))
    return found


def _figure(chart: Chart, language: str, times: dict[str, Array]) -> Figure:
    boxes = [_box(chart, name, times[name]) for name in reversed(times)]
    layout = curves.layout(chart.end, {"type": "category", "automargin": True})
    every = np.concatenate(list(times.values()))
    low, high = float(every.min() / 1.3), float(every.max() * 1.3)
    ticks = _ticks(low, high)
    layout["xaxis"] |= {"type": "log", "range": [math.log10(low), math.log10(high)]}
    layout["xaxis"] |= {"tickvals": ticks, "ticktext": [f"{v:g}" for v in ticks], "tickangle": 0}
    layout["xaxis"] |= {"title": {"text": "time [µs]", "standoff": 4}}
    layout["height"] = max(curves.HEIGHT, 70 + 36 * len(boxes))
    return Figure(
        title=f"Time of a tick in {language}",
        unit="µs, log scale; box: half of all ticks, whiskers: 98 percent, cross: the slowest",
        data=list(joined(*boxes)),
        layout=layout,
        over_time=False,
    )


def _ticks(low: float, high: float) -> list[float]:
    """Of a log scale: 1, 2, 5, 10 ... or fewer of them where those are too many."""
    for steps in ((1, 2, 5), (1, 5), (1,)):
        ticks = [m * 10.0**e for e in range(-1, 8) for m in steps if low <= m * 10.0**e <= high]
        if len(ticks) <= MOST_TICKS:
            break
    return ticks


def _box(chart: Chart, name: str, us: Array) -> list[Json]:
    style = chart.styles[name]
    p1, q1, median, q3, p99 = np.percentile(us, [1, 25, 50, 75, 99]).tolist()
    label = html.escape(name)
    box = {
        "type": "box",
        "orientation": "h",
        "legendgroup": name,
        "y": [label],
        "lowerfence": [p1],
        "q1": [q1],
        "median": [median],
        "q3": [q3],
        "upperfence": [p99],
        "line": {"color": style.color, "width": 1.6},
        "hoverinfo": "x",
    }
    slowest = curves.markers(name, style, [(float(us.max()), 0.0)], "x")
    return [box, slowest | {"y": [label]}]
