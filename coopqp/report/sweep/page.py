"""The page of a study: one file, which works offline and is small whatever the study's size.

It shows the study in bins, a few thousand numbers for any number of rows.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from string import Template
from typing import Any

import numpy as np
from numpy.typing import NDArray

import coopqp
from coopqp.base.spec import Array
from coopqp.report import curves
from coopqp.report.curves import Style
from coopqp.report.files import write_one
from coopqp.report.page import asset, breakable, html_table, script_json, text
from coopqp.report.strict_json import finite
from coopqp.report.sweep.table import difference, points
from coopqp.study.sweep import scenario_of_row
from coopqp.study.sweep.results import Columns
from coopqp.study.sweep.space import Interval
from coopqp.study.sweep.study import DONE, Study
from coopqp.study.sweep.summary import ERROR, MARGIN, Line, Pair, Summary

NAME = "report.html"
ROWS = "rows"  # folder with the scenarios of the worst rows
MAX_LIMITS = 12  # that are shown for each controller
TESTS = (
    '<p class="hint">Success: interval of Bonett and Price, exact test of McNemar. Numbers: '
    "median of the differences, with order statistics as its interval, and the sign test.</p>"
)
BINS, MIN_BINS = 16, 4  # of an axis with numbers
ROWS_A_CELL = 8  # of a map and a controller, where there are enough variants
LEVELS = 24  # values that have a bin each; of texts the most frequent
MAX_AXES = 8  # on the page; the first ones
QUANTILES = (0.05, 0.25, 0.5, 0.75, 0.95)
OTHER = "others"
NULL = "left out"  # what a scenario does with a key that is null
Codes = NDArray[np.int64]
WORST = 10


def write(study: Study, columns: Columns, summary: Summary, folder: Path) -> Path:
    """Write ``report.html``, and the scenarios that it links to."""
    binned, error = Binned(study, columns), worst_error(columns)
    worst = [worst_rows(binned, error, k) for k in range(len(binned.controllers))]
    numbers = columns.numbers("row")
    for row in (row for rows in worst for row in rows):
        path = folder / ROWS / f"{int(numbers[row])}.yaml"
        if not path.exists():
            write_one(path, scenario_of_row(study, int(numbers[row]))[0])
    write_one(folder / NAME, _render(study, columns, summary, binned, worst))
    return folder / NAME


def _render(
    study: Study, columns: Columns, summary: Summary, binned: Binned, worst: Sequence[Sequence[int]]
) -> str:
    drawn = [_style(k) for k in range(len(binned.controllers))]
    measures = [name for name in columns.kinds if name.startswith(ERROR)]
    data = {
        "controllers": list(binned.controllers),
        "colors": [style.color for style in drawn],
        "dashes": [style.dash for style in drawn],
        "widths": [style.width for style in drawn],
        "axes": [axis.as_json() for axis in binned.axes],
        "maps": list(binned.maps()),
        "bands": {name: binned.bands(columns.numbers(name)) for name in (*measures, MARGIN)},
        "margin": MARGIN,
        "flows": binned.flows(),
    }
    return Template(asset("sweep/page.html")).substitute(
        title=text(study.name),
        version=text(coopqp.__version__),
        facts=_facts(study, summary),
        summary=_summary(summary),
        reasons=_reasons(summary),
        paired=_paired(summary.pairs, exact=summary.exact),
        blocked="".join(_limits(line) for line in summary.lines),
        legend="".join(
            f"<span>{style.swatch()} {breakable(name)}</span>"
            for style, name in zip(drawn, binned.controllers, strict=True)
        ),
        worst="".join(
            _worst(name, rows, [axis.name for axis in binned.axes], columns)
            for name, rows in zip(binned.controllers, worst, strict=True)
        ),
        data=script_json(finite(data)),
        css=asset("page.css") + asset("sweep/page.css"),
        js=asset("sweep/page.js"),
    )


def _style(k: int) -> Style:
    """The first is drawn below the others, each of these below the next."""
    dashes, widths = ("", *curves.OTHER_DASHES), (curves.QP_WIDTH, *curves.OTHER_WIDTHS)
    color = curves.PALETTE[k % len(curves.PALETTE)]
    return Style(color, dashes[k % len(dashes)], widths[min(k, len(widths) - 1)])


def _facts(study: Study, summary: Summary) -> str:
    missing = study.rows - summary.rows
    facts = {
        "scenario": study.scenario.path.stem,
        "variants": f"{study.points.count:,}",
        "controllers": str(len(study.controllers)),
        "rows": f"{summary.rows:,}" + (f", {missing:,} still to come" if missing else ""),
        "seed": str(study.seed),
    }
    return " · ".join(f"{name} <b>{text(value)}</b>" for name, value in facts.items())


def _summary(summary: Summary) -> str:
    names = list(dict.fromkeys(name for line in summary.lines for name in line.errors))
    errors = [f"{text(name)}<small>median, 95 %</small>" for name in names]
    share = "%" if summary.exact else "%, 95 % interval"
    heads = [
        "Controller", "done", "invalid", "failed", f"success<small>{share}</small>",
        "reached<small>%</small>", *errors, "least margin<small>median, 5 % [rad or m]</small>",
    ]  # fmt: skip
    lines = enumerate(summary.lines)
    return html_table(heads, [_line(k, line, names, exact=summary.exact) for k, line in lines])


def _line(k: int, line: Line, names: Sequence[str], *, exact: bool) -> list[str]:
    states = [f"{line.states.get(state, 0):,}" for state in ("done", "invalid", "failed")]
    reached = line.reached.percent(1, exact=True)
    quantiles = [*(line.errors[name] for name in names), line.margin]
    shown = [f"{a:.3g}, {b:.3g}" if a == a else "-" for a, b in quantiles]
    name = f'<i style="background:{_style(k).color}"></i>{breakable(line.controller)}'
    return [name, *states, line.success.percent(1, exact=exact), reached, *shown]


def _reasons(summary: Summary) -> str:
    if not summary.reasons:
        return ""
    reasons = list(summary.reasons.items())[:MAX_LIMITS]
    items = "".join(f"<li><b>{count:,}</b> {text(reason)}</li>" for reason, count in reasons)
    more = len(summary.reasons) - MAX_LIMITS
    rest = f"<li>and {more} other reasons</li>" if more > 0 else ""
    done = any(line.states.get(DONE) for line in summary.lines)
    none = "" if done else '<p class="hint"><b>No row is done</b>, so there are no figures.</p>'
    return (
        f"{none}<details{'' if done else ' open'}><summary>Why rows are not done</summary>"
        f'<ul class="notes">{items}{rest}</ul></details>'
    )


def _paired(pairs: Sequence[Pair], *, exact: bool) -> str:
    if not pairs:
        return ""
    tested = "" if exact else ", p, 95 % interval"
    heads = [
        f"Less {breakable(pairs[0].reference)}, on the same variants", "both succeed", "only this",
        "only the reference", "neither", f"success<small>points{tested}</small>",
        *(f"{text(name)}<small>median{tested}</small>" for name in pairs[0].numbers),
    ]  # fmt: skip
    rows = []
    for p in pairs:
        counts = (p.success.both, p.success.only_one, p.success.only_reference, p.success.neither)
        numbers = (difference(number, exact=exact) for number in p.numbers.values())
        values = [points(p.success.difference, exact=exact), *numbers]
        lines = (f'<span class="lines">{v.replace(chr(10), "<br>")}</span>' for v in values)
        rows.append([breakable(p.controller), *(f"{n:,}" for n in counts), *lines])
    hint = "" if exact else TESTS
    table = html_table(heads, rows)
    return f"<section><h2>Controllers against each other</h2>{hint}{table}</section>"


def _limits(line: Line) -> str:
    """Bars: how often a limit has blocked the way, or was violated."""
    blocked = _bars("ends at it, short of the goal", line.blocked_by, line.success.of)
    beyond = _bars("goes beyond it", line.broken, line.success.of)
    bars = blocked + beyond or '<p class="hint">No limit in the way, none broken.</p>'
    return f"<div><h3>{breakable(line.controller)}</h3>{bars}</div>"


def _bars(title: str, counts: dict[str, int], of: int) -> str:
    if not counts:
        return ""
    width = 50.0 / max(counts.values())
    rows = "".join(
        f'<div class="limit"><span>{breakable(name)}</span>'
        f'<b style="width:{width * n:.1f}%"></b>{n:,} ({100.0 * n / of:.1f} %)</div>'
        for name, n in list(counts.items())[:MAX_LIMITS]
    )
    return f'<p class="hint">{title}</p>{rows}'


def _worst(name: str, rows: Sequence[int], varied: Sequence[str], columns: Columns) -> str:
    head = f"<h3>{breakable(name)}</h3>"
    if not rows:
        return f"{head}<p class='hint'>No row is done that does not succeed.</p>"
    errors = [x for x in columns.kinds if x.startswith(ERROR)]
    shown = [*varied, *errors, MARGIN, "blocked_by", "broken"]
    values = [_cells(columns, column, rows) for column in shown]
    numbers = columns.numbers("row")[list(rows)].astype(int)
    links = [f'<a href="{ROWS}/{number}.yaml">{number}</a>' for number in numbers]
    linked = [[link, *(v[k] for v in values)] for k, link in enumerate(links)]
    heads = ["row", *(breakable(column).replace(".", ".<wbr>") for column in shown)]
    return f'{head}<div class="worst">{html_table(heads, linked)}</div>'


def _cells(columns: Columns, name: str, rows: Sequence[int]) -> list[str]:
    if columns.kinds[name] == "string":
        codes, texts = columns.codes(name)
        return [text(texts[codes[row]]) if codes[row] >= 0 else "" for row in rows]
    numbers = columns.numbers(name)
    return [f"{numbers[row]:.4g}" for row in rows]


@dataclass(frozen=True)
class Axis:
    """A varied quantity, in bins with labels or edges (one more than bins)."""

    name: str
    labels: tuple[str, ...]
    edges: tuple[float, ...]
    log: bool  # whether the edges are evenly spaced in their logarithm
    code: Codes  # bin of each row, shape (rows,)

    @property
    def count(self) -> int:
        return len(self.labels) or len(self.edges) - 1

    def as_json(self) -> dict[str, Any]:
        edges = [short(edge) for edge in self.edges]
        return {"name": self.name, "labels": self.labels, "edges": edges, "log": self.log}


def axes(study: Study, columns: Columns) -> list[Axis]:
    """All that takes more than one value, the first ones of many."""
    pairs = (x for one in study.varied for x in zip(one.columns, one.over.sides, strict=False))
    sides = {name: side for name, side in pairs if isinstance(side, Interval)}
    count = bins_for(study.points.count)
    every = (_axis(columns, name, sides.get(name), count) for name in study.columns)
    return [axis for axis in every if axis is not None and axis.count > 1][:MAX_AXES]


def bins_for(variants: int) -> int:
    """So many that a cell of a map has enough rows; a multiple of four, for ticks."""
    return min(BINS, max(MIN_BINS, int(np.sqrt(variants / ROWS_A_CELL)) // 4 * 4))


def _axis(columns: Columns, name: str, side: Interval | None, count: int) -> Axis | None:
    """Bins of a column, between the ends of what it is varied over where that is an interval."""
    kind = columns.kinds[name]
    if kind == "string":
        return _texts(columns, name)
    values = columns.numbers(name)
    there = np.isfinite(values)
    if not there.any():
        return None
    known, log = np.unique(values[there]), side is not None and side.grows
    if kind == "bool" or len(known) <= LEVELS:
        labels = tuple(("false", "true")[int(v)] if kind == "bool" else f"{v:.4g}" for v in known)
        return _with_null(Axis(name, labels, (), log, np.searchsorted(known, values)), there)
    shown = np.log10(values, where=there, out=np.zeros_like(values)) if log else values
    low, high = (side.low, side.high) if side else (shown[there].min(), shown[there].max())
    edges = np.linspace(low, high, count + 1)  # of logarithms, as the study has them
    code = np.clip(np.searchsorted(edges, shown, side="right") - 1, 0, count - 1)
    even = tuple((10.0**edges if log else edges).tolist())
    return _with_null(Axis(name, (), even, log, code), there)


def _with_null(axis: Axis, there: NDArray[np.bool_]) -> Axis:
    """The axis with one more bin for rows whose key is null; its bins then all have labels."""
    if there.all():
        return axis
    between = (f"{a:.4g} to {b:.4g}" for a, b in itertools.pairwise(axis.edges))
    labels = (*(axis.labels or between), NULL)
    return replace(axis, labels=labels, edges=(), code=np.where(there, axis.code, axis.count))


def _texts(columns: Columns, name: str) -> Axis:
    codes, texts = columns.codes(name)
    there = codes >= 0
    if len(texts) <= LEVELS:
        return _with_null(Axis(name, tuple(texts), (), False, codes), there)
    order = np.argsort(-np.bincount(codes[there], minlength=len(texts)), kind="stable")
    kept = order[: LEVELS - 1]
    new = np.full(len(texts) + 1, LEVELS - 1)
    new[kept] = np.arange(len(kept))
    labels = (*(texts[i] for i in kept), OTHER)
    return _with_null(Axis(name, labels, (), False, new[codes]), there)


class Binned:
    """Of each row, shape (rows,): controller, whether it is done, success (1, 0 or NaN)."""

    def __init__(self, study: Study, columns: Columns) -> None:
        self.axes, self.done = axes(study, columns), columns.done
        self.controller, self.controllers = columns.codes("controller")
        self.success = columns.numbers("success")

    def maps(self) -> Iterator[dict[str, Any]]:
        """For each pair of axes and each controller how many rows, and how many succeed."""
        numbers = range(len(self.axes))
        pairs = list(itertools.combinations(numbers, 2)) or [(0, 0)] * bool(self.axes)
        done = [self.done & (self.controller == k) for k in range(len(self.controllers))]
        good = [rows & (self.success > 0.0) for rows in done]
        for i, j in pairs:
            a, b = self.axes[i], self.axes[j]
            cell, cells = a.code * b.count + b.code, a.count * b.count
            every, succeeded = (
                [np.bincount(cell[rows], minlength=cells).tolist() for rows in kept]
                for kept in (done, good)
            )
            yield {"x": i, "y": j, "all": every, "good": succeeded}

    def bands(self, values: Array) -> list[list[list[list[float] | None]]]:
        """Quantiles of a column: by axis, by controller, by bin; None for an empty bin."""
        controllers = range(len(self.controllers))
        return [[self._quantiles(axis, values, k) for k in controllers] for axis in self.axes]

    def _quantiles(self, axis: Axis, values: Array, controller: int) -> list[list[float] | None]:
        rows = np.flatnonzero(self.done & (self.controller == controller) & np.isfinite(values))
        rows = rows[np.argsort(axis.code[rows], kind="stable")]
        ends = np.searchsorted(axis.code[rows], np.arange(axis.count + 1))
        return [
            [short(q) for q in np.quantile(values[rows[a:b]], QUANTILES)] if b > a else None
            for a, b in itertools.pairwise(ends)
        ]

    def flows(self) -> list[list[list[int]]]:
        """Parallel coordinates: between neighbouring axes, [bin, bin, rows, successes].

        Before the first axis come the controllers, after the last success.
        """
        good = self.success > 0.0
        sides = [self.controller, *(axis.code for axis in self.axes), good.astype(np.int64)]
        counts = [*(axis.count for axis in self.axes), 2]
        flows = []
        for (a, b), n in zip(itertools.pairwise(sides), counts, strict=True):
            pair = (a * n + b)[self.done]
            every, succeeded = np.bincount(pair), np.bincount(pair, weights=good[self.done])
            there = np.flatnonzero(every).tolist()
            flows.append([[c // n, c % n, int(every[c]), int(succeeded[c])] for c in there])
        return flows


def short(value: float) -> float:
    """With five digits."""
    return float(f"{value:.5g}")


def worst_error(columns: Columns) -> Array:
    """Each row's largest task error, in medians of that task, shape (rows,)."""
    worst = np.full(len(columns), -np.inf)
    for name in columns.kinds:
        if name.startswith(ERROR):
            error = columns.numbers(name)
            known = error[np.isfinite(error)]
            scale = float(np.median(known)) if len(known) else 1.0
            worst = np.fmax(worst, error / (scale or 1.0))
    return worst


def worst_rows(binned: Binned, error: Array, controller: int) -> list[int]:
    """A controller's rows without success, the largest errors first; a NaN is the largest."""
    rows = np.flatnonzero(binned.done & (binned.controller == controller) & ~(binned.success > 0.0))
    far = np.where(np.isfinite(error[rows]), error[rows], np.inf)
    return [int(row) for row in rows[np.argsort(-far, kind="stable")[:WORST]]]
