"""Hostile mesh files, and files that are none."""

from __future__ import annotations

import os
import re
import struct
from collections.abc import Callable
from pathlib import Path
from random import Random

import numpy as np

from . import mutations

NUMBER = re.compile(r"-?\d+(\.\d+)?")
#: What may stand where a number belongs.
WORDS = (
    "nan", "inf", "-inf", "1e308", "-1e39", "1e-300", "0", "-1", "-0.0", "2", "99", "1e9", "1,5",
    "1_0", "0x10", "abc", "", "99999999999", "4000000000", "1/2/3", "-1//1", "\x00", "1 1 1 1 1",
)  # fmt: skip
HEADER = 84  # bytes of a binary STL file
LARGE = 3 << 30  # bytes, of nothing


def special(rng: Random, path: Path) -> None:
    """Put something else in a file's place: a folder, a pipe, a device, a giant, nothing."""
    path.unlink(missing_ok=True)
    kind = rng.randrange(6)
    if kind == 0:
        path.mkdir()
    elif kind == 1:
        os.mkfifo(path)
    elif kind == 2:
        path.symlink_to("/dev/zero")
    elif kind == 3:
        path.symlink_to(path)
    elif kind == 4:
        with open(path, "wb") as stream:
            stream.truncate(LARGE)


def text(rng: Random, content: str, other: str) -> str:
    """A mesh in letters with some of its numbers or lines changed."""
    if rng.random() < 0.5:
        return mutations.text(rng, content, other)
    for _ in range(rng.choice((1, 1, 2, 5))):
        found = list(NUMBER.finditer(content))
        if not found:
            return content
        at = rng.choice(found)
        content = content[: at.start()] + rng.choice(WORDS) + content[at.end() :]
    return content


def binary(rng: Random, content: bytes) -> bytes:
    """A binary STL file with its header, its count or its triangles changed."""
    for _ in range(rng.choice((1, 1, 2))):
        content = rng.choice(_BINARY)(rng, content)
    return content


def _header(rng: Random, content: bytes) -> bytes:
    words = rng.choice((b"solid x", b"solid x\nfacet", b"COLOR=\xff", b"\0" * 80, b"v 0 0 0\n"))
    return words.ljust(80) + content[80:]


def _count(rng: Random, content: bytes) -> bytes:
    count = rng.choice((0, 1, 3, 5, 10**6, 2**31, 2**32 - 1, 85_899_346))
    return content[: HEADER - 4] + struct.pack("<I", count) + content[HEADER:]


def _cut(rng: Random, content: bytes) -> bytes:
    return content[: rng.randrange(len(content) + 1)]


def _byte(rng: Random, content: bytes) -> bytes:
    at = rng.randrange(len(content) + 1)
    return content[:at] + bytes([rng.randrange(256)]) + content[at + rng.choice((0, 1)) :]


def _numbers(rng: Random, content: bytes) -> bytes:
    """Some corners nowhere or far away, all in a plane or along a line, or many more of them."""
    count = max(0, len(content) - HEADER) // 50
    records = np.frombuffer(content[HEADER : HEADER + 50 * count], "V50")
    corners = np.array([np.frombuffer(r.tobytes()[12:48], "<f4") for r in records], "<f4")
    corners = corners.reshape(count, 9)
    kind = rng.randrange(5)
    if kind == 0 and count:
        wrong = (np.nan, np.inf, 3e38, 1e-38, -1e9, 1e5)
        corners[rng.randrange(count), rng.randrange(9)] = rng.choice(wrong)
    elif kind == 1:
        corners[:, rng.randrange(3) :: 3] = rng.choice((0.0, 7.0))
    elif kind == 2:
        corners[:, rng.randrange(3) :: 3] *= rng.choice((1e-7, 1e-12, 1e-30, 1e7))
    elif kind == 3:
        corners = corners[:0]
    else:
        corners = np.repeat(corners[:100], rng.choice((2, 1000)), axis=0)
    triangles = b"".join(b"\0" * 12 + row.tobytes() + b"\0\0" for row in corners)
    return content[: HEADER - 4] + struct.pack("<I", len(corners)) + triangles


_BINARY: tuple[Callable[[Random, bytes], bytes], ...] = (
    _header, _count, _cut, _byte, _numbers, _numbers, _numbers,
)  # fmt: skip
