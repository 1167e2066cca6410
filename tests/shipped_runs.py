"""Shipped scenarios compared as their files have it, or their first ticks, each once a process."""

from __future__ import annotations

from functools import cache

from scenario_files import cut

import coopqp
from coopqp.execution.comparison import Comparison
from coopqp.scenario.loader import load


@cache
def comparison(name: str) -> Comparison:
    """All laws of a scenario; to be read only."""
    return coopqp.compare(load(name))


@cache
def beginning(name: str) -> Comparison:
    """Ten ticks of every phase under all laws of a scenario; to be read only."""
    return coopqp.compare(cut(load(name), 10))
