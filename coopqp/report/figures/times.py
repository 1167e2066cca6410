"""How long a tick takes: quartiles as a box, 1 and 99 percent as whiskers, the slowest a cross."""

from __future__ import annotations

import html
from itertools import chain as joined

import numpy as np

from coopqp.report import curves
from coopqp.report.curves import Figure, Json
from coopqp.report.figures.chart import Chart

ONE_TWO_FIVE = [m * 10.0**e for e in range(-1, 7) for m in (1, 2, 5)]  # ticks of log scales


def tick_times(chart: Chart) -> Figure:
    """A box a controller."""
    boxes = [_box(chart, name) for name in reversed(chart.names)]
    layout = curves.layout(chart.end, {"type": "category", "automargin": True})
    times = np.concatenate([chart.traces[name].tick_us for name in chart.names])
    low, high = np.log10(times.min() / 1.3), np.log10(times.max() * 1.3)
    layout["xaxis"] |= {"type": "log", "range": [float(low), float(high)]}
    layout["xaxis"] |= {"tickvals": ONE_TWO_FIVE, "ticktext": [f"{v:g}" for v in ONE_TWO_FIVE]}
    layout["xaxis"] |= {"title": {"text": "time [µs]", "standoff": 4}}
    layout["height"] = max(curves.HEIGHT, 70 + 36 * len(boxes))
    return Figure(
        title="Time of a tick",
        unit="µs, log scale; box: half of all ticks, whiskers: 98 percent, cross: the slowest",
        data=list(joined(*boxes)),
        layout=layout,
        over_time=False,
    )


def _box(chart: Chart, name: str) -> list[Json]:
    us, style = chart.traces[name].tick_us, chart.styles[name]
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
