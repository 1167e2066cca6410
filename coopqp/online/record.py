"""What the loop hands its ticks to, for a recording that grows while it runs."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from coopqp.checked import Array
from coopqp.controller import Command
from coopqp.state import State


class Record(Protocol):
    """Takes down ticks; raises nothing and waits for nothing."""

    def tick(
        self, state: State, command: Command, us: float, also: Array | Sequence[float] = ()
    ) -> None:
        """Take down a tick.

        Args:
            state: as the tick left it, before it goes on.
            command: of the tick.
            us: how long it took [us].
            also: further numbers.
        """

    def begin(self, state: State, since: float = 0.0) -> None:
        """Say that the loop goes on from another state than the last tick's, as after a stop.

        Args:
            state: before its first tick.
            since: when its own time began, as in a later phase [s].
        """

    def close(self) -> None:
        """Write the rest and the end."""
