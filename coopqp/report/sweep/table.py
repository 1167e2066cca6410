"""A study in the terminal; fits 100 columns."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict
from typing import Any

from rich import box
from rich.table import Table
from rich.text import Text

from coopqp.errors import one_line
from coopqp.study.statistics.paired import Difference
from coopqp.study.sweep.summary import Line, Summary

MOST_NAMES, MOST_REASONS = 3, 5


def table(name: str, summary: Summary) -> Table:
    """One row a controller."""
    found = Table(
        title=Text(one_line(f"{name}: {summary.rows:,} rows"), style="bold"),
        title_justify="left",
        box=box.SIMPLE_HEAD,
        padding=(0, 1),
        show_edge=False,
    )
    names = [len(one_line(line.controller)) for line in summary.lines]
    found.add_column("controller", overflow="fold", min_width=min(24, max(names, default=0)))
    for heading in ("done,\ninvalid,\nfailed", "success\n%, 95 % interval", "reached\n%"):
        found.add_column(heading, justify="right", no_wrap=True)
    found.add_column("error, median\n95 % (m, rad)", justify="right", no_wrap=True)
    for heading in ("blocked by,\nhow often", "broken,\nhow often"):
        found.add_column(heading, overflow="fold", min_width=14)
    for line in summary.lines:
        found.add_row(*_cells(line))
    return found


def paired(summary: Summary) -> Table | None:
    """What differs from the reference on the same variants, one row a controller; None if alone."""
    if not summary.pairs:
        return None
    title = f"less {summary.pairs[0].reference} on the same variants, p; 95 % interval"
    found = Table(
        title=Text(one_line(title), style="bold"),
        title_justify="left",
        box=box.SIMPLE_HEAD,
        padding=(0, 1),
        show_edge=False,
    )
    names = [len(one_line(pair.controller)) for pair in summary.pairs]
    found.add_column("controller", overflow="fold", min_width=min(24, max(names)))
    for heading in ("success, points", "error, median (m, rad)", "margin, median (m, rad)"):
        found.add_column(heading, justify="right", no_wrap=True)
    for pair in summary.pairs:
        *errors, margin = pair.numbers.values()
        cells = (points(pair.success.difference), "\n".join(map(difference, errors)))
        found.add_row(Text(one_line(pair.controller), style="bold"), *cells, difference(margin))
    return found


def points(found: Difference) -> str:
    """Such as "-12.5, p 0.0003" above "-18.0 to -7.0", in per cent of the variants."""
    return _two_lines(found, lambda x: f"{100.0 * x:+.1f}")


def difference(found: Difference) -> str:
    """The same of a number."""
    return _two_lines(found, lambda x: f"{x:+.2g}")


def _two_lines(found: Difference, said: Callable[[float], str]) -> str:
    """A dash where there is none."""
    if not found.of:
        return "-"
    return f"{said(found.value)}, {found.chance}\n{said(found.low)} to {said(found.high)}"


def _cells(line: Line) -> Iterator[Text]:
    yield Text(one_line(line.controller), style="bold")
    yield Text(", ".join(f"{line.states.get(s, 0):,}" for s in ("done", "invalid", "failed")))
    yield Text(line.success.percent(1))
    yield Text(f"{100.0 * line.reached.count / line.reached.of:.1f}" if line.reached.of else "-")
    yield Text("\n".join(f"{_number(a)} {_number(b)}" for a, b in line.errors.values()))
    yield from (Text(named(counts)) for counts in (line.blocked_by, line.broken))


def sentences(summary: Summary) -> Iterator[str]:
    """Why rows are not done, the most frequent reasons first."""
    reasons = summary.reasons.items()
    for reason, count in list(reasons)[:MOST_REASONS]:
        yield f"{count:,} rows: {reason}"
    if len(reasons) > MOST_REASONS:
        yield f"and {len(reasons) - MOST_REASONS} other reasons"


def as_json(name: str, summary: Summary) -> dict[str, Any]:
    """The same for machines."""
    return {"study": name, **asdict(summary)}


def named(counts: Mapping[str, int]) -> str:
    """The most frequent names with their counts, one a line."""
    shown = [one_line(f"{name} {count:,}") for name, count in list(counts.items())[:MOST_NAMES]]
    more = len(counts) - MOST_NAMES
    return "\n".join([*shown, *([f"and {more} more"] if more > 0 else [])])


def _number(value: float) -> str:
    return "-" if math.isnan(value) else f"{value:.2g}"
