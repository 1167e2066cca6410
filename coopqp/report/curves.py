"""Parts of all figures, as the data of ``Plotly.newPlot``: lines, hatched regions, layouts.

:class:`Chart` has what the figures of a comparison share: which controllers, over which time.

Each controller has a style that is safe for the colour-blind, and distinct in black and white.
"""

import html
import itertools
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coopqp.base.spec import Array
from coopqp.controller import ControlProblem
from coopqp.execution.comparison import Comparison
from coopqp.model.closed_chain import ClosedChain
from coopqp.trace import Trace

# Colours of Okabe and Ito, Color Universal Design (2008).
BLUE, VERMILION, GREEN, PURPLE = "#0072B2", "#D55E00", "#009E73", "#CC79A7"
BLACK, SKY, ORANGE = "#000000", "#56B4E9", "#E69F00"
PALETTE = (BLUE, VERMILION, GREEN, PURPLE, ORANGE, SKY, BLACK)

QP_COLORS = (BLUE, SKY, BLACK, PURPLE, GREEN, ORANGE)
OTHER_COLORS = (VERMILION, GREEN, PURPLE, BLACK, ORANGE, SKY)

#: Lengths of dash, gap, dash, gap ... [px]; the empty one is a full line.
QP_DASHES = ("", "16,4", "8,4", "3,4", "16,4,3,4", "8,3,2,3,2,3")
OTHER_DASHES = ("8,4", "2,3", "9,3,2,3", "16,4", "5,2", "12,3,2,3,2,3")

# The QP lies under the others and each of these under the next, so that all show where they agree.
QP_WIDTH, OTHER_WIDTHS = 4.5, (2.4, 1.9, 1.5)  # px

Json = dict[str, Any]

MAX_POINTS = 1000  # of a line, more cannot be seen
MARGIN = 0.1  # of the range, left free above and below; a label fits in
FONT = {"family": "system-ui, -apple-system, 'Segoe UI', Roboto, sans-serif", "size": 12}
INK, GRID, FORBIDDEN = "#333333", "#e6e6e6", "#f1f1f1"
HEIGHT = 215  # px
# Plotly's settings of markers, hatched regions and labels of lines.
MARKER = {"size": 10, "line": {"width": 1, "color": "white"}}
MARKERS = {"type": "scatter", "mode": "markers", "hoverinfo": "skip", "cliponaxis": False}
PATTERN = {"shape": "/", "size": 7, "solidity": 0.12, "fgcolor": "#8a8a8a", "bgcolor": FORBIDDEN}
REGION = {"type": "scatter", "mode": "lines", "fill": "toself", "line": {"width": 0}}
HATCHED = REGION | {"fillcolor": FORBIDDEN, "fillpattern": PATTERN, "hoverinfo": "skip"}
NAME = {"showarrow": False, "font": {"size": 10.5, "color": INK}, "xref": "paper", "x": 1}
LEVEL = NAME | {"xanchor": "right", "bgcolor": "rgba(255,255,255,0.6)", "borderpad": 1}
UPRIGHT = {"showarrow": False, "font": {"size": 10.5, "color": "#555"}, "yref": "paper"}


@dataclass(frozen=True)
class Style:
    """A line: colour such as "#0072B2", dashes and gaps or none [px], width [px]."""

    color: str
    dash: str
    width: float

    def line(self) -> dict[str, object]:
        dash = ",".join(f"{length}px" for length in self.dash.split(",")) if self.dash else "solid"
        return {"color": self.color, "dash": dash, "width": self.width, "simplify": False}

    def swatch(self) -> str:
        """A sample of the line, as SVG."""
        return (
            '<svg class="swatch" width="46" height="12" aria-hidden="true">'
            f'<line x1="1" y1="6" x2="45" y2="6" stroke="{self.color}" '
            f'stroke-width="{self.width}" stroke-dasharray="{self.dash or "none"}"/></svg>'
        )


def styles(traces: Mapping[str, Trace]) -> dict[str, Style]:
    """A style for each controller; who keeps limits is thick, the first of them full blue."""
    return chosen_styles({name: trace.keeps_limits for name, trace in traces.items()})


def chosen_styles(keeps_limits: Mapping[str, bool]) -> dict[str, Style]:
    """The same by whether each controller keeps limits."""
    chosen: dict[str, Style] = {}
    before = {True: itertools.count(), False: itertools.count()}
    for name, keeps in keeps_limits.items():
        colors, dashes = (QP_COLORS, QP_DASHES) if keeps else (OTHER_COLORS, OTHER_DASHES)
        i = next(before[keeps])
        width = QP_WIDTH if keeps else OTHER_WIDTHS[min(i, len(OTHER_WIDTHS) - 1)]
        chosen[name] = Style(colors[i % len(colors)], dashes[i % len(dashes)], width)
    return chosen


@dataclass(frozen=True, kw_only=True)
class Figure:
    """One figure of the page, with data and layout for Plotly."""

    title: str
    unit: str  # of the vertical axis
    data: list[Json]
    layout: Json
    notes: tuple[str, ...] = ()  # below the title, such as what lies off the chart
    about: str = ""  # beside the title
    alone: bool = False  # whether nothing is shown beside it
    over_time: bool = True  # whether its horizontal axis is time


@dataclass(frozen=True)
class Window:
    """The part of the vertical axis that is shown."""

    bottom: float
    top: float


def thinned(t: Array, y: Array) -> tuple[Array, Array]:
    """Keep the smallest and the largest value of each stretch, so that no peak is lost."""
    if len(y) <= MAX_POINTS:
        return t, y
    edges = np.linspace(0, len(y), MAX_POINTS // 2 + 1).astype(int)
    kept = {0, len(y) - 1}
    for a, b in itertools.pairwise(edges.tolist()):
        kept |= {a + int(y[a:b].argmin()), a + int(y[a:b].argmax())}
    order = sorted(kept)
    return t[order], y[order]


def listed(values: Array) -> list[float | None]:
    """Numbers for JSON, short; what is not finite becomes null."""
    return [float(f"{v:.7g}") if math.isfinite(v) else None for v in values.tolist()]


def curve(name: str, style: Style, t: Array, y: Array, *, steps: bool = False) -> Json:
    """A controller's line."""
    t, y = thinned(t, y)
    line = style.line() | ({"shape": "hv"} if steps else {})
    return aside(name, t, y, line) | {"legendgroup": name}


def aside(name: str, t: Array, y: Array, line: Json) -> Json:
    """A line that is no controller's, such as a goal."""
    return {
        "type": "scatter",
        "mode": "lines",
        "name": html.escape(name),
        "x": listed(t),
        "y": listed(y),
        "line": line,
        "hovertemplate": "%{y:.4g} at %{x:.3f} s<extra>%{fullData.name}</extra>",
    }


def mark(name: str, style: Style, x: float, y: float | str, symbol: str) -> Json:
    """A mark on a controller's line."""
    marker = MARKER | {"symbol": symbol, "color": style.color}
    return MARKERS | {"legendgroup": name, "x": [x], "y": [y], "marker": marker}


def level(y: float, text: str = "", *, above: bool = True, log: bool = False) -> Json:
    """A horizontal line across the figure, with its name at the right."""
    line = {"color": INK, "width": 1.2}
    shape = {"type": "line", "xref": "paper", "x0": 0, "x1": 1, "y0": y, "y1": y, "line": line}
    place = {"y": math.log10(y) if log else y, "yanchor": "bottom" if above else "top"}
    return {"shapes": [shape], "annotations": [LEVEL | place | {"text": text}] if text else []}


def upright(t: float, text: str, *, after: bool = False) -> Json:
    """A dotted line at an instant, with its name at the bottom, or after it at the top."""
    line = {"color": "#777", "width": 1, "dash": "dot"}
    shape = {"type": "line", "yref": "paper", "x0": t, "x1": t, "y0": 0, "y1": 1, "line": line}
    xanchor, y, yanchor = ("left", 1, "top") if after else ("right", 0, "bottom")
    place = {"x": t, "xanchor": xanchor, "y": y, "yanchor": yanchor, "text": html.escape(text)}
    return {"shapes": [shape], "annotations": [UPRIGHT | place]}


def layout(end: float, y: Json, *levels: Json) -> Json:
    """Of a figure over time."""
    axis = {"gridcolor": GRID, "zeroline": False, "linecolor": "#999", "ticks": "outside"}
    return {
        "height": HEIGHT,
        "margin": {"l": 56, "r": 12, "t": 8, "b": 38},
        "font": FONT | {"color": INK},
        "showlegend": False,
        "hovermode": "closest",
        "plot_bgcolor": "white",
        "paper_bgcolor": "white",
        "xaxis": axis | {"range": [0, end], "title": {"text": "time [s]", "standoff": 4}},
        "yaxis": axis | y,
        "shapes": [shape for item in levels for shape in item["shapes"]],
        "annotations": [label for item in levels for label in item["annotations"]],
    }


def linear(window: Window) -> Json:
    """A vertical axis."""
    return {"range": [window.bottom, window.top], "nticks": 6}


def logarithmic(window: Window) -> Json:
    """A vertical axis with few, whole powers of ten."""
    bottom, top = math.log10(window.bottom), math.log10(window.top)
    return {
        "type": "log",
        "range": [bottom, top],
        "dtick": max(1, math.ceil((top - bottom) / 6)),
        "tickfont": {"size": 11},
        "exponentformat": "power",
        "showexponent": "all",
    }


def window(low: float, high: float, lines: Sequence[Array], reach: float) -> Window:
    """Show from low to high, and of lines that leave this no more than reach beyond."""
    finite = np.concatenate([y[np.isfinite(y)] for y in lines] or [np.zeros(0)])
    bottom = max(min(low, float(finite.min(initial=low))), low - reach)
    top = min(max(high, float(finite.max(initial=high))), high + reach)
    pad = MARGIN * (top - bottom)
    return Window(bottom - pad, top + pad)


def off_chart(shown: Window, lines: Mapping[str, Array], unit: str = "") -> tuple[str, ...]:
    """Notes on lines that leave the chart, and how far they get."""
    notes = []
    for name, line in lines.items():
        y = line[np.isfinite(line)]
        if y.max(initial=shown.bottom) > shown.top or y.min(initial=shown.top) < shown.bottom:
            worst = y[np.maximum(y - shown.top, shown.bottom - y).argmax()]
            notes.append(f"▲ {name} goes off the chart, to {worst:.3g} {unit}".rstrip())
    return tuple(notes)


ALWAYS = slice(None)  # rows of a trace
Lines = dict[str, Array]  # values over time by controller


class Chart:
    """Lines of all controllers of a comparison over the whole run."""

    def __init__(self, comparison: Comparison) -> None:
        self.comparison, self.traces = comparison, comparison.traces
        # In drawing order: who keeps limits first, so that thin lines lie on top of thick ones.
        self.names = sorted(self.traces, key=lambda name: not self.traces[name].keeps_limits)
        self.styles = styles(self.traces)
        # The trace with most joints; grasps may differ between controllers.
        self.any = max(self.traces.values(), key=lambda trace: len(trace.joints))
        self.end = float(self.any.t[-1])

    @property
    def chain(self) -> ClosedChain:
        return self.comparison.scenario.held_by(self.any.controller).chain

    @cached_property
    def problems(self) -> dict[str, list[ControlProblem]]:
        """Each controller's problem in each phase, from where it then was."""
        held_by, traces = self.comparison.scenario.held_by, self.traces.items()
        return {k: list(held_by(k).problems(of.commanded.__getitem__)) for k, of in traces}

    def instants(self, trace: Trace, count: int) -> list[NDArray[np.int64]]:
        """At most ``count`` rows of each phase, evenly spread, first and last among them."""
        firsts = self.comparison.scenario.first_ticks
        return [
            np.unique(np.linspace(a, b, min(b - a + 1, count)).round().astype(np.int64))
            for a, b in zip(firsts, [*firsts[1:], trace.ticks], strict=True)
        ]

    def lines(self, of: Callable[[Trace], Array | None]) -> Lines:
        """A quantity of every trace that has it."""
        return {k: y for k in self.names if (y := of(self.traces[k])) is not None}

    def layout(self, axis: Json, *levels: Json) -> Json:
        """Over the whole run, with a line where a phase begins."""
        begins = [upright(float(self.any.t[p.first]), p.name, after=True) for p in self.any.phases]
        return layout(self.end, axis, *begins, *levels)

    def figure(
        self,
        title: str,
        unit: str,
        lines: Lines,
        shown: Window,
        *levels: Json,
        lower: tuple[float, str] = (-np.inf, ""),
        upper: tuple[float, str] = (np.inf, ""),
        log: bool = False,
        steps: bool = False,
        rows: slice = ALWAYS,
        extra: Iterable[Json] = (),
        noted: str | None = None,  # unit in which notes tell of lines that leave the chart
    ) -> Figure:
        """Lines at some rows of the trace; hatched beyond lower and upper bound, with names."""
        t, ends = self.any.t[rows], ((lower, False), (upper, True))
        bounds = [level(*of, above=up, log=log) for of, up in ends if math.isfinite(of[0])]
        hatched = [(shown.bottom, lower[0]), (upper[0], shown.top)]
        x = [0.0, self.end, self.end, 0.0, 0.0]
        data = [HATCHED | {"x": x, "y": [a, a, b, b, a]} for a, b in hatched if a < b]
        for name, y in lines.items():
            data.append(curve(name, self.styles[name], t[: len(y)], y, steps=steps))
        axis = logarithmic(shown) if log else linear(shown)
        return Figure(
            title=title,
            unit=f"{unit}, log scale" if log else unit,
            data=[*data, *extra],
            layout=self.layout(axis, *bounds, *levels),
            notes=() if noted is None else off_chart(shown, lines, noted),
        )

    def plain(self, title: str, unit: str, lines: Lines) -> Figure:
        """Lines over time on a linear scale that has a zero."""
        low = min(0.0, *(float(y.min(initial=0.0)) for y in lines.values()))
        high = max(1e-3, *(float(y.max(initial=0.0)) for y in lines.values()))
        return self.figure(title, unit, lines, Window(1.1 * low, 1.1 * high))
