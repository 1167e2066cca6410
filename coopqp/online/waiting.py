"""What came with a tick before its time, until the next one."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from typing import Any


class Waiting:
    """A reading and inputs that wait; of several the last counts."""

    def __init__(self) -> None:
        self.forget()

    def forget(self) -> None:
        """Begin anew."""
        self._q: Any = None
        self._inputs: dict[Any, Any] = {}

    def keep(self, q: Any, inputs: Any) -> None:
        """Let them wait."""
        if q is not None:
            self._q = q
        if isinstance(inputs, Mapping):
            with suppress(Exception):  # a class of a user's may fail
                self._inputs.update(inputs)

    def take(self, q: Any, inputs: Any) -> tuple[Any, Any]:
        """What a tick is given, with what has waited for it."""
        waited, values = self._q, self._inputs
        if waited is None and not values:
            return q, inputs
        self.forget()
        if inputs is None or isinstance(inputs, Mapping):
            inputs = {**values, **(inputs or {})}
        return waited if q is None else q, inputs
