"""The journal of a study: a line for each finished variant, on the disk before the next batch.

The first line is the head: what the study is, whole, so that the folder can be read by itself. The
file only grows. What a kill or a full disk has left half written is the last line, and is cut off.
Each line ends with a checksum of itself; one that is not right counts as not there.
"""

from __future__ import annotations

import fcntl
import json
import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from zlib import crc32

from coopqp.errors import CoopqpError
from coopqp.reading import open_bytes
from coopqp.study.engine import Share

PATTERN = "journal*.jsonl"
FORM = 2  # of the files; others are refused
_SUM = b',"crc":"%08x"}\n'
_LENGTH = len(_SUM % 0)


def path_of(folder: Path, share: Share) -> Path:
    """The journal of a share."""
    name = "journal" if share.whole else f"journal-{share.number}-of-{share.of}"
    return folder / f"{name}.jsonl"


def journals(folder: Path) -> list[Path]:
    """All journals of a study that have a head.

    Raises:
        CoopqpError: one cannot be read, or is none.
    """
    return [path for path in sorted(folder.glob(PATTERN)) if head_of(path) is not None]


def head_of(path: Path) -> dict[str, Any] | None:
    """The first line; None where none was finished.

    Raises:
        CoopqpError: it cannot be read, is no journal, or one of another form, or is damaged.
    """
    with open_bytes(path) as stream:
        line = stream.readline()
    if not line.endswith(b"\n"):
        return None
    head = read(line)
    if head is not None and head.get("form") == FORM:
        return head
    try:
        form = json.loads(line)["form"]
    except (ValueError, KeyError, TypeError):
        form = FORM
    if form != FORM:
        words = f"was written by another coopqp (form {form!r:.20}, this one has {FORM})"
        raise CoopqpError(f"'{path}' {words}; use that one, or give another --out")
    raise CoopqpError(f"'{path}': its head is damaged; move the folder away")


def line_of(said: dict[str, Any]) -> bytes:
    """As a line of JSON, with its checksum as the last value."""
    text = json.dumps(said, separators=(",", ":")).encode()[:-1]
    return text + _SUM % crc32(text)


def read(line: bytes) -> dict[str, Any] | None:
    """What a line says; None where it is not as it was written."""
    if line[-_LENGTH:] != _SUM % crc32(line[:-_LENGTH]):
        return None
    said: dict[str, Any] = json.loads(line)
    return said


def records(path: Path) -> Iterator[tuple[int, dict[str, Any] | None]]:
    """Each whole line after the head: where it begins, what it says; None where it is damaged.

    Raises:
        CoopqpError: it cannot be read.
    """
    with open_bytes(path) as stream:
        at = len(stream.readline())
        for line in stream:
            if line.endswith(b"\n"):
                yield at, read(line)
            at += len(line)


class Journal:
    """A journal that is written to.

    Args:
        path: of the file.
        descriptor: of it, open for writing at its end.
    """

    def __init__(self, path: Path, descriptor: int) -> None:
        self._path, self._descriptor = path, descriptor

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
            descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o666)
        except OSError as error:
            raise _unwritten(path, error) from None
        try:
            try:
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError:
                words = "another process is at work on it; wait for it, or take another --shard"
                raise CoopqpError(f"'{path}': {words}") from None
            journal = cls(path, descriptor)
            journal._begin(head)
            yield journal
        finally:
            os.close(descriptor)

    def _begin(self, head: dict[str, Any]) -> None:
        """Cut off what is half written; a new file gets its head."""
        if head_of(self._path) is None:
            os.ftruncate(self._descriptor, 0)
            self.append([head])
            return
        with open_bytes(self._path) as stream:
            end = 0
            for line in stream:
                end += len(line) if line.endswith(b"\n") else 0
        os.ftruncate(self._descriptor, end)
        os.lseek(self._descriptor, end, os.SEEK_SET)

    def append(self, said: Sequence[dict[str, Any]]) -> None:
        """Write lines, and see them on the disk.

        Raises:
            CoopqpError: the disk is full, or gone; what was written before is kept.
        """
        lines = b"".join(map(line_of, said))
        begun = os.lseek(self._descriptor, 0, os.SEEK_CUR)
        try:
            written = 0
            while written < len(lines):
                written += os.write(self._descriptor, lines[written:])
            os.fsync(self._descriptor)
        except OSError as error:
            os.ftruncate(self._descriptor, begun)
            raise _unwritten(self._path, error) from None


def _unwritten(path: Path, error: OSError) -> CoopqpError:
    words = f"cannot write '{path}': {error.strerror}"
    return CoopqpError(f"{words}; what was done is kept, and the same command goes on from there")
