"""The results of a study: from the journals to one Parquet file, and its columns.

The file has a row for each variant and controller, in order. It is read a column at a time, so that
few of them are in memory.
"""

from __future__ import annotations

import fcntl
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property, reduce
from heapq import merge
from itertools import islice
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import coopqp
from coopqp.base.errors import CoopqpError, MissingDependencyError
from coopqp.base.spec import Array
from coopqp.study.sweep.journal import journals, records
from coopqp.study.sweep.study import Row, Study, Varied

NAME = "results.parquet"
LOCK = ".results.lock"
GROUP = 20_000  # rows
#: Columns of every study, before those of what is varied, and after them.
FIRST = {"row": "int", "variant": "int", "controller": "text", "state": "text", "reason": "text"}
LAST = {"success": "bool", "blocked_by": "text", "broken": "text"}
OWN_SEED = "variant_seed"

KINDS = {bool: "bool", int: "int", float: "float", type(None): ""}


class Index:
    """What the journals of a folder hold; a bit a variant, whatever the rows hold.

    Attributes:
        damaged: how many records are not as they were written; what they said is not there.
        columns: kind of each column of rows, "bool", "int", "float" or "text", as they come.
    """

    def __init__(self, folder: Path, study: Study) -> None:
        self._paths, self._controllers = journals(folder), len(study.controllers)
        self._there = np.zeros(study.points.count, bool)
        self.damaged = 0
        kinds: dict[str, str] = {}
        for variant, rows in self._records():
            if rows is None:
                self.damaged += 1
                continue
            self._there[variant] = True
            for name, value in (item for row in rows for item in row.items()):
                kinds[name] = wider(kinds.get(name, ""), kind_of(value))
        self.columns = {name: kind or "float" for name, kind in kinds.items()}

    def _records(self) -> Iterator[tuple[int, list[Row] | None]]:
        """Each variant once, in order, with its rows; what is damaged besides, with None."""
        last = -1  # two shares may have done the same, and have found the same
        for variant, path, record in merge(*map(_by_variant, self._paths), key=itemgetter(0)):
            if record is None:
                yield variant, None
            elif not self._fits(variant, record):
                words = f"holds a record that is none of this study's, number {variant}"
                raise CoopqpError(f"'{path}' {words}; remove the record, or the folder")
            elif variant > last:
                last = variant
                yield variant, record["rows"]

    def _fits(self, variant: int, record: dict[str, Any]) -> bool:
        rows = record.get("rows")
        known = variant < len(self._there) and record.get("variant") == variant
        return known and isinstance(rows, list) and len(rows) == self._controllers

    @property
    def done(self) -> int:
        """Number of variants."""
        return int(self._there.sum())

    def missing(self, among: Sequence[int]) -> NDArray[np.int64]:
        """Those of some variants that are not there."""
        asked = np.asarray(among, dtype=np.int64)
        return asked[~self._there[asked]]

    def rows(self) -> Iterator[tuple[int, list[Row]]]:
        """Each variant that is there, in order, with its rows."""
        found = ((variant, rows) for variant, rows in self._records() if rows is not None)
        return (one for one in found if self._there[one[0]])


def _by_variant(path: Path) -> Iterator[tuple[int, Path, dict[str, Any] | None]]:
    return ((variant, path, record) for variant, record in records(path))


def kind_of(value: Any) -> str:
    """What a column must be to hold a value; empty for None. Lists are written as text."""
    return KINDS.get(type(value), "text")


def wider(one: str, other: str) -> str:
    """What a column must be to hold both."""
    if not one or not other or one == other:
        return one or other
    return "float" if {one, other} == {"int", "float"} else "text"


def needs_arrow() -> None:
    """Refuse to begin where results could not be written."""
    try:
        import pyarrow  # noqa: F401
    except ImportError:
        raise MissingDependencyError("a study", "studies") from None


def compact(study: Study, folder: Path) -> Index:
    """Write what the journals hold by now; the old file stays until the new one is whole."""
    aside = folder / f".{NAME}.{os.getpid()}"
    try:
        with _alone(folder):
            index = Index(folder, study)
            _write(study, index, aside)
            os.replace(aside, folder / NAME)
    except OSError as error:
        words = f"cannot write '{folder / NAME}': {error.strerror or error}"
        raise CoopqpError(f"{words}; the journal has all results") from None
    finally:
        aside.unlink(missing_ok=True)
    return index


@contextmanager
def _alone(folder: Path) -> Iterator[None]:
    """Wait for others, so that an older look at the journals never replaces a newer one."""
    with open(folder / LOCK, "w") as stream:
        fcntl.flock(stream, fcntl.LOCK_EX)
        yield


def _write(study: Study, index: Index, path: Path) -> None:
    import pyarrow as pa

    types = {"int": pa.int64(), "float": pa.float64(), "bool": pa.bool_(), "text": pa.string()}
    kinds = _kinds(study, index)
    kept = {
        "coopqp.version": coopqp.__version__,
        "coopqp.study": study.file.text,
        "coopqp.scenario": study.scenario_text[1],
    }
    schema = pa.schema([pa.field(name, types[kind]) for name, kind in kinds.items()], kept)
    rows = _rows(study, index, kinds)
    with _parquet().ParquetWriter(path, schema, compression="zstd") as writer:
        while group := list(islice(rows, GROUP)):
            columns = zip(zip(*group, strict=True), schema, strict=True)
            arrays = [pa.array(values, field.type) for values, field in columns]
            writer.write_batch(pa.record_batch(arrays, schema=schema))
    with open(path, "rb") as stream:
        os.fsync(stream.fileno())


def _kinds(study: Study, index: Index) -> dict[str, str]:
    varied = {name: kind for one in study.varied for name, kind in _varied_kinds(one)}
    fixed = {**FIRST, OWN_SEED: "int", **varied, **LAST}
    return {**fixed, **{k: v for k, v in index.columns.items() if k not in fixed}}


def _varied_kinds(one: Varied) -> Iterator[tuple[str, str]]:
    values = zip(*map(one.over.parts, one.over.tried()), strict=True)
    for name, column in zip(one.columns, values, strict=True):
        yield name, reduce(wider, map(kind_of, column)) or "text"


def _rows(study: Study, index: Index, kinds: dict[str, str]) -> Iterator[list[Any]]:
    rest = list(kinds)[len(FIRST) + 1 + len(study.columns) :]
    for number, rows in index.rows():
        variant = study.variant(number)
        values = [study.seed_of(variant), *study.parts(variant)]
        for k, (controller, row) in enumerate(zip(study.controllers, rows, strict=True)):
            own = [row["state"], row["reason"], *values, *map(row.get, rest)]
            place = number * len(study.controllers) + k
            found = zip([place, number, controller, *own], kinds.values(), strict=True)
            yield [str(x) if kind == "text" and x is not None else x for x, kind in found]


@dataclass(frozen=True)
class Columns:
    """Results on disk."""

    path: Path

    @classmethod
    def of(cls, folder: Path) -> Columns:
        """Those in the folder of a study."""
        if not (folder / NAME).is_file():
            raise CoopqpError(f"'{folder}' has no {NAME} yet")
        return cls(folder / NAME)

    @cached_property
    def kinds(self) -> Mapping[str, str]:
        """By name, what is in a column: "bool", "int64", "double" or "string"."""
        return {field.name: str(field.type) for field in _parquet().read_schema(self.path)}

    def __len__(self) -> int:
        return int(_parquet().read_metadata(self.path).num_rows)

    def _column(self, name: str) -> Any:
        return _parquet().read_table(self.path, columns=[name]).column(0).combine_chunks()

    def numbers(self, name: str) -> Array:
        """A column of numbers or truths, shape (rows,); NaN where there is none.

        What only rows that are done have is no column before one is.
        """
        if name not in self.kinds:
            return np.full(len(self), np.nan)
        found: Array = self._column(name).cast("double").to_numpy(zero_copy_only=False)
        return found

    def codes(self, name: str) -> tuple[NDArray[np.int64], list[str]]:
        """A column of texts: the number of each row's text, -1 for none, and the texts."""
        column = self._column(name).dictionary_encode()
        codes = column.indices.fill_null(-1).to_numpy(zero_copy_only=False)
        return codes.astype(np.int64), [str(text) for text in column.dictionary.to_pylist()]


def _parquet() -> Any:
    from pyarrow import parquet

    return parquet
