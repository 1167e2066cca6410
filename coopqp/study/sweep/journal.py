"""The journal of a study: a line for each finished variant, on the disk before the next batch.

The first line is the head: what the study is, whole, so that the folder can be read by itself. The
file only grows. What a kill or a full disk has left half written is the last line, and is cut off.
"""

from __future__ import annotations

import fcntl
import json
import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from coopqp.errors import CoopqpError
from coopqp.study.engine import Share
from coopqp.study.sweep.identity import differences

PATTERN = "journal*.jsonl"
FORM = 1  # of the files; others are refused


def path_of(folder: Path, share: Share) -> Path:
    """The journal of a share."""
    name = "journal" if share.whole else f"journal-{share.number}-of-{share.of}"
    return folder / f"{name}.jsonl"


def journals(folder: Path) -> list[Path]:
    """All journals of a study that have a head."""
    return [path for path in sorted(folder.glob(PATTERN)) if head_of(path) is not None]


def head_of(path: Path) -> dict[str, Any] | None:
    """The first line; None where none was finished.

    Raises:
        CoopqpError: it is no journal.
    """
    with open(path, "rb") as stream:
        line = stream.readline()
    if not line.endswith(b"\n"):
        return None
    try:
        head = json.loads(line)
        if head["form"] == FORM and isinstance(head["identity"], dict):
            return dict(head)
    except (ValueError, KeyError, TypeError):
        pass
    raise CoopqpError(f"'{path}' is no journal of a study that this coopqp can read")


def records(path: Path) -> Iterator[tuple[int, int, dict[str, Any]]]:
    """Each whole line after the head: where it begins, where it ends, what it says."""
    with open(path, "rb") as stream:
        at = len(stream.readline())
        for line in stream:
            try:
                record = json.loads(line) if line.endswith(b"\n") else None
            except ValueError:
                record = None
            if not isinstance(record, dict):
                return  # cut short, or what a machine that lost its power left behind
            yield at, at + len(line), record
            at += len(line)


def check_same(folder: Path, identity: dict[str, str]) -> None:
    """Refuse a folder with results of another study.

    Raises:
        CoopqpError: saying what differs.
    """
    for path in journals(folder):
        head = head_of(path) or {}
        if different := differences(head["identity"], identity):
            words = f"'{folder}' belongs to another study ('{head.get('name')}'), or an older one"
            raise CoopqpError(
                f"{words}: {', '.join(different)} differ{'' if len(different) > 1 else 's'}; "
                "give another --out, or remove the folder"
            )


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
        with open(self._path, "rb") as stream:
            end = len(stream.readline())
        for _, after, _ in records(self._path):
            end = after
        os.ftruncate(self._descriptor, end)
        os.lseek(self._descriptor, end, os.SEEK_SET)

    def append(self, said: Sequence[dict[str, Any]]) -> None:
        """Write lines, and see them on the disk.

        Raises:
            CoopqpError: the disk is full, or gone; what was written before is kept.
        """
        lines = "".join(json.dumps(one, separators=(",", ":")) + "\n" for one in said).encode()
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
