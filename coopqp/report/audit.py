"""The limits audit of the page: what every limit had left, and when which was active.

One line for each limit, for limits of joints one for each joint: of both its sides, or of all the
points and pairs of a wall, what is shown is what was nearest.
"""

import html
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from coopqp.assessment.thresholds import AT_LIMIT, matters
from coopqp.base.qp import Row
from coopqp.base.spec import Array
from coopqp.report import curves
from coopqp.report.cells import length, number
from coopqp.report.curves import Figure, Json, Style
from coopqp.trace import Trace

SHOWN = 10  # limits of each controller in the table
MAX_LINES = 14  # of the timeline


@dataclass(frozen=True)
class Audited:
    """A limit, or that of one joint, such as "position of RElbowRoll"."""

    name: str
    row: Row  # the one of its rows that had least left
    margin: Array  # least of all its rows after each tick, shape (T,) [the row's unit]

    @property
    def min_margin(self) -> float:
        return float(self.margin.min())

    @property
    def broken(self) -> bool:
        return matters(-self.min_margin, self.row.unit)

    @property
    def active(self) -> NDArray[np.bool_]:
        """In which ticks nothing was left, shape (T,)."""
        return self.margin <= AT_LIMIT


def rows(traces: Mapping[str, Trace]) -> str:
    """Rows of the table: broken limits first, then those at the bound for longest."""

    def use(limit: Audited) -> tuple[bool, int, float]:
        return not limit.broken, -int(limit.active.sum()), limit.min_margin

    tightest = {k: sorted(limits_of(of), key=use)[:SHOWN] for k, of in audited(traces).items()}
    return "".join(_row(name, limit) for name, limits in tightest.items() for limit in limits)


def _row(name: str, limit: Audited) -> str:
    value, unit = length(limit.min_margin, limit.row.unit)
    where = "" if limit.row.joint else f" ({limit.row.label})"
    margin = f"{'✗ ' if limit.broken else ''}{number(value)} {unit}"
    cells = (margin, f"{limit.active.sum()}", f"{100 * limit.active.mean():.0f} %")
    texts = [f"<td class='name'>{html.escape(text)}</td>" for text in (name, limit.name + where)]
    texts += [f"<td>{html.escape(text)}</td>" for text in cells]
    return f"<tr>{''.join(texts)}</tr>"


def timeline(traces: Mapping[str, Trace], styles: Mapping[str, Style]) -> Figure | None:
    """When which limit was active, a line each; None when none ever was."""
    found = {
        name: {limit.name: limit.active for limit in limits_of(trace) if limit.active.any()}
        for name, trace in audited(traces).items()
    }
    used = Counter[str]()
    for of in found.values():
        used |= Counter({name: int(active.sum()) for name, active in of.items()})  # the most
    shown = [name for name, _ in used.most_common(MAX_LINES)]
    if not shown:
        return None
    data: list[Json] = []
    for name, of in found.items():
        mark = {"color": styles[name].color, "symbol": "square", "size": 5}
        look = {"type": "scatter", "mode": "markers", "marker": mark, "hoverinfo": "x+y"}
        for line in (line for line in reversed(shown) if line in of):
            t = traces[name].t[1:][of[line]]
            t, _ = curves.thinned(t, t)
            data.append(look | {"x": t.tolist(), "y": [line] * len(t), "legendgroup": name})
    end = max(float(trace.t[-1]) for trace in traces.values())
    axis = {"type": "category", "automargin": True, "categoryarray": list(reversed(shown))}
    layout = curves.layout(end, axis)
    layout["height"] = 90 + 22 * len(shown)
    return Figure(title="Active limits", unit="a mark a tick", data=data, layout=layout)


def audited(traces: Mapping[str, Trace]) -> dict[str, Trace]:
    """The controllers that promise to keep limits."""
    return {name: trace for name, trace in traces.items() if trace.keeps_limits and trace.margins}


def limits_of(trace: Trace) -> list[Audited]:
    """Every limit of a run, those of joints joint by joint."""
    groups: dict[str, list[tuple[Row, Array]]] = {}
    for row, margin in trace.margins.items():
        if margin.size and np.isfinite(margin).any():
            name = f"{row.owner} of {row.joint}" if row.joint else row.owner
            groups.setdefault(name, []).append((row, margin))
    found = []
    for name, group in groups.items():
        tightest, _ = min(group, key=lambda entry: float(entry[1].min()))
        found.append(Audited(name, tightest, np.min([margin for _, margin in group], axis=0)))
    return found
