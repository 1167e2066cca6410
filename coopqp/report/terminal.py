"""What the commands print to: a console, progress bars where somebody looks; names with help."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager

from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

from coopqp.scenario.catalog import Catalog
from coopqp.scenario.loader import FILES, shipped
from coopqp.scenario.yaml import read_yaml
from coopqp.solvers.qpsolvers import installed


def console() -> Console:
    """A rich console; without a terminal it keeps a width that tables fit in."""
    found = Console()
    return found if found.is_terminal else Console(width=120)


@contextmanager
def progress_bars(names: list[str], ticks: int) -> Iterator[Callable[[str, float], None] | None]:
    """A progress bar per controller on a terminal, nothing elsewhere."""
    errors = Console(stderr=True)
    if not errors.is_terminal:
        yield None
        return
    columns = (TextColumn("{task.description}"), BarColumn(), TimeRemainingColumn())
    with Progress(*columns, console=errors, transient=True) as progress:
        bars = {name: progress.add_task(name, total=ticks) for name in names}
        yield lambda name, done: progress.update(bars[name], completed=done)


def help_lines(kind: str, catalog: Catalog) -> dict[str, str]:
    """A line of help for each name of a collection."""
    if kind in FILES:
        files = shipped(kind).items()
        return {name: read_yaml(path).data.get("description", "") for name, path in files}
    lines = {name: e.help for name, e in catalog.entries(kind).items()}
    if kind == "solvers":
        others = (name for name in installed() if name not in lines)
        lines.update(dict.fromkeys(others, "Backend of qpsolvers, one cold call a tick."))
    return lines


def names_table(collections: Mapping[str, Mapping[str, str]]) -> Table:
    """All names by collection."""
    out = Table(box=None, show_header=False, pad_edge=False)
    out.add_column(style="bold", no_wrap=True)
    out.add_column()
    for kind, lines in collections.items():
        out.add_row(f"{kind}:", "")
        for name, text in lines.items():
            out.add_row(f"  {name}", escape(text))
    return out
