"""A study in the terminal: its progress and its results; fits 100 columns."""

import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager

import click
from rich import box
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn
from rich.table import Table
from rich.text import Text

from coopqp.base.errors import one_line
from coopqp.study.sweep.study import Study
from coopqp.study.sweep.summary import ERROR, Difference, Line, Pair, Summary
from coopqp.study.sweep.sweep import Progress as State

MAX_NAMES, MAX_REASONS = 3, 5
EVERY = 30.0  # s between two lines


def table(name: str, summary: Summary) -> Table:
    """One row a controller."""
    success = "success\n%" if summary.exact else "success\n%, 95 % interval"
    headings = ("done,\ninvalid,\nfailed", success, "reached\n%", "error, median\n95 % (m, rad)")
    out = _framed(f"{name}: {summary.rows:,} rows", summary.lines, headings)
    for heading in ("blocked by,\nhow often", "broken,\nhow often"):
        out.add_column(heading, overflow="fold", min_width=14)
    for line in summary.lines:
        out.add_row(*_cells(line, exact=summary.exact))
    return out


def paired(summary: Summary) -> Table | None:
    """What differs from the reference on the same variants, one row a controller; None if alone."""
    if not summary.pairs:
        return None
    exact, tested = summary.exact, "" if summary.exact else ", p; 95 % interval"
    title = f"less {summary.pairs[0].reference} on the same variants{tested}"
    headings = ("success, points", "error, median (m, rad)", "margin, median (m, rad)")
    out = _framed(title, summary.pairs, headings)
    for pair in summary.pairs:
        *errors, margin = (difference(each, exact=exact) for each in pair.numbers.values())
        share = points(pair.success.difference, exact=exact)
        of_tasks = Text("\n".join(map(_of_task, pair.numbers, errors)))
        out.add_row(Text(one_line(pair.controller), style="bold"), share, of_tasks, margin)
    return out


def _framed(title: str, rows: Sequence[Line | Pair], headings: Sequence[str]) -> Table:
    out = Table(
        title=Text(one_line(title), style="bold"), title_justify="left", box=box.SIMPLE_HEAD,
        padding=(0, 1), show_edge=False,
    )  # fmt: skip
    longest = max((len(one_line(row.controller)) for row in rows), default=0)
    out.add_column("controller", overflow="fold", min_width=min(24, longest))
    for heading in headings:
        out.add_column(heading, justify="right", no_wrap=True)
    return out


def points(of: Difference, *, exact: bool) -> str:
    """Such as "-12.5, p 0.0003" above "-18.0 to -7.0", in per cent of the variants.

    Where nothing was drawn the first number alone.
    """
    return difference(of, exact=exact, factor=100.0, form="+.1f")


def difference(of: Difference, *, exact: bool, factor: float = 1.0, form: str = "+.2g") -> str:
    """The same of a number; a dash where there is none."""
    if not of.of:
        return "-"
    value, low, high = (format(factor * x, form) for x in (of.value, of.low, of.high))
    return value if exact else f"{value}, {of.chance}\n{low} to {high}"


def _of_task(column: str, words: str) -> str:
    """With the task's name, from that of its column of errors."""
    return f"{one_line(column.removeprefix(ERROR))} {words}"


def _cells(line: Line, *, exact: bool) -> Iterator[Text]:
    yield Text(one_line(line.controller), style="bold")
    yield Text(", ".join(f"{line.states.get(s, 0):,}" for s in ("done", "invalid", "failed")))
    yield Text(line.success.percent(1, exact=exact))
    yield Text(line.reached.percent(1, exact=True))
    errors = line.errors.items()
    yield Text("\n".join(_of_task(of, f"{_number(a)} {_number(b)}") for of, (a, b) in errors))
    yield from (Text(named(counts)) for counts in (line.blocked_by, line.broken))


def sentences(summary: Summary) -> Iterator[str]:
    """Why rows are not done, the most frequent reasons first."""
    reasons = summary.reasons.items()
    for reason, count in list(reasons)[:MAX_REASONS]:
        yield f"{count:,} {'row' if count == 1 else 'rows'}: {reason}"
    if len(reasons) > MAX_REASONS:
        yield f"and {len(reasons) - MAX_REASONS} other reasons"


def named(counts: Mapping[str, int]) -> str:
    """The most frequent names with their counts, one a line."""
    shown = [one_line(f"{name} {count:,}") for name, count in list(counts.items())[:MAX_NAMES]]
    more = len(counts) - MAX_NAMES
    return "\n".join([*shown, *([f"and {more} more"] if more > 0 else [])])


def _number(value: float) -> str:
    return "-" if math.isnan(value) else f"{value:.2g}"


@contextmanager
def shown(study: Study) -> Iterator[Callable[[State], None]]:
    """A function to call after each batch: a bar on a terminal, elsewhere a line now and then."""
    errors, due = Console(stderr=True), time.monotonic() + EVERY

    def print_line(state: State) -> None:
        nonlocal due
        if time.monotonic() >= due:
            due = time.monotonic() + EVERY
            click.echo(f"{study.name}: {words(state)}", err=True)

    if not errors.is_terminal:
        yield print_line
        return
    columns = (TextColumn("{task.description}"), BarColumn(), TextColumn("{task.fields[words]}"))
    with Progress(*columns, console=errors, transient=True) as bars:
        bar = bars.add_task(study.name, total=None, words="begins")
        yield lambda s: bars.update(bar, total=s.total, completed=s.done, words=words(s))


def words(state: State) -> str:
    """Such as "120/2,048 variants, 35.2 a second, 1 min left, 3 rows invalid, 0 failed"."""
    left = f"{span(state.left)} left" if math.isfinite(state.left) else "time left unknown"
    rows = f"{state.states['invalid']:,} rows invalid, {state.states['failed']:,} failed"
    return f"{state.done:,}/{state.total:,} variants, {state.rate:.3g} a second, {left}, {rows}"


def span(seconds: float) -> str:
    """A time for people."""
    if seconds < 100.0:
        return f"{seconds:.0f} s"
    return f"{seconds / 60.0:.0f} min" if seconds < 6000.0 else f"{seconds / 3600.0:.1f} h"
