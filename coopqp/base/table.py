"""Tables of numbers in files of users: CSV, or Parquet, with named columns."""

import csv
import functools
import io
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from coopqp.base.errors import InvalidValueError, needs
from coopqp.base.reading import read_bytes, read_text, version
from coopqp.base.spec import Array

#: Bytes that a table may have: an hour at 500 Hz with ten columns.
MAX_BYTES = 256 << 20


@dataclass(frozen=True)
class Table:
    """Columns of numbers by name, NaN in empty cells; ``first_line`` of the rows, 0 if without."""

    path: Path
    columns: dict[str, Array]
    first_line: int

    def place(self, row: int) -> str:
        """File and line of a row."""
        return f"{self.path}:{self.first_line + row}" if self.first_line else f"{self.path}: {row}"

    def take(self, names: Sequence[str]) -> Array:
        """Columns side by side, (rows, names); InvalidValueError if one, or a cell, is missing."""
        for name in names:
            if name not in self.columns:
                there = ", ".join(self.columns)
                words = f"has no column '{name}'; its columns are {there}"
                raise InvalidValueError(f"{self.path}: {words}")
        found = np.array([self.columns[name] for name in names]).T
        wrong = np.argwhere(~np.isfinite(found))
        if len(wrong):
            row, column = wrong[0].tolist()
            raise InvalidValueError(f"{self.place(row)}: {names[column]}: needs a finite number")
        return found

    def times(self, name: str = "t") -> Array:
        """A column [s], shape (rows,); InvalidValueError where it is missing or does not rise."""
        t: Array = self.take([name])[:, 0]
        back = np.flatnonzero(np.diff(t) <= 0.0)
        if len(back):
            k = int(back[0]) + 1
            words = f"found {t[k]:g} s after {t[k - 1]:g} s; times need to rise from row to row"
            raise InvalidValueError(f"{self.place(k)}: {name}: {words}")
        return t


def read_table(path: str | Path) -> Table:
    """Numbers from a ``.parquet`` file, or CSV with names in its first line; or a CoopqpError."""
    return _read(*version(Path(path)))


def csv_text(columns: dict[str, Array], digits: int = 12) -> str:
    """Columns by name as CSV; 17 digits hold every number to the last bit."""
    number = f"{{:.{digits}g}}".format
    rows = (map(number, row) for row in zip(*columns.values(), strict=True))
    return "\n".join(map(",".join, [columns, *rows])) + "\n"


@functools.lru_cache(maxsize=16)
def _read(path: Path, changed: int, size: int) -> Table:
    return _parquet(path) if path.suffix == ".parquet" else _csv(path)


def _csv(path: Path) -> Table:
    reader = csv.reader(io.StringIO(read_text(path, MAX_BYTES)), strict=True)
    try:
        names = [name.strip() for name in next(reader, [])]
        if len(set(names)) < len(names) or not all(names):
            raise InvalidValueError(f"{path}:1: needs a name for each column, each name once")
        if other := next((c for c in ";\t|" if len(names) == 1 and c in names[0]), None):
            words = f"its columns are separated by {other!r}, needs commas"
            raise InvalidValueError(f"{path}:1: {words}")
        rows = []
        for cells in reader:
            place = f"{path}:{reader.line_num}"
            if not cells:
                raise InvalidValueError(f"{place}: is a blank line; leave it out")
            if len(cells) != len(names):
                words = f"found {len(cells)} cells, needs {len(names)}: {', '.join(names)}"
                raise InvalidValueError(f"{place}: {words}")
            rows.append([_number(place, *pair) for pair in zip(names, cells, strict=True)])
    except csv.Error as error:
        raise InvalidValueError(f"{path}:{reader.line_num}: is not CSV: {error}") from None
    return _table(path, names, np.array(rows, float), 2)


def _number(place: str, name: str, cell: str) -> float:
    if not cell.strip():
        return math.nan
    try:
        return float(cell)
    except ValueError:
        raise InvalidValueError(f"{place}: {name}: found '{cell[:40]}', needs a number") from None


def _parquet(path: Path) -> Table:
    with needs("a Parquet file", "recordings"):
        import pyarrow as arrow
        from pyarrow import parquet
    content = read_bytes(path, MAX_BYTES)
    try:
        read = parquet.read_table(arrow.BufferReader(content))
        columns = [np.asarray(read[name].to_numpy(), float) for name in read.column_names]
    except (arrow.ArrowException, TypeError, ValueError) as error:
        words = " ".join(str(error).split())
        raise InvalidValueError(f"{path}: is not a Parquet file of numbers: {words}") from None
    return _table(path, read.column_names, np.array(columns, float).T, 0)


def _table(path: Path, names: Sequence[str], rows: Array, first_line: int) -> Table:
    if not len(rows):
        raise InvalidValueError(f"{path}: has no rows below the names of its columns")
    columns = {name: np.ascontiguousarray(rows[:, i]) for i, name in enumerate(names)}
    return Table(path, columns, first_line)
