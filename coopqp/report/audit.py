"""The limits audit of the page: what every limit had left, and when which was active."""

from __future__ import annotations

import html
from collections.abc import Mapping

import numpy as np

from coopqp.checked import Array
from coopqp.metrics.limits_audit import AT_BOUND
from coopqp.report import curves
from coopqp.report.curves import Figure
from coopqp.report.style import Style
from coopqp.row import Row
from coopqp.trace import Trace

SHOWN = 10  # limits of each controller in the table
MOST_LINES = 14  # of the timeline


def rows(traces: Mapping[str, Trace]) -> str:
    """Rows of the table: the limits that had least left, the most used first."""
    lines = []
    for name, trace in audited(traces).items():
        for row, margin in _tightest(trace):
            active = margin <= AT_BOUND
            least = f"{margin.min():.3g} {row.unit}"
            cells = (least, str(int(active.sum())), f"{100 * active.mean():.0f} %")
            lines.append(
                f"<tr><td class='name'>{html.escape(name)}</td><td class='name'>"
                f"{html.escape(row.name)}</td>{''.join(f'<td>{cell}</td>' for cell in cells)}</tr>"
            )
    return "".join(lines)


def timeline(traces: Mapping[str, Trace], styles: Mapping[str, Style]) -> Figure | None:
    """When which limit was active, a line each; None when none ever was."""
    used: dict[str, int] = {}
    for trace in audited(traces).values():
        for row, margin in trace.margins.items():
            used[row.name] = max(used.get(row.name, 0), int((margin <= AT_BOUND).sum()))
    shown = sorted((k for k, ticks in used.items() if ticks), key=lambda k: -used[k])[:MOST_LINES]
    if not shown:
        return None
    data = []
    for name, trace in audited(traces).items():
        margins = {row.name: margin for row, margin in trace.margins.items()}
        for limit in reversed(shown):
            if limit not in margins:
                continue
            active = margins[limit] <= AT_BOUND
            t, _ = curves.thinned(trace.t[1:][active], trace.t[1:][active])
            mark = {"color": styles[name].color, "symbol": "square", "size": 5}
            data.append(
                {
                    "type": "scatter", "mode": "markers", "x": t.tolist(), "y": [limit] * len(t),
                    "marker": mark, "legendgroup": name, "hoverinfo": "x+y",
                }
            )  # fmt: skip
    end = max(float(trace.t[-1]) for trace in traces.values())
    axis = {"type": "category", "automargin": True, "categoryarray": list(reversed(shown))}
    layout = curves.layout(end, axis)
    layout["height"] = 90 + 22 * len(shown)
    return Figure(title="Active limits", unit="a mark a tick", data=data, layout=layout)


def audited(traces: Mapping[str, Trace]) -> dict[str, Trace]:
    """The controllers that promise to keep limits."""
    return {name: trace for name, trace in traces.items() if trace.keeps_limits and trace.margins}


def _tightest(trace: Trace) -> list[tuple[Row, Array]]:
    finite = [(row, m) for row, m in trace.margins.items() if np.isfinite(m).any() and m.size]
    order = sorted(finite, key=lambda pair: (-int((pair[1] <= AT_BOUND).sum()), pair[1].min()))
    return order[:SHOWN]
