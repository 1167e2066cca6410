"""What a study has found: the journals of who ran it, and one Parquet file made of them.

A journal is an SQLite database with a record for each finished variant. One process writes to it,
others read meanwhile. A batch is a transaction, on the disk before the next one; what a kill or a
full disk has left half written is rolled back by who opens it next. The record ``HEAD`` is what the
study is, whole, so that the folder can be read by itself.

    records(id, said, crc)     JSON, and its CRC-32, because SQLite's pages have no checksum

SQLite's rollback journal also works on the file systems of clusters; its WAL does not.

The Parquet file has a row for each variant and controller, in order. It is read a column at a time,
so that few of them are in memory.
"""

from __future__ import annotations

import fcntl
import json
import os
import sqlite3
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from functools import cached_property, reduce
from heapq import merge
from itertools import islice, repeat
from pathlib import Path
from typing import Any
from zlib import crc32

import numpy as np
from numpy.typing import NDArray

import coopqp
from coopqp.base.errors import CoopqpError, needs
from coopqp.base.reading import check_plain
from coopqp.base.spec import Array
from coopqp.study.engine import Share
from coopqp.study.sweep.study import DONE, SEED, Row, Study

PATTERN = "journal*.sqlite3"
#: Journals of coopqp 0.1, with a line a variant.
OLDER = "journal*.jsonl"
FORM = 3  # of the database; others are refused
HEAD = -1
CHUNK = 500  # records that are read at a time, so that nobody waits for who reads
#: How long who reads and who writes wait for each other [s].
PATIENCE = 60.0


def path_of(folder: Path, share: Share) -> Path:
    """The journal of a share."""
    name = "journal" if share.whole else f"journal-{share.number}-of-{share.of}"
    return folder / f"{name}.sqlite3"


def journals(folder: Path) -> dict[Path, dict[str, Any]]:
    """The heads of all journals of a study that have one; what is no journal is refused."""
    for path in folder.glob(OLDER):
        words = "was written by an older coopqp (one that kept JSON lines)"
        raise CoopqpError(f"'{path}' {words}; use that one, or give another --out")
    heads = {path: head_of(path) for path in sorted(folder.glob(PATTERN))}
    return {path: head for path, head in heads.items() if head is not None}


def head_of(path: Path) -> dict[str, Any] | None:
    """What the study is; None where its writer was killed before it said so."""
    with _reading(path) as database:
        return _head(path, database)


def _head(path: Path, database: sqlite3.Connection) -> dict[str, Any] | None:
    (form,) = database.execute("PRAGMA user_version").fetchone()
    (tables,) = database.execute("SELECT count(*) FROM sqlite_master").fetchone()
    if not (form or tables):
        return None
    if form != FORM:
        words = f"was written by another coopqp (form {form}, this one has {FORM})"
        raise CoopqpError(f"'{path}' {words}; use that one, or give another --out")
    found = database.execute("SELECT said, crc FROM records WHERE id = ?", (HEAD,)).fetchone()
    head = _read(*found) if found else None
    if head is None:
        raise CoopqpError(f"'{path}': its head is damaged; move the folder away")
    return head


def records(path: Path) -> Iterator[tuple[int, dict[str, Any] | None]]:
    """Each record after the head, by its number; None where it is not as it was written."""
    ask = "SELECT id, said, crc FROM records WHERE id > ? ORDER BY id LIMIT ?"
    with _reading(path) as database:
        last = HEAD
        while chunk := database.execute(ask, (last, CHUNK)).fetchall():
            yield from ((number, _read(said, crc)) for number, said, crc in chunk)
            last = chunk[-1][0]


def _read(text: Any, crc: Any) -> dict[str, Any] | None:
    if not isinstance(text, bytes) or crc32(text) != crc:
        return None
    found: dict[str, Any] = json.loads(text)
    return found


@contextmanager
def _reading(path: Path) -> Iterator[sqlite3.Connection]:
    check_plain(path)
    try:
        with closing(_connected(path, "rw")) as database:
            yield database
    except sqlite3.OperationalError as error:
        raise CoopqpError(f"'{path}' cannot be read: {error}") from None
    except sqlite3.DatabaseError as error:
        words = "move it away; what is whole, sqlite3's .recover brings back"
        raise CoopqpError(f"'{path}' is not a journal, or is damaged ({error}); {words}") from None


def _connected(path: Path, mode: str) -> sqlite3.Connection:
    """A connection; texts come as bytes, which need not be UTF-8."""
    uri = f"{path.absolute().as_uri()}?mode={mode}"
    database = sqlite3.connect(uri, PATIENCE, isolation_level=None, uri=True)
    database.text_factory = bytes
    return database


class Journal:
    """A journal that is written to."""

    def __init__(self, path: Path, database: sqlite3.Connection) -> None:
        self._path, self._database = path, database

    @classmethod
    @contextmanager
    def opened(cls, path: Path, head: dict[str, Any]) -> Iterator[Journal]:
        """The journal at a path, a new one or one that goes on, for this process alone."""
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise CoopqpError(f"'{path.parent}' cannot be made: {error.strerror}") from None
        try:
            lock = open(path.with_name(f".{path.name}.lock"), "w")  # noqa: SIM115 - closed below
        except OSError as error:
            raise _unwritten(path, error.strerror) from None
        with lock:
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError:
                words = "another process is at work on it; wait for it, or take another --shard"
                raise CoopqpError(f"'{path}': {words}") from None
            if path.exists():
                check_plain(path)
            with closing(_connected(path, "rwc")) as database:
                journal = cls(path, database)
                with journal._written():
                    if _head(path, database) is None:  # a new file gets its head
                        columns = "id INTEGER PRIMARY KEY, said, crc"
                        database.execute(f"CREATE TABLE records ({columns})")
                        database.execute(f"PRAGMA user_version = {FORM}")
                        journal._insert([(HEAD, head)])
                yield journal

    def append(self, records: Iterable[tuple[int | None, dict[str, Any]]]) -> None:
        """Write records by number, None for the next one, and see them on the disk."""
        with self._written():
            self._insert(records)

    def _insert(self, records: Iterable[tuple[int | None, dict[str, Any]]]) -> None:
        texts = [(number, json.dumps(one, separators=(",", ":"))) for number, one in records]
        rows = [(number, text, crc32(text.encode())) for number, text in texts]
        self._database.executemany("INSERT OR REPLACE INTO records VALUES (?, ?, ?)", rows)

    @contextmanager
    def _written(self) -> Iterator[None]:
        """A transaction; all of it is on the disk at its end, or nothing."""
        try:
            self._database.execute("BEGIN IMMEDIATE")
            yield
            self._database.execute("COMMIT")
        except sqlite3.DatabaseError as error:
            raise _unwritten(self._path, error) from None


def _unwritten(path: Path, why: object) -> CoopqpError:
    words = f"cannot write '{path}': {why}"
    return CoopqpError(f"{words}; what was done is kept, and the same command goes on from there")


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

    ``damaged`` counts records that are not as they were written; what they said is not there.
    ``columns`` has the kind of each column of rows, "bool", "int", "float" or "text", as they come.
    """

    def __init__(self, folder: Path, study: Study) -> None:
        self._paths, self._controllers = list(journals(folder)), len(study.controllers)
        self._there = np.zeros(study.points.count, bool)
        self.damaged = 0
        kinds: dict[str, str] = {}
        for variant, rows in self._records():
            if rows is None:
                self.damaged += 1
                continue
            self._there[variant] = True
            for name, value in (item for row in rows for item in row.items()):
                kinds[name] = _wider(kinds.get(name, ""), _kind_of(value))
        self.columns = {name: kind or "float" for name, kind in kinds.items()}

    def _records(self) -> Iterator[tuple[int, list[Row] | None]]:
        """Each variant once, in order, with its rows; what is damaged besides, with None."""
        last = -1  # two shares may have done the same, and have found the same
        every = (zip(records(path), repeat(path)) for path in self._paths)
        for (variant, record), path in merge(*every, key=lambda one: one[0][0]):
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
        return int(self._there.sum())

    def missing(self, among: Sequence[int]) -> NDArray[np.int64]:
        """Those of some variants that are not there."""
        asked = np.asarray(among, dtype=np.int64)
        return asked[~self._there[asked]]

    def rows(self) -> Iterator[tuple[int, list[Row]]]:
        """Each variant that is there, in order, with its rows."""
        records = self._records()
        return ((i, rows) for i, rows in records if rows is not None and self._there[i])


def _kind_of(value: Any) -> str:
    """What a column must be to hold a value; empty for None. Lists are written as text."""
    return KINDS.get(type(value), "text")


def _wider(one: str, other: str) -> str:
    """What a column must be to hold both."""
    if not one or not other or one == other:
        return one or other
    return "float" if {one, other} == {"int", "float"} else "text"


def needs_arrow() -> None:
    """Refuse to begin where results could not be written."""
    with needs("a study", "studies"):
        import pyarrow  # noqa: F401


def compact(study: Study, folder: Path) -> Index:
    """Write what the journals hold by now; the old file stays until the new one is whole."""
    aside = folder / f".{NAME}.{os.getpid()}"
    try:
        with open(folder / LOCK, "w") as lock:
            # Wait for others, so that an older look at the journals never replaces a newer one.
            fcntl.flock(lock, fcntl.LOCK_EX)
            index = Index(folder, study)
            _write(study, index, aside)
            os.replace(aside, folder / NAME)
    except OSError as error:
        words = f"cannot write '{folder / NAME}': {error.strerror or error}"
        raise CoopqpError(f"{words}; the journal has all results") from None
    finally:
        aside.unlink(missing_ok=True)
    return index


def _write(study: Study, index: Index, path: Path) -> None:
    import pyarrow as pa

    types = {"int": pa.int64(), "float": pa.float64(), "bool": pa.bool_(), "text": pa.string()}
    varied = {
        name: reduce(_wider, map(_kind_of, values)) or "text"
        for one in study.varied
        for name, values in zip(
            one.columns, zip(*map(one.over.parts, one.over.tried()), strict=True), strict=True
        )
    }
    fixed = {**FIRST, OWN_SEED: "int", **varied, **LAST}
    kinds = {**fixed, **{k: v for k, v in index.columns.items() if k not in fixed}}
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


def _rows(study: Study, index: Index, kinds: dict[str, str]) -> Iterator[list[Any]]:
    rest = list(kinds)[len(FIRST) + 1 + len(study.columns) :]
    for number, rows in index.rows():
        variant = study.variant(number)
        varied = dict(zip(study.locations, variant.values, strict=True))
        values = [varied.get((SEED,), variant.seed), *study.parts(variant)]
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

    @cached_property
    def done(self) -> NDArray[np.bool_]:
        """Which rows are done, shape (rows,)."""
        state, states = self.codes("state")
        return np.array([name == DONE for name in states] + [False])[state]

    def codes(self, name: str) -> tuple[NDArray[np.int64], list[str]]:
        """A column of texts: the number of each row's text, -1 for none, and the texts."""
        column = self._column(name).dictionary_encode()
        codes = column.indices.fill_null(-1).to_numpy(zero_copy_only=False)
        return codes.astype(np.int64), [str(text) for text in column.dictionary.to_pylist()]


def _parquet() -> Any:
    from pyarrow import parquet

    return parquet
