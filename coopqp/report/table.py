"""What commands print: comparisons, replayed ticks, explanations."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict

from rich import box
from rich.table import Table
from rich.text import Text

from coopqp.base.errors import one_line
from coopqp.execution.comparison import Comparison
from coopqp.report import strict_json
from coopqp.report.cells import Cell, cells
from coopqp.study.explanation import RunExplanation, explain
from coopqp.study.tick_record import Replay, TickRecord

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
    table = Table(
        title=Text(one_line(comparison.scenario.name), style="bold"),
        title_justify="left",
        box=box.HORIZONTALS,
        show_lines=True,
    )
    table.add_column("controller and verdict", ratio=1, overflow="fold")
    for heading in SHOWN.values():
        table.add_column(Text(heading), justify="right", no_wrap=True)
    for name, trace in comparison.traces.items():
        row = cells(trace, comparison.metrics[name])
        said = Text.assemble((name, "bold"), "\n", comparison.verdicts[name])
        table.add_row(said, *(_entry(row[key]) for key in SHOWN))
    return table


def _entry(cell: Cell) -> Text:
    first, *more = cell.lines
    return Text("\n".join([f"{cell.symbol} {first}".strip(), *more]), COLORS[cell.bad])


def replay(record: TickRecord, answers: Mapping[str, Replay]) -> Table:
    """One row a solver."""
    table = Table(title=f"{record.scenario}, {record.controller}, tick {record.tick}")
    for heading in ("solver", "status", "primal residual", "dual residual", "off the saved answer"):
        table.add_column(heading)
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
    said = f"{found.sentence[0].upper()}{found.sentence[1:]}."
    return f"{record.scenario}, {record.controller}, tick {record.tick} ({record.status}):\n{said}"
