"""A line of help for everything that a scenario can name."""

from __future__ import annotations

from coopqp.scenario.catalog import Catalog
from coopqp.scenario.loader import shipped
from coopqp.scenario.yaml import read_yaml
from coopqp.solvers.qpsolvers import installed


def help_lines(kind: str, catalog: Catalog) -> dict[str, str]:
    """A line of help for each name of a collection.

    Args:
        kind: "scenarios", or a collection of plug-ins.
        catalog: with the plug-ins.
    """
    if kind == "scenarios":
        return {
            name: read_yaml(path).data.get("description", "") for name, path in shipped().items()
        }
    lines = {name: entry.help for name, entry in catalog.entries(kind).items()}
    if kind == "solvers":
        others = (name for name in installed() if name not in lines)
        lines.update(dict.fromkeys(others, "Backend of qpsolvers, one cold call a tick."))
    return lines
