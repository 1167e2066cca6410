"""Reading files that strangers wrote: only plain files, only up to a size, text with its place.

Tables of numbers are CSV, or Parquet, with named columns.
"""

import csv
import functools
import io
import json
import math
import os
import stat
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, BinaryIO

import numpy as np
from pydantic import AfterValidator, BeforeValidator, ValidationInfo

from coopqp.base.errors import InvalidValueError, UnreadableFileError, needs
from coopqp.base.spec import Array

_DECODER = json.JSONDecoder()

#: Bytes that a table may have: an hour at 500 Hz with ten columns.
MAX_TABLE_BYTES = 256 << 20


def absolute(path: Path) -> Path:
    """The absolute path; circular links stay. ValueError: a name that no file can have."""
    return Path(os.path.realpath(path))


@contextmanager
def open_bytes(path: Path) -> Iterator[BinaryIO]:
    """A plain file, no pipe or device, to read from; UnreadableFileError also where that fails."""
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    except OSError as error:
        raise UnreadableFileError(path, f"cannot be read: {error.strerror}") from None
    except ValueError as error:  # a name that no file can have
        raise UnreadableFileError(repr(str(path)), f"cannot be read: {error}") from None
    try:
        _check_kind(path, os.fstat(descriptor).st_mode)
        with open(descriptor, "rb", closefd=False) as stream:
            yield stream
    except OSError as error:
        raise UnreadableFileError(path, f"cannot be read: {error.strerror}") from None
    finally:
        os.close(descriptor)


def check_plain(path: Path) -> None:
    """Raise UnreadableFileError where :func:`open_bytes` does, without opening the file."""
    try:
        _check_kind(path, path.stat().st_mode)
    except OSError as error:
        raise UnreadableFileError(path, f"cannot be read: {error.strerror}") from None


def _check_kind(path: Path, mode: int) -> None:
    if stat.S_ISDIR(mode):
        raise UnreadableFileError(path, "cannot be read: is a folder, needs a file")
    if not stat.S_ISREG(mode):
        raise UnreadableFileError(path, "cannot be read: is a pipe or a device, needs a file")


def read_bytes(path: Path, max_bytes: int) -> bytes:
    """What a file of at most so many bytes holds; UnreadableFileError as :func:`open_bytes`."""
    with open_bytes(path) as stream:
        content = stream.read(max_bytes + 1)
    if len(content) > max_bytes:
        size = f"{max_bytes >> 20} MiB" if max_bytes >= 1 << 20 else f"{max_bytes >> 10} KiB"
        words = f"is larger than {size}, the most that is read of such a file"
        raise UnreadableFileError(path, words)
    return content


def read_text(path: Path, max_bytes: int) -> str:
    """The same as text in UTF-8; UnreadableFileError with the line where it is none."""
    content = read_bytes(path, max_bytes)
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
        words = f"is not a text file in UTF-8: has the byte 0x{content[error.start]:02x}"
        raise UnreadableFileError(f"{path}:{line}", words) from None


def version(path: Path) -> tuple[Path, int, int]:
    """The file with modification time [ns] and size, for caches; zeros where it cannot be read."""
    try:
        found = path.stat()
    except (OSError, ValueError):
        return path, 0, 0
    return path, found.st_mtime_ns, found.st_size


def line_in_json(text: str, location: Sequence[str | int]) -> int:
    """The line of a value in readable JSON, or of what is nearest to it on the way there."""
    at = _skip(text, 0)
    for key in location:
        members = dict(_members(text, at))  # of a key that is there twice the last counts
        if key not in members:
            break
        at = members[key]
    return text.count("\n", 0, at) + 1


def _members(text: str, at: int) -> Iterator[tuple[str | int, int]]:
    """Key or index, and place, of what is in the mapping or list at a place."""
    if text[at] not in "{[":
        return
    mapping, index = text[at] == "{", 0
    at = _skip(text, at + 1)
    while text[at] not in "}]":
        key: str | int = index
        if mapping:
            key, at = _DECODER.raw_decode(text, at)
            at = _skip(text, at)
        yield key, at
        _, at = _DECODER.raw_decode(text, at)
        at, index = _skip(text, at), index + 1


def _skip(text: str, at: int) -> int:
    """The place of the next sign that is neither space nor between values."""
    while text[at] in " \t\n\r,:":
        at += 1
    return at


def _beside_the_scenario(path: Path, info: ValidationInfo) -> Path:
    folder = (info.context or {}).get("folder")
    return path if folder is None else absolute(folder / path)


def _path(value: Any) -> Any:
    if not isinstance(value, str | Path) or not str(value):
        raise ValueError("needs a path")
    return value


FilePath = Annotated[Path, BeforeValidator(_path), AfterValidator(_beside_the_scenario)]
"""A file or folder; in a scenario, a relative one counts from the scenario file's folder."""


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
    reader = csv.reader(io.StringIO(read_text(path, MAX_TABLE_BYTES)), strict=True)
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
    content = read_bytes(path, MAX_TABLE_BYTES)
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
