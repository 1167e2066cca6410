"""Triangles of mesh files: STL, OBJ and COLLADA (.dae).

coal's loader waits for pipes that an OBJ file names, crashes on COLLADA files with circles, and
accepts half a file. Materials, normals and all else are not read.
"""

from __future__ import annotations

import math
from array import array
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from coopqp.base.errors import InvalidValueError, UnreadableFileError
from coopqp.base.reading import read_bytes
from coopqp.base.spec import FARTHEST, Array
from coopqp.robot_files.collada import collada_corners

LARGEST = 100_000_000  # bytes of a file
HEADER, TRIANGLE = 84, 50  # bytes of a binary file before its triangles, and of each
#: A binary triangle: its normal, which is not read, and its corners.
RECORD = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
#: Words that lines of a text file begin with, besides vertex.
WORDS = (b"solid", b"facet", b"outer", b"endloop", b"endfacet", b"endsolid")


def _stl(path: Path) -> tuple[Array, NDArray[np.int64]]:
    """Vertices, shape (v, 3), and the rows of them that each triangle has, shape (t, 3)."""
    content = read_bytes(path, LARGEST)
    count = int.from_bytes(content[HEADER - 4 : HEADER], "little")
    if len(content) == HEADER + TRIANGLE * count:
        points = np.frombuffer(content, RECORD, count, HEADER)["corners"].reshape(-1, 3)
    elif content.lstrip()[:5].lower() == b"solid" and b"\0" not in content[:HEADER]:
        points = _stl_text(path, content)
    else:
        raise InvalidValueError(
            f"{path}: is no whole STL file: {len(content)} bytes are not those of {count} triangles"
        )
    # Corners that lie together are one vertex; adding zero makes -0.0 one with 0.0.
    rows = np.ascontiguousarray(points + np.float32(0.0))
    as_bytes = rows.view(f"V{rows.dtype.itemsize * 3}").ravel()
    _, first, same = np.unique(as_bytes, return_index=True, return_inverse=True)
    return rows[first].astype(float), same.reshape(-1, 3)


def _stl_text(path: Path, content: bytes) -> Array:
    """The corners of a text file, three to a triangle, shape (3 t, 3)."""
    numbers, corners, word, number = array("d"), 0, b"", 1
    for number, line in enumerate(BytesIO(content), 1):
        words = line.split()
        if not words:
            continue
        word = words[0].lower()
        if word == b"vertex":
            numbers.extend(_vertex(f"{path}:{number}", words[1:], 3))
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


def _vertex(place: str, words: list[bytes], most: int) -> list[float]:
    """The numbers of a vertex, 3 to ``most``."""
    try:
        found = [float(word) for word in words]
    except ValueError:
        found = []
    fine = 3 <= len(found) <= most and all(map(math.isfinite, found))
    if not fine or b"_" in b"".join(words):  # Python reads 1_000 as 1000
        shown = b" ".join(words)[:40].decode("ascii", "replace")
        raise InvalidValueError(f"{place}: found '{shown}', needs 3 numbers")
    return found


MOST = 10**9  # largest number of a vertex
COLOURED = 8  # numbers of a vertex with a weight and a colour


def _obj(path: Path) -> tuple[Array, NDArray[np.int64]]:
    """Vertices, shape (v, 3), and the rows of them that each triangle has, shape (t, 3).

    Faces with more corners are cut into triangles round their first.
    """
    numbers, corners, last = array("d"), array("q"), 0
    largest, largest_at = -1, 0
    for number, line in enumerate(BytesIO(read_bytes(path, LARGEST)), 1):
        words = line.partition(b"#")[0].split()
        if not words:
            continue
        if words[0] == b"v":
            numbers.extend(_vertex(f"{path}:{number}", words[1:], COLOURED)[:3])
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


#: By suffix, readers of vertices and of triangles as rows of them.
READERS: Mapping[str, Callable[[Path], tuple[Array, NDArray[np.int64]]]] = {
    ".stl": _stl,
    ".obj": _obj,
    ".dae": collada_corners,
}


@dataclass(frozen=True, eq=False)
class Mesh:
    """A surface: vertices of triangles, shape (v, 3) [m]; rows of them, shape (t, 3)."""

    vertices: Array
    corners: NDArray[np.int64]


def read_mesh(path: Path, scale: tuple[float, ...]) -> Mesh:
    """Read an .stl, .obj or .dae file, with scale factors along its axes.

    Raises:
        InvalidValueError: no such file, another kind of file, or no surface in it; with the line.
    """
    read = READERS.get(path.suffix.lower())
    if read is None:
        raise InvalidValueError(f"mesh {path}: is of no kind that is read: {', '.join(READERS)}")
    try:
        with np.errstate(all="ignore"):  # overflows are refused below
            points, corners = read(path)
    except (InvalidValueError, UnreadableFileError) as error:
        raise InvalidValueError(f"mesh {error}") from None
    used, rows = np.unique(corners, return_inverse=True)
    vertices = points[used] * np.array(scale)
    if not len(vertices) or not np.ptp(vertices, axis=0).any():
        raise InvalidValueError(f"mesh {path}: has no surface")
    if not np.isfinite(vertices).all():
        raise InvalidValueError(f"mesh {path}: a vertex is nowhere (NaN or infinite)")
    if (size := float(np.abs(vertices).max())) > FARTHEST:
        words = f"reaches {size:g} m far, needs at most {FARTHEST:g} m; it may need a scale"
        raise InvalidValueError(f"mesh {path}: {words}")
    return Mesh(vertices, rows.reshape(-1, 3))
