"""Reading files that strangers wrote: only plain files, only up to a size, text with its place."""

from __future__ import annotations

import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

from coopqp.errors import UnreadableFileError


@contextmanager
def open_bytes(path: Path) -> Iterator[BinaryIO]:
    """A file to read from.

    Pipes and devices are refused without being waited for: some never end, some never begin.

    Raises:
        UnreadableFileError: no such file, or no plain file; also where reading fails.
    """
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    except OSError as error:
        raise UnreadableFileError(path, f"cannot be read: {error.strerror}") from None
    except ValueError as error:  # a name that no file can have
        raise UnreadableFileError(repr(str(path)), f"cannot be read: {error}") from None
    try:
        mode = os.fstat(descriptor).st_mode
        if stat.S_ISDIR(mode):
            raise UnreadableFileError(path, "cannot be read: is a folder, needs a file")
        if not stat.S_ISREG(mode):
            raise UnreadableFileError(path, "cannot be read: is a pipe or a device, needs a file")
        with open(descriptor, "rb", closefd=False) as stream:
            yield stream
    except OSError as error:
        raise UnreadableFileError(path, f"cannot be read: {error.strerror}") from None
    finally:
        os.close(descriptor)


def read_bytes(path: Path, most: int) -> bytes:
    """What a file holds.

    Args:
        path: of the file.
        most: bytes that it may have.

    Raises:
        UnreadableFileError: as :func:`open_bytes`, or a larger file.
    """
    with open_bytes(path) as stream:
        content = stream.read(most + 1)
    if len(content) > most:
        words = f"is larger than {_size(most)}, the most that is read of such a file"
        raise UnreadableFileError(path, words)
    return content


def read_text(path: Path, most: int) -> str:
    """The same as text in UTF-8.

    Raises:
        UnreadableFileError: also where it is no such text, with the line.
    """
    content = read_bytes(path, most)
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
        words = f"is not a text file in UTF-8: has the byte 0x{content[error.start]:02x}"
        raise UnreadableFileError(f"{path}:{line}", words) from None


def _size(count: int) -> str:
    return f"{count >> 20} MiB" if count >= 1 << 20 else f"{count >> 10} KiB"
