"""Triangles of STL files, binary and text."""

from __future__ import annotations

import math
from array import array
from io import BytesIO
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from coopqp.base.errors import InvalidValueError
from coopqp.base.reading import read_bytes
from coopqp.base.spec import Array

LARGEST = 100_000_000  # bytes of a file
HEADER, TRIANGLE = 84, 50  # bytes of a binary file before its triangles, and of each
#: A binary triangle: its normal, which is not read, and its corners.
RECORD = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
#: Words that lines of a text file begin with, besides vertex.
WORDS = (b"solid", b"facet", b"outer", b"endloop", b"endfacet", b"endsolid")


def stl_corners(path: Path) -> tuple[Array, NDArray[np.int64]]:
    """Vertices, shape (v, 3), and the rows of them that each triangle has, shape (t, 3).

    Raises:
        UnreadableFileError: no such file, or a larger one.
        InvalidValueError: it is no STL file, or not a whole one.
    """
    content = read_bytes(path, LARGEST)
    count = int.from_bytes(content[HEADER - 4 : HEADER], "little")
    if len(content) == HEADER + TRIANGLE * count:
        points = np.frombuffer(content, RECORD, count, HEADER)["corners"].reshape(-1, 3)
    elif content.lstrip()[:5].lower() == b"solid" and b"\0" not in content[:HEADER]:
        points = _text(path, content)
    else:
        raise InvalidValueError(
            f"{path}: is no whole STL file: {len(content)} bytes are not those of {count} triangles"
        )
    # Corners that lie together are one vertex; adding zero makes -0.0 one with 0.0.
    rows = np.ascontiguousarray(points + np.float32(0.0))
    as_bytes = rows.view(f"V{rows.dtype.itemsize * 3}").ravel()
    _, first, same = np.unique(as_bytes, return_index=True, return_inverse=True)
    return rows[first].astype(float), same.reshape(-1, 3)


def _text(path: Path, content: bytes) -> Array:
    """The corners of a text file, three to a triangle, shape (3 t, 3)."""
    numbers, corners, word, number = array("d"), 0, b"", 1
    for number, line in enumerate(BytesIO(content), 1):
        words = line.split()
        if not words:
            continue
        word = words[0].lower()
        if word == b"vertex":
            numbers.extend(vertex(f"{path}:{number}", words[1:], 3))
            corners += 1
        elif word not in WORDS:
            shown = word[:20].decode("ascii", "replace")
            raise InvalidValueError(f"{path}:{number}: found '{shown}', which no STL file has")
        elif word == b"endloop":
            if corners != 3:
                why = f"a triangle with {corners} corners ends here"
                raise InvalidValueError(f"{path}:{number}: {why}")
            corners = 0
    if word != b"endsolid" or corners:
        raise InvalidValueError(f"{path}:{number}: ends in the middle, without 'endsolid'")
    return np.array(numbers).reshape(-1, 3)


def vertex(place: str, words: list[bytes], most: int) -> list[float]:
    """The numbers of a vertex.

    Args:
        place: file and line.
        words: of the line, without its first.
        most: numbers that there may be; 3 are needed.

    Raises:
        InvalidValueError: they are no finite numbers, too few or too many.
    """
    try:
        found = [float(word) for word in words]
    except ValueError:
        found = []
    fine = 3 <= len(found) <= most and all(map(math.isfinite, found))
    if not fine or b"_" in b"".join(words):  # which Python takes for 1000 in 1_000
        shown = b" ".join(words)[:40].decode("ascii", "replace")
        raise InvalidValueError(f"{place}: found '{shown}', needs 3 numbers")
    return found
