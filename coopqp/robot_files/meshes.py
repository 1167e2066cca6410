"""Triangles of mesh files: STL, OBJ and COLLADA (.dae).

coal's loader waits for pipes that an OBJ file names, crashes on COLLADA files with circles, and
accepts half a file. Materials, normals and all else are not read, nor unit and upward axis of a
COLLADA file, as by pinocchio; its geometry is that of the scene, where its nodes put it.
"""

import math
import xml.etree.ElementTree as ET
from array import array
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from coopqp.base.errors import InvalidValueError, UnreadableFileError
from coopqp.base.reading import read_bytes
from coopqp.base.spec import FARTHEST, Array
from coopqp.robot_files.xml import MAX_DEPTH, fault, read_xml

Ints = NDArray[np.int64]

LARGEST = 100_000_000  # bytes of a file
HEADER, TRIANGLE = 84, 50  # bytes of a binary file before its triangles, and of each
#: A binary triangle: its normal, which is not read, and its corners.
RECORD = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
#: Words that lines of a text file begin with, besides vertex.
WORDS = (b"solid", b"facet", b"outer", b"endloop", b"endfacet", b"endsolid")


def _stl(path: Path) -> tuple[Array, Ints]:
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


def _vertex(place: str, words: list[bytes], maximum: int) -> list[float]:
    """The numbers of a vertex, 3 to ``maximum``."""
    try:
        found = [float(word) for word in words]
    except ValueError:
        found = []
    fine = 3 <= len(found) <= maximum and all(map(math.isfinite, found))
    if not fine or b"_" in b"".join(words):  # Python reads 1_000 as 1000
        shown = b" ".join(words)[:40].decode("ascii", "replace")
        raise InvalidValueError(f"{place}: found '{shown}', needs 3 numbers")
    return found


MAX_VERTEX = 10**9  # largest number of a vertex
COLOURED = 8  # numbers of a vertex with a weight and a colour


def _obj(path: Path) -> tuple[Array, Ints]:
    """Vertices, shape (v, 3), and the rows that each triangle has, (t, 3); other faces as fans."""
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
    if len(face) < 3 or 0 in given or min(face) < 0 or max(face) > MAX_VERTEX:
        shown = b" ".join(words)[:40].decode("ascii", "replace")
        raise InvalidValueError(f"{place}: found '{shown}', needs 3 vertices or more by number")
    return face


#: Largest numbers of nodes and corners of triangles of a file's instances.
MAX_NODES, MAX_CORNERS = 10_000, 10_000_000
#: Geometry with faces; lines and points are ignored.
FACES = ("triangles", "polylist", "polygons", "tristrips", "trifans")
NOT_READ = ("lookat", "skew", "instance_controller")  # parts of a node that would move its geometry


def _collada(path: Path) -> tuple[Array, Ints]:
    """Vertices, shape (v, 3), and the rows of them that each triangle has, shape (t, 3)."""
    xml = read_xml(path, ["COLLADA"], "COLLADA", texts=True)
    library, points, corners = _Library(xml), [np.zeros((0, 3))], [np.zeros(0, np.int64)]
    before, total = 0, 0
    for X, geometry in _instances(xml, library):
        for places, rows in library.faces(geometry):
            corners.append(rows + before)
            points.append(places @ X[:3, :3].T + X[:3, 3])
            before, total = before + len(places), total + len(rows)
            if max(before, total) > MAX_CORNERS:
                raise fault(geometry, f"its instances have more than {MAX_CORNERS} corners")
    return np.concatenate(points), np.concatenate(corners).reshape(-1, 3)


class _Library:
    """The elements of a file by their ids, and their triangles."""

    def __init__(self, xml: ET.Element) -> None:
        self._by_id = {(e.tag, e.get("id")): e for e in xml.iter() if e.get("id")}
        self._read: dict[ET.Element, list[tuple[Array, Ints]]] = {}

    def named(self, user: ET.Element, tag: str, key: str) -> ET.Element:
        address = user.get(key, "")
        found = self._by_id.get((tag, address.removeprefix("#")))
        if found is None or not address.startswith("#"):
            raise fault(user, f"no {tag} '{address[:40]}'", key)
        return found

    def faces(self, geometry: ET.Element) -> list[tuple[Array, Ints]]:
        """Points, shape (v, 3), and corners of triangles, three to each, shape (3 t,)."""
        if geometry not in self._read:
            parts = (part for mesh in geometry.findall("mesh") for part in mesh)
            self._read[geometry] = [self._faces(part) for part in parts if part.tag in FACES]
        return self._read[geometry]

    def _faces(self, part: ET.Element) -> tuple[Array, Ints]:
        inputs = {e.get("semantic"): e for e in part.findall("input")}
        if "VERTEX" not in inputs:
            raise fault(part, "needs an input of vertices")
        points = self._points(inputs["VERTEX"])
        offsets = [_whole(e, "offset", 0, 99) for e in part.findall("input")]
        step, offset = max(offsets) + 1, _whole(inputs["VERTEX"], "offset", 0, 99)
        rows, counts = np.zeros(0, np.int64), np.zeros(0, np.int64)
        for p in part.findall("p"):
            numbers = _ints(p)
            if len(numbers) % step:
                raise fault(p, f"found {len(numbers)} numbers, needs a multiple of {step}")
            rows = np.concatenate([rows, numbers[offset::step]])
            counts = np.append(counts, len(numbers) // step)
        if len(rows) and not (rows.min() >= 0 and rows.max() < len(points)):
            wrong = int(rows[(rows < 0) | (rows >= len(points))][0])
            raise fault(part, f"no vertex {wrong}; it has {len(points)}")
        return points, rows[_corners(part, counts, len(rows))]

    def _points(self, user: ET.Element) -> Array:
        """The places of vertices, shape (v, 3)."""
        vertices = self.named(user, "vertices", "source")
        places = [e for e in vertices.findall("input") if e.get("semantic") == "POSITION"]
        if not places:
            raise fault(vertices, "needs an input of positions")
        source = self.named(places[0], "source", "source")
        accessor, numbers = source.find("technique_common/accessor"), source.find("float_array")
        if accessor is None or numbers is None:
            raise fault(source, "needs numbers and an accessor to them")
        values = _floats(numbers)
        step, first = _whole(accessor, "stride", 1, 99), _whole(accessor, "offset", 0, len(values))
        count = _whole(accessor, "count", 0, len(values))
        if step < 3 or first + count * step > len(values):
            words = f"{len(values)} numbers are not {count} times {step}, at least 3, from {first}"
            raise fault(accessor, f"{words} on")
        return values[first : first + count * step].reshape(count, step)[:, :3]


def _instances(xml: ET.Element, library: _Library) -> Iterator[tuple[Array, ET.Element]]:
    """Each geometry of the scene, and the transform to where it is, shape (4, 4)."""
    scene = xml.find("scene/instance_visual_scene")
    if scene is None:
        raise fault(xml, "has no scene")
    waiting, nodes = [(np.eye(4), library.named(scene, "visual_scene", "url"), 0)], 0
    while waiting:
        X, holder, depth = waiting.pop()
        nodes += 1
        if nodes > MAX_NODES or depth > MAX_DEPTH:
            words = f"nodes inside nodes are more than {MAX_NODES}, or go round in a circle"
            raise fault(holder, words)
        X = X @ _transform(holder) if holder.tag == "node" else X
        for other in holder:
            if other.tag in NOT_READ:
                raise fault(other, "is not read; take it out")
        for user in holder.findall("instance_geometry"):
            yield X, library.named(user, "geometry", "url")
        inside = [library.named(e, "node", "url") for e in holder.findall("instance_node")]
        inside += holder.findall("node")
        waiting += [(X, node, depth + 1) for node in reversed(inside)]


def _transform(node: ET.Element) -> Array:
    """From a node to what holds it, shape (4, 4)."""
    X = np.eye(4)
    for part in node:
        if part.tag not in TRANSFORMS:
            continue
        count, made = TRANSFORMS[part.tag]
        values = _floats(part)
        if len(values) != count:
            raise fault(part, f"found {len(values)} numbers, needs {count}")
        X = X @ made(values)
    return X


def _turned(axis_and_degrees: Array) -> Array:
    *axis, degrees = axis_and_degrees
    turn = np.array(axis) * math.radians(degrees) / (math.hypot(*axis) or 1.0)
    return np.array(pin.SE3(pin.exp3(turn), np.zeros(3)).homogeneous)


TRANSFORMS: dict[str, tuple[int, Callable[[Array], Array]]] = {
    "matrix": (16, lambda values: values.reshape(4, 4)),
    "translate": (3, lambda p: np.array(pin.SE3(np.eye(3), p).homogeneous)),
    "rotate": (4, _turned),
    "scale": (3, lambda values: np.diag([*values, 1.0])),
}


def _corners(part: ET.Element, counts: Ints, total: int) -> Ints:
    """Indices of triangles' corners among an element's; counts: corners of each ``p`` in it."""
    if part.tag == "triangles":
        if total % 3:
            raise fault(part, f"{total} corners are no whole triangles")
        return np.arange(total)
    if part.tag == "polylist":
        vcount = part.find("vcount")
        counts = _ints(vcount) if vcount is not None else np.zeros(0, np.int64)
        if (counts < 0).any() or counts.astype(float).sum() != total:
            raise fault(part, f"vcount does not sum to {total} corners")
    # Triangles of each polygon: its first, i-th and next corner; of a strip the i-th from there.
    each = np.maximum(counts - 2, 0)
    first = np.repeat(np.cumsum(counts) - counts, each)
    i = np.arange(each.sum()) - np.repeat(np.cumsum(each) - each, each)
    start = first + i if part.tag == "tristrips" else first
    return np.column_stack([start, first + i + 1, first + i + 2]).ravel()


def _whole(element: ET.Element, key: str, default: int, maximum: int) -> int:
    text = element.get(key, str(default))
    if not (text.isascii() and text.isdigit() and len(text) <= 9 and int(text) <= maximum):
        raise fault(element, f"found '{text[:40]}', needs a whole number of at most {maximum}", key)
    return int(text)


def _floats(element: ET.Element) -> Array:
    try:
        values = np.array((element.text or "").split(), float)
    except ValueError:
        values = np.full(1, np.nan)
    if not np.isfinite(values).all():
        raise fault(element, "needs finite numbers alone")
    return values


def _ints(element: ET.Element) -> Ints:
    try:
        return np.array((element.text or "").split(), np.int64)
    except (ValueError, OverflowError):
        raise fault(element, "needs whole numbers alone") from None


#: By suffix, readers of vertices and of triangles as rows of them.
READERS = {".stl": _stl, ".obj": _obj, ".dae": _collada}


@dataclass(frozen=True, eq=False)
class Mesh:
    """A surface: vertices of triangles, shape (v, 3) [m]; rows of them, shape (t, 3)."""

    vertices: Array
    corners: Ints


def read_mesh(path: Path, scale: tuple[float, ...]) -> Mesh:
    """Read an .stl, .obj or .dae file, with scale factors along its axes.

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
