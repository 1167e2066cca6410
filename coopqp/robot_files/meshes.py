"""Triangles of mesh files: STL, OBJ and COLLADA (.dae).

They are read here and not by coal's loader, since that waits for pipes that an OBJ file names, dies
of COLLADA files that go round in a circle, and takes half a file for a whole one.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from coopqp.base.errors import InvalidValueError, UnreadableFileError
from coopqp.base.spec import FARTHEST, Array
from coopqp.robot_files.collada import collada_corners
from coopqp.robot_files.obj import obj_corners
from coopqp.robot_files.stl import stl_corners

#: Of a file's name what it holds. A reader gives vertices and the rows of them that triangles have.
READERS: Mapping[str, Callable[[Path], tuple[Array, NDArray[np.int64]]]] = {
    ".stl": stl_corners,
    ".obj": obj_corners,
    ".dae": collada_corners,
}


@dataclass(frozen=True, eq=False)
class Mesh:
    """A surface of triangles.

    Attributes:
        vertices: that triangles have, each once, shape (v, 3) [m].
        corners: of each triangle, rows of vertices, shape (t, 3).
    """

    vertices: Array
    corners: NDArray[np.int64]


def version(path: Path) -> tuple[Path, int, int]:
    """The file and what tells that it is still the same."""
    try:
        found = path.stat()
    except (OSError, ValueError):
        return path, 0, 0  # reading says why
    return path, found.st_mtime_ns, found.st_size


def read_mesh(path: Path, scale: tuple[float, ...]) -> Mesh:
    """Read a file of triangles.

    Args:
        path: of a file whose name ends in .stl, .obj or .dae.
        scale: factors along the axes of the file.

    Raises:
        InvalidValueError: no such file, no such kind of file, or nothing with a surface in it; with
            the line where it has lines.
    """
    read = READERS.get(path.suffix.lower())
    if read is None:
        raise InvalidValueError(f"mesh {path}: is of no kind that is read: {', '.join(READERS)}")
    try:
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
