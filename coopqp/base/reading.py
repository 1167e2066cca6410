"""Reading files that strangers wrote: only plain files, only up to a size, text with its place."""

import json
import os
import stat
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any, BinaryIO

from pydantic import AfterValidator, BeforeValidator, ValidationInfo

from coopqp.base.errors import UnreadableFileError

_DECODER = json.JSONDecoder()


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
