"""Tables for the terminal: comparisons, replayed ticks."""

from __future__ import annotations

from collections.abc import Mapping

from rich import box
from rich.table import Table
from rich.text import Text

from coopqp.comparison import Comparison
from coopqp.errors import one_line
from coopqp.report.cells import Cell, cells
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
