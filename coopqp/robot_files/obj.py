"""Triangles of OBJ files; materials, normals and all else in them is not read."""

from __future__ import annotations

from array import array
from io import BytesIO
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from coopqp.base.errors import InvalidValueError
from coopqp.base.reading import read_bytes
from coopqp.base.spec import Array
from coopqp.robot_files.stl import LARGEST, vertex

MOST = 10**9  # number of a vertex
COLOURED = 8  # numbers that a vertex has at most: its place, a weight and a colour


def obj_corners(path: Path) -> tuple[Array, NDArray[np.int64]]:
    """Vertices, shape (v, 3), and the rows of them that each triangle has, shape (t, 3).

    Faces with more corners are cut into triangles round their first.

    Raises:
        UnreadableFileError: no such file, or a larger one.
        InvalidValueError: a vertex is none, or a face has corners that are not there.
    """
    numbers, corners, last = array("d"), array("q"), 0
    largest, largest_at = -1, 0
    for number, line in enumerate(BytesIO(read_bytes(path, LARGEST)), 1):
        words = line.partition(b"#")[0].split()
        if not words:
            continue
        if words[0] == b"v":
            numbers.extend(vertex(f"{path}:{number}", words[1:], COLOURED)[:3])
            last += 1
        elif words[0] == b"f":
            face = _face(f"{path}:{number}", words[1:], last)
            if max(face) > largest:
                largest, largest_at = max(face), number
            for i in range(1, len(face) - 1):
                corners.extend((face[0], face[i], face[i + 1]))
    if largest >= last:
        why = f"needs vertex {largest + 1}, but there are {last}"
        raise InvalidValueError(f"{path}:{largest_at}: {why}")
    return np.array(numbers).reshape(-1, 3), np.array(corners, np.int64).reshape(-1, 3)


def _face(place: str, words: list[bytes], last: int) -> list[int]:
    """Rows of a face's vertices; negative ones count back from the last before it."""
    try:
        given = [int(word.partition(b"/")[0]) for word in words]
    except ValueError:
        given = []
    face = [i - 1 if i > 0 else last + i for i in given]
    if len(face) < 3 or 0 in given or min(face) < 0 or max(face) > MOST:
        shown = b" ".join(words)[:40].decode("ascii", "replace")
        raise InvalidValueError(f"{place}: found '{shown}', needs 3 vertices or more by number")
    return face
