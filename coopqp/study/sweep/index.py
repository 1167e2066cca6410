"""Where in the journals each variant is, and what there is to know of all of them together.

It takes two numbers a variant, whatever the rows hold.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from coopqp.errors import CoopqpError
from coopqp.study.sweep.journal import journals, records
from coopqp.study.sweep.study import Study
from coopqp.study.sweep.variant import Row

NONE = -1


class Index:
    """What the journals of a folder hold.

    Args:
        folder: of the study.
        study: whose it is.

    Attributes:
        damaged: how many lines are not as they were written; what they said is not there.
        states: how many rows are in each state.
        columns: kind of each column that is not fixed, "bool", "int", "float" or "text", in the
            order of the first variant that has it.

    Raises:
        CoopqpError: a line is none of this study's.
    """

    def __init__(self, folder: Path, study: Study) -> None:
        self._paths, count = journals(folder), study.points.count
        self._controllers, self.damaged = len(study.controllers), 0
        self._journal = np.full(count, NONE, np.int32)
        self._offset = np.full(count, NONE, np.int64)
        self.states: Counter[str] = Counter()
        found: dict[str, tuple[int, int, str]] = {}
        for number, path in enumerate(self._paths):
            for at, record in records(path):
                if record is None:
                    self.damaged += 1
                elif self._fits(record):
                    self._take(number, at, record, found)
                else:
                    words = f"holds a line that is none of this study's, at byte {at}"
                    raise CoopqpError(f"'{path}' {words}; remove the line, or the folder")
        ordered = sorted(found.items(), key=lambda item: item[1][:2])
        self.columns = {name: kind or "float" for name, (_, _, kind) in ordered}

    def _fits(self, record: dict[str, Any]) -> bool:
        variant, rows = record.get("variant"), record.get("rows")
        if type(variant) is not int or not 0 <= variant < len(self._offset):
            return False
        return isinstance(rows, list) and len(rows) == self._controllers

    def _take(
        self, number: int, at: int, record: dict[str, Any], found: dict[str, tuple[int, int, str]]
    ) -> None:
        variant, rows = record["variant"], record["rows"]
        if self._offset[variant] != NONE:
            return  # two shares did the same; they have found the same
        self._journal[variant], self._offset[variant] = number, at
        self.states.update(row["state"] for row in rows)
        for row in rows:
            for position, (name, value) in enumerate(row.items()):
                first, place, kind = found.get(name, (variant, position, ""))
                where = min((first, place), (variant, position))
                found[name] = (*where, wider(kind, kind_of(value)))

    @property
    def done(self) -> int:
        """Number of variants."""
        return int((self._offset != NONE).sum())

    def missing(self, among: Sequence[int]) -> np.ndarray[Any, np.dtype[np.int64]]:
        """Those of some variants that are not there."""
        asked = np.asarray(among, dtype=np.int64)
        found: np.ndarray[Any, np.dtype[np.int64]] = asked[self._offset[asked] == NONE]
        return found

    def rows(self) -> Iterator[tuple[int, list[Row]]]:
        """Each variant that is there, in order, with its rows."""
        with ExitStack() as stack:
            streams: list[BinaryIO] = [stack.enter_context(open(p, "rb")) for p in self._paths]
            for variant in np.flatnonzero(self._offset != NONE).tolist():
                stream = streams[self._journal[variant]]
                stream.seek(int(self._offset[variant]))
                yield variant, json.loads(stream.readline())["rows"]


def kind_of(value: Any) -> str:
    """What a column must be to hold a value; empty for None."""
    if (known := PLAIN.get(type(value))) is not None:
        return known
    for kind, cls in KINDS.items():
        if isinstance(value, cls):
            return kind
    return "" if value is None else "text"


def wider(one: str, other: str) -> str:
    """What a column must be to hold both."""
    if not one or not other or one == other:
        return one or other
    return "float" if {one, other} == {"int", "float"} else "text"


KINDS: dict[str, type] = {"bool": bool, "int": int, "float": float, "text": str}
#: The same of the types themselves, which most values have.
PLAIN: dict[type, str] = {**{cls: kind for kind, cls in KINDS.items()}, type(None): ""}
