"""What arrived at the inputs of a run, as files from which a scenario feeds them again.

    inputs/NAME.csv      t: of the tick for which it arrived; sent: when; the columns of its kind

Both what the page and what a loop for a robot write is of this form.
"""

from __future__ import annotations

import re
from array import array
from collections.abc import Collection, Iterable, Mapping
from typing import Any

from coopqp.signal import Kind

FOLDER = "inputs"


class Sent:
    """What arrived at one input, row by row."""

    def __init__(self, kind: Kind) -> None:
        self._columns = ("t", "sent", *kind.columns)
        self._rows = array("d")

    @property
    def header(self) -> str:
        """The names of the columns, as a line."""
        return ",".join(self._columns) + "\n"

    def add(self, t: float, sent: float, value: Iterable[float]) -> None:
        """Keep what arrived for the tick at t and when it was sent [s]; for one tick the last."""
        width = len(self._columns)
        if self._rows and self._rows[-width] == t:
            del self._rows[-width:]
        self._rows.extend((t, sent, *value))

    def lines(self) -> str:
        """All rows that are kept, as lines."""
        return self._text(0, len(self._rows))

    def take(self, before: float) -> str:
        """The rows before a time [s], as lines; they are kept no longer."""
        width, end = len(self._columns), 0
        while end < len(self._rows) and self._rows[end] < before:
            end += width
        text = self._text(0, end)
        del self._rows[:end]
        return text

    def _text(self, start: int, stop: int) -> str:
        width = len(self._columns)
        rows = (self._rows[i : i + width] for i in range(start, stop, width))
        return "".join(",".join(map(repr, row)) + "\n" for row in rows)


def file_name(name: str, taken: Collection[str]) -> str:
    """What an input's file is called, as ``hand.csv``."""
    plain = re.sub(r"[^\w-]+", "_", name) or "_"
    while f"{plain}.csv" in taken:
        plain += "_"
    return f"{plain}.csv"


def fed(inputs: Mapping[str, Any], feeds: Mapping[str, str]) -> dict[str, Any]:
    """The ``inputs`` of a scenario file, fed from files."""
    found = {}
    for name, given in inputs.items():
        keys = {k: v for k, v in (given or {}).items() if k not in ("feed", "feed_file")}
        found[name] = keys | ({"feed_file": feeds[name]} if name in feeds else {})
    return found
