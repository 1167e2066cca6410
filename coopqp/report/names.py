"""What scenarios can name, with a line of help each."""

from __future__ import annotations

from collections.abc import Mapping

from rich.markup import escape
from rich.table import Table

from coopqp.scenario.catalog import Catalog
from coopqp.scenario.loader import shipped
from coopqp.scenario.yaml import read_yaml
from coopqp.solvers.qpsolvers import installed


def help_lines(kind: str, catalog: Catalog) -> dict[str, str]:
    """A line of help for each name of a collection."""
    if kind == "scenarios":
        return {
            name: read_yaml(path).data.get("description", "") for name, path in shipped().items()
        }
    lines = {name: e.help for name, e in catalog.entries(kind).items()}
    if kind == "solvers":
        others = (name for name in installed() if name not in lines)
        lines.update(dict.fromkeys(others, "Backend of qpsolvers, one cold call a tick."))
    return lines


def table(collections: Mapping[str, Mapping[str, str]]) -> Table:
    """All names by collection."""
    out = Table(box=None, show_header=False, pad_edge=False)
    out.add_column(style="bold", no_wrap=True)
    out.add_column()
    for kind, lines in collections.items():
        out.add_row(f"{kind}:", "")
        for name, text in lines.items():
            out.add_row(f"  {name}", escape(text))
    return out
