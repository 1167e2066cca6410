"""The summary for the terminal."""

from __future__ import annotations

from rich.table import Table
from rich.text import Text

from coopqp.comparison import Comparison
from coopqp.report.cells import COLUMNS, Cell, cells

SHOWN = ("reached", "limit", "loop", "failed", "tick")


def summary(comparison: Comparison) -> Table:
    """One row a controller; fits 100 columns."""
    # A Text shows what it is given; a plain string would read [brackets] in names as markup.
    table = Table(title=Text(comparison.scenario.name), title_justify="left", show_lines=True)
    table.add_column("controller", max_width=16, overflow="fold")
    table.add_column("verdict", ratio=1, min_width=24)
    for key in SHOWN:
        column = COLUMNS[key]
        heading = f"{column.heading.lower()} [{column.unit}]" if column.unit else column.heading.lower()
        table.add_column(Text(heading), justify="right", max_width=12)
    for name, trace in comparison.traces.items():
        row = cells(trace, comparison.metrics[name])
        table.add_row(
            Text(name, style="bold" if trace.solver else ""),
            Text(comparison.verdicts[name]),
            *(_entry(row[key]) for key in SHOWN),
        )
    return table


def _entry(cell: Cell) -> Text:
    color = {None: "", True: "red", False: "green"}[cell.bad]
    entry = Text("\n".join(cell.lines))
    if cell.symbol:
        entry = Text.assemble((f"{cell.symbol} ", color), entry)
    return entry
