"""What commands print: comparisons, replayed ticks, explanations."""

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict

from rich import box
from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Column, Table
from rich.text import Text

from coopqp.base.errors import one_line
from coopqp.execution.comparison import Comparison
from coopqp.report import strict_json
from coopqp.report.cells import SYMBOLS, Cell, cells
from coopqp.scenario.catalog import Catalog
from coopqp.scenario.loader import FILES, shipped
from coopqp.scenario.yaml import read_yaml
from coopqp.solvers.qpsolvers import installed
from coopqp.study.explanation import RunExplanation, explain
from coopqp.study.tick_record import Replay, TickRecord


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
    names = Column(style="bold", no_wrap=True)
    out = Table(names, Column(), box=None, show_header=False, pad_edge=False)
    for kind, lines in collections.items():
        out.add_row(f"{kind}:", "")
        for name, text in lines.items():
            out.add_row(f"  {name}", escape(text))
    return out


#: Headings of what is shown, narrow enough to leave half of 100 columns to the verdicts.
SHOWN = {
    "reached": "goal\nreached",
    "limit": "beyond\nlimit",
    "loop": "loop\nerror",
    "failed": "failed\nticks",
    "tick": "tick\n[µs]",
}
COLORS = {None: "", True: "red", False: "green"}


def summary(comparison: Comparison) -> Table:
    """One row a controller; fits 100 columns."""
    # A Text shows what it is given; a plain string would read [brackets] in names as markup.
    title = Text(one_line(comparison.scenario.name), style="bold")
    table = Table(title=title, title_justify="left", box=box.HORIZONTALS, show_lines=True)
    table.add_column("controller and verdict", ratio=1, overflow="fold")
    for heading in SHOWN.values():
        table.add_column(Text(heading), justify="right", no_wrap=True)
    for name, trace in comparison.traces.items():
        row = cells(trace, comparison.metrics[name], comparison.traces.values())
        verdict = Text.assemble((name, "bold"), "\n", comparison.verdicts[name])
        table.add_row(verdict, *(_entry(row[key]) for key in SHOWN))
    return table


def _entry(cell: Cell) -> Text:
    return Text(SYMBOLS[cell.bad] + "\n".join(cell.lines), COLORS[cell.bad])


def replay(record: TickRecord, answers: Mapping[str, Replay]) -> Table:
    """One row a solver."""
    heads = ("solver", "status", "primal residual", "dual residual", "off the saved answer")
    table = Table(*heads, title=f"{record.scenario}, {record.controller}, tick {record.tick}")
    for name, answer in answers.items():
        numbers = (answer.primal_residual, answer.dual_residual, answer.difference)
        table.add_row(name, answer.status.value, *(f"{number:.2g}" for number in numbers))
    return table


def run_text(found: RunExplanation, name: str, *, as_json: bool) -> str:
    """Why a run missed its goal."""
    if as_json:
        return strict_json.text(found.as_json())
    of = f", phase {found.phase}" if found.phase else ""
    return f"{name}, {found.controller}{of}:\n{found.sentence}."


def tick_text(record: TickRecord, *, as_json: bool) -> str:
    """Why a tick fell short."""
    found = explain(record)
    if as_json:
        return strict_json.text({"tick": record.tick, "status": record.status, **asdict(found)})
    tick = f"tick {record.tick} ({record.status})"
    sentence = f"{found.sentence[0].upper()}{found.sentence[1:]}."
    return f"{record.scenario}, {record.controller}, {tick}:\n{sentence}"
