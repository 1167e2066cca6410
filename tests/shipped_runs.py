"""Shipped scenarios compared as their files have it, each once a process."""

from __future__ import annotations

from functools import cache

import coopqp
from coopqp.execution.comparison import Comparison
from coopqp.scenario.loader import load


@cache
def comparison(name: str) -> Comparison:
    """All laws of a scenario; to be read only."""
    return coopqp.compare(load(name))
