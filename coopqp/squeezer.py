"""Who presses by measured forces, as a law sees it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol

from coopqp.checked import Array
from coopqp.solver import Status
from coopqp.state import State


class Squeezer(Protocol):
    """Who decides about the gap along one direction, because hands press there."""

    along: Array
    """That direction among all loops, a unit vector, shape (6 L,)."""
    memory_sizes: Mapping[str, int]
    """What a law must remember for it, see ``State.memory``."""

    note: str
    """What else is to be said of the last tick."""

    def update(self, state: State) -> Status | None:
        """Move the gap along it; what is wrong with the force, None if nothing is."""
