"""Plug-ins of a collection as they are without settings, or with those of an example."""

from __future__ import annotations

from typing import Any

from coopqp.base.errors import CoopqpError
from coopqp.scenario.catalog import Catalog


def examples(kind: str, **settings: dict[str, Any]) -> dict[str, Any]:
    """One of each by name; what needs settings and has none here is named in test_contracts."""
    made = {}
    for name, entry in Catalog().entries(kind).items():
        try:
            made[name] = entry.cls(**settings.get(name, {}))
        except (CoopqpError, ValueError):
            continue
    return made
