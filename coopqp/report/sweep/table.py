"""A study in the terminal: how far it is, and its results; fits 100 columns."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from typing import Any

import click
from rich import box
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn
from rich.table import Table
from rich.text import Text

from coopqp.base.errors import one_line
from coopqp.study.sweep.paired import Difference
from coopqp.study.sweep.study import Study
from coopqp.study.sweep.summary import ERROR, Line, Summary
from coopqp.study.sweep.sweep import Progress as State

MOST_NAMES, MOST_REASONS = 3, 5
EVERY = 30.0  # s between two lines


def table(name: str, summary: Summary) -> Table:
    """One row a controller."""
    lines = [line.controller for line in summary.lines]
    success = "success\n%" if summary.exact else "success\n%, 95 % interval"
    found = _framed(
        f"{name}: {summary.rows:,} rows",
        lines,
        ("done,\ninvalid,\nfailed", success, "reached\n%", "error, median\n95 % (m, rad)"),
    )  # fmt: skip
    for heading in ("blocked by,\nhow often", "broken,\nhow often"):
        found.add_column(heading, overflow="fold", min_width=14)
    for line in summary.lines:
        found.add_row(*_cells(line, exact=summary.exact))
    return found


def paired(summary: Summary) -> Table | None:
    """What differs from the reference on the same variants, one row a controller; None if alone."""
    if not summary.pairs:
        return None
    exact, tested = summary.exact, "" if summary.exact else ", p; 95 % interval"
    found = _framed(
        f"less {summary.pairs[0].reference} on the same variants{tested}",
        [pair.controller for pair in summary.pairs],
        ("success, points", "error, median (m, rad)", "margin, median (m, rad)"),
    )
    for pair in summary.pairs:
        *errors, margin = pair.numbers.values()
        told = [difference(error, exact=exact) for error in errors]
        said = map(_of_task, pair.numbers, told)
        found.add_row(
            Text(one_line(pair.controller), style="bold"),
            points(pair.success.difference, exact=exact),
            Text("\n".join(said)),
            difference(margin, exact=exact),
        )
    return found


def _framed(title: str, controllers: Sequence[str], headings: Sequence[str]) -> Table:
    """A table with a column of controllers and some of numbers."""
    found = Table(
        title=Text(one_line(title), style="bold"), title_justify="left", box=box.SIMPLE_HEAD,
        padding=(0, 1), show_edge=False,
    )  # fmt: skip
    longest = max((len(one_line(name)) for name in controllers), default=0)
    found.add_column("controller", overflow="fold", min_width=min(24, longest))
    for heading in headings:
        found.add_column(heading, justify="right", no_wrap=True)
    return found


def points(found: Difference, *, exact: bool) -> str:
    """Such as "-12.5, p 0.0003" above "-18.0 to -7.0", in per cent of the variants.

    Where nothing was drawn the first number alone.
    """
    return _two_lines(found, lambda x: f"{100.0 * x:+.1f}", exact=exact)


def difference(found: Difference, *, exact: bool) -> str:
    """The same of a number."""
    return _two_lines(found, lambda x: f"{x:+.2g}", exact=exact)


def _of_task(column: str, said: str) -> str:
    """With the task's name, from that of its column of errors."""
    return f"{one_line(column.removeprefix(ERROR))} {said}"


def _two_lines(found: Difference, said: Callable[[float], str], *, exact: bool) -> str:
    """A dash where there is none."""
    if not found.of:
        return "-"
    if exact:
        return said(found.value)
    return f"{said(found.value)}, {found.chance}\n{said(found.low)} to {said(found.high)}"


def _cells(line: Line, *, exact: bool) -> Iterator[Text]:
    yield Text(one_line(line.controller), style="bold")
    yield Text(", ".join(f"{line.states.get(s, 0):,}" for s in ("done", "invalid", "failed")))
    yield Text(line.success.percent(1, exact=exact))
    yield Text(f"{100.0 * line.reached.count / line.reached.of:.1f}" if line.reached.of else "-")
    errors = line.errors.items()
    yield Text("\n".join(_of_task(of, f"{_number(a)} {_number(b)}") for of, (a, b) in errors))
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


@contextmanager
def shown(study: Study) -> Iterator[Callable[[State], None]]:
    """A function that is told of each batch."""
    errors = Console(stderr=True)
    if not errors.is_terminal:
        yield _Lines(study).tell
        return
    columns = (TextColumn("{task.description}"), BarColumn(), TextColumn("{task.fields[said]}"))
    with Progress(*columns, console=errors, transient=True) as bars:
        bar = bars.add_task(study.name, total=None, said="begins")

        def tell(state: State) -> None:
            bars.update(bar, total=state.total, completed=state.done, said=words(state))

        yield tell


class _Lines:
    """A line now and then."""

    def __init__(self, study: Study) -> None:
        self._name, self._next = study.name, time.monotonic() + EVERY

    def tell(self, state: State) -> None:
        """Say how far it is if it is time."""
        if time.monotonic() >= self._next:
            self._next = time.monotonic() + EVERY
            click.echo(f"{self._name}: {words(state)}", err=True)


def words(state: State) -> str:
    """Such as "120/2,048 variants, 35.2 a second, 1 min left, 3 rows invalid, 0 failed"."""
    left = f"{span(state.left)} left" if math.isfinite(state.left) else "time left unknown"
    return (
        f"{state.done:,}/{state.total:,} variants, {state.rate:.3g} a second, {left}, "
        f"{state.states['invalid']:,} rows invalid, {state.states['failed']:,} failed"
    )


def span(seconds: float) -> str:
    """A time for people."""
    if seconds < 100.0:
        return f"{seconds:.0f} s"
    return f"{seconds / 60.0:.0f} min" if seconds < 6000.0 else f"{seconds / 3600.0:.1f} h"
