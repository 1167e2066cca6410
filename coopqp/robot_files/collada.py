"""Triangles of COLLADA files (.dae): the geometry of the scene, where its nodes put it.

A file's unit and upward axis are ignored, as by pinocchio.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from coopqp.base.errors import InvalidValueError
from coopqp.base.spec import Array
from coopqp.robot_files.xml import DEEPEST, place_of, read_xml

Ints = NDArray[np.int64]

#: Largest numbers of nodes and corners of triangles of a file's instances.
MOST_NODES, MOST_CORNERS = 10_000, 10_000_000
#: Geometry with faces; lines and points are ignored.
FACES = ("triangles", "polylist", "polygons", "tristrips", "trifans")
#: Parts of a node that would move its geometry.
NOT_READ = ("lookat", "skew", "instance_controller")


def collada_corners(path: Path) -> tuple[Array, Ints]:
    """Vertices, shape (v, 3), and the rows of them that each triangle has, shape (t, 3).

    Raises:
        InvalidValueError: no such file, no COLLADA file, or one whose parts do not fit together.
    """
    xml = read_xml(path, ["COLLADA"], "COLLADA", texts=True)
    library, points, corners = _Library(xml), [np.zeros((0, 3))], [np.zeros(0, np.int64)]
    before, total = 0, 0
    for X, geometry in _instances(xml, library):
        for places, rows in library.faces(geometry):
            corners.append(rows + before)
            points.append(places @ X[:3, :3].T + X[:3, 3])
            before, total = before + len(places), total + len(rows)
            if max(before, total) > MOST_CORNERS:
                words = f"its instances have more than {MOST_CORNERS} corners"
                raise InvalidValueError(f"{place_of(geometry)}: {words}")
    return np.concatenate(points), np.concatenate(corners).reshape(-1, 3)


class _Library:
    """The elements of a file by their ids, and their triangles."""

    def __init__(self, xml: ET.Element) -> None:
        self._by_id = {(e.tag, e.get("id")): e for e in xml.iter() if e.get("id")}
        self._read: dict[ET.Element, list[tuple[Array, Ints]]] = {}

    def named(self, user: ET.Element, tag: str, key: str) -> ET.Element:
        """The element that an attribute refers to by ``#id``."""
        address = user.get(key, "")
        found = self._by_id.get((tag, address.removeprefix("#")))
        if found is None or not address.startswith("#"):
            raise InvalidValueError(f"{place_of(user)} {key}: no {tag} '{address[:40]}'")
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
            raise InvalidValueError(f"{place_of(part)}: needs an input of vertices")
        points = self._points(inputs["VERTEX"])
        offsets = [_whole(e, "offset", 0, 99) for e in part.findall("input")]
        step, offset = max(offsets) + 1, _whole(inputs["VERTEX"], "offset", 0, 99)
        rows, counts = np.zeros(0, np.int64), np.zeros(0, np.int64)
        for p in part.findall("p"):
            numbers = _ints(p)
            if len(numbers) % step:
                words = f"found {len(numbers)} numbers, needs a multiple of {step}"
                raise InvalidValueError(f"{place_of(p)}: {words}")
            rows = np.concatenate([rows, numbers[offset::step]])
            counts = np.append(counts, len(numbers) // step)
        if len(rows) and not (rows.min() >= 0 and rows.max() < len(points)):
            wrong = int(rows[(rows < 0) | (rows >= len(points))][0])
            raise InvalidValueError(f"{place_of(part)}: no vertex {wrong}; it has {len(points)}")
        return points, rows[_corners(part, counts, len(rows))]

    def _points(self, user: ET.Element) -> Array:
        """The places of vertices, shape (v, 3)."""
        vertices = self.named(user, "vertices", "source")
        places = [e for e in vertices.findall("input") if e.get("semantic") == "POSITION"]
        if not places:
            raise InvalidValueError(f"{place_of(vertices)}: needs an input of positions")
        source = self.named(places[0], "source", "source")
        accessor, numbers = source.find("technique_common/accessor"), source.find("float_array")
        if accessor is None or numbers is None:
            raise InvalidValueError(f"{place_of(source)}: needs numbers and an accessor to them")
        values = _floats(numbers)
        step, first = _whole(accessor, "stride", 1, 99), _whole(accessor, "offset", 0, len(values))
        count = _whole(accessor, "count", 0, len(values))
        if step < 3 or first + count * step > len(values):
            words = f"{len(values)} numbers are not {count} times {step}, at least 3, from {first}"
            raise InvalidValueError(f"{place_of(accessor)}: {words} on")
        return values[first : first + count * step].reshape(count, step)[:, :3]


def _instances(xml: ET.Element, library: _Library) -> Iterator[tuple[Array, ET.Element]]:
    """Each geometry of the scene, and the transform to where it is, shape (4, 4)."""
    scene = xml.find("scene/instance_visual_scene")
    if scene is None:
        raise InvalidValueError(f"{place_of(xml)}: has no scene")
    waiting, nodes = [(np.eye(4), library.named(scene, "visual_scene", "url"), 0)], 0
    while waiting:
        X, holder, depth = waiting.pop()
        nodes += 1
        if nodes > MOST_NODES or depth > DEEPEST:
            words = f"nodes inside nodes are more than {MOST_NODES}, or go round in a circle"
            raise InvalidValueError(f"{place_of(holder)}: {words}")
        X = X @ _transform(holder) if holder.tag == "node" else X
        for other in holder:
            if other.tag in NOT_READ:
                raise InvalidValueError(f"{place_of(other)}: is not read; take it out")
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
            words = f"found {len(values)} numbers, needs {count}"
            raise InvalidValueError(f"{place_of(part)}: {words}")
        X = X @ made(values)
    return X


def _translated(p: Array) -> Array:
    X = np.eye(4)
    X[:3, 3] = p
    return X


def _turned(axis_and_degrees: Array) -> Array:
    """Rodrigues' formula."""
    *axis, degrees = axis_and_degrees.tolist()
    angle, size = math.radians(degrees), math.hypot(*axis) or 1.0
    x, y, z = (a / size for a in axis)
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    X = np.eye(4)
    X[:3, :3] += math.sin(angle) * K + (1.0 - math.cos(angle)) * K @ K
    return X


TRANSFORMS: dict[str, tuple[int, Callable[[Array], Array]]] = {
    "matrix": (16, lambda values: values.reshape(4, 4)),
    "translate": (3, _translated),
    "rotate": (4, _turned),
    "scale": (3, lambda values: np.diag([*values, 1.0])),
}


def _corners(part: ET.Element, counts: Ints, total: int) -> Ints:
    """Indices of triangles' corners among an element's; counts: corners of each ``p`` in it."""
    if part.tag == "triangles":
        if total % 3:
            raise InvalidValueError(f"{place_of(part)}: {total} corners are no whole triangles")
        return np.arange(total)
    if part.tag == "polylist":
        vcount = part.find("vcount")
        counts = _ints(vcount) if vcount is not None else np.zeros(0, np.int64)
        if (counts < 0).any() or counts.astype(float).sum() != total:
            raise InvalidValueError(f"{place_of(part)}: vcount does not sum to {total} corners")
    # Triangles of each polygon: its first, i-th and next corner; of a strip the i-th from there.
    each = np.maximum(counts - 2, 0)
    first = np.repeat(np.cumsum(counts) - counts, each)
    i = np.arange(each.sum()) - np.repeat(np.cumsum(each) - each, each)
    start = first + i if part.tag == "tristrips" else first
    return np.column_stack([start, first + i + 1, first + i + 2]).ravel()


def _whole(element: ET.Element, key: str, default: int, most: int) -> int:
    """A count in an attribute."""
    text = element.get(key, str(default))
    if not (text.isascii() and text.isdigit() and len(text) <= 9 and int(text) <= most):
        words = f"found '{text[:40]}', needs a whole number of at most {most}"
        raise InvalidValueError(f"{place_of(element)} {key}: {words}")
    return int(text)


def _floats(element: ET.Element) -> Array:
    """The numbers in an element."""
    try:
        values = np.array((element.text or "").split(), float)
    except ValueError:
        values = np.full(1, np.nan)
    if not np.isfinite(values).all():
        raise InvalidValueError(f"{place_of(element)}: needs finite numbers alone")
    return values


def _ints(element: ET.Element) -> Ints:
    try:
        return np.array((element.text or "").split(), np.int64)
    except (ValueError, OverflowError):
        raise InvalidValueError(f"{place_of(element)}: needs whole numbers alone") from None
