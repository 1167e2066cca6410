"""The journal of a study: an SQLite database with a record for each finished variant.

One process writes to it, others read meanwhile. A batch is a transaction, on the disk before the
next one; what a kill or a full disk has left half written is rolled back by who opens it next. The
record ``HEAD`` is what the study is, whole, so that the folder can be read by itself.

    records(id, said, crc)     JSON, and its CRC-32, because SQLite's pages have no checksum

SQLite's rollback journal also works on the file systems of clusters; its WAL does not.
"""

from __future__ import annotations

import fcntl
import json
import sqlite3
from collections.abc import Iterable, Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any
from zlib import crc32

from coopqp.base.errors import CoopqpError
from coopqp.base.reading import check_plain
from coopqp.study.engine import Share

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


def journals(folder: Path) -> list[Path]:
    """All journals of a study that have a head.

    Raises:
        CoopqpError: one cannot be read, or is none, or is of an older coopqp.
    """
    for path in folder.glob(OLDER):
        words = "was written by an older coopqp (one that kept JSON lines)"
        raise CoopqpError(f"'{path}' {words}; use that one, or give another --out")
    return [path for path in sorted(folder.glob(PATTERN)) if head_of(path) is not None]


def head_of(path: Path) -> dict[str, Any] | None:
    """What the study is; None where its writer was killed before it said so.

    Raises:
        CoopqpError: it cannot be read, is not a journal, or one of another form, or is damaged.
    """
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


def _read(said: Any, crc: Any) -> dict[str, Any] | None:
    if not isinstance(said, bytes) or crc32(said) != crc:
        return None
    found: dict[str, Any] = json.loads(said)
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
        """The journal at a path, a new one or one that goes on, for this process alone.

        Raises:
            CoopqpError: another process writes to it; it cannot be written to.
        """
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
                journal._begin(head)
                yield journal

    def _begin(self, head: dict[str, Any]) -> None:
        """A new file gets its head."""
        with self._written():
            if _head(self._path, self._database) is None:
                create = "CREATE TABLE records (id INTEGER PRIMARY KEY, said, crc)"
                self._database.execute(create)
                self._database.execute(f"PRAGMA user_version = {FORM}")
                self._insert([(HEAD, head)])

    def append(self, said: Iterable[tuple[int | None, dict[str, Any]]]) -> None:
        """Write records, and see them on the disk.

        Args:
            said: by number, in the place of what had it before; None is the next number.

        Raises:
            CoopqpError: the disk is full, or gone; what was written before is kept.
        """
        with self._written():
            self._insert(said)

    def _insert(self, said: Iterable[tuple[int | None, dict[str, Any]]]) -> None:
        texts = [(number, json.dumps(one, separators=(",", ":"))) for number, one in said]
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
