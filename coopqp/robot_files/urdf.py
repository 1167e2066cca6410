"""Reading URDF files: joints by pinocchio, shapes and mimic joints from the XML."""

from __future__ import annotations

import os
import xml.etree.ElementTree as ET
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from coopqp.base.errors import InvalidValueError
from coopqp.base.reading import absolute
from coopqp.robot import Shape
from coopqp.robot_files.selection import Description, Follower
from coopqp.robot_files.urdf_schema import (
    Numbers,
    check_circles,
    check_names,
    check_numbers,
    check_schema,
    negative_moment,
    told_place,
)
from coopqp.robot_files.xml import (
    missing_meshes,
    numbers_of,
    pinocchio_says,
    place_of,
    places,
    read_xml,
    stderr_lines,
)


def read_urdf(path: Path, package_dirs: Sequence[Path] = ()) -> Description:
    """Read a URDF file; meshes are looked for, but not read.

    Args:
        path: of the file.
        package_dirs: folders of ``package://`` packages, besides those above the file.

    Raises:
        InvalidValueError: no such file, or not a URDF file.
    """
    xml = read_xml(path, ["robot"], "URDF")
    for element in xml.iter():
        if "xacro" in element.tag:
            words = "is a xacro file; make a URDF of it first: xacro FILE"
            raise InvalidValueError(f"{place_of(element)}: {words}")
    if xml.find("link") is None:
        raise InvalidValueError(f"{place_of(xml)}: is not a URDF file: has no <link>")
    impossible = _check(xml)
    heard: list[str] = []
    try:
        with stderr_lines(heard):
            model = pin.buildModelFromXML(ET.tostring(xml, encoding="unicode"))
    except Exception as error:  # noqa: BLE001 - pinocchio may raise anything
        why = heard or [pinocchio_says(error)]
        raise InvalidValueError(
            f"{told_place(xml, why)}: is not a robot that can be read: {'; '.join(why)}"
        ) from None
    shapes, undrawn = _shapes(xml, "visual", path, package_dirs)
    collide, unread = _shapes(xml, "collision", path, package_dirs)
    missing = [part.get("filename", "") for _, part in undrawn if part.tag == "mesh"]
    meshes = sum(shape.kind == "mesh" for shape in shapes) + len(missing)
    return Description(
        name=xml.get("name") or path.stem,
        model=model,
        followers=dict(_mimics(xml)),
        shapes=shapes,
        collision_shapes=collide,
        unseen=tuple(_why_unseen(frame, part) for frame, part in unread),
        places=places(xml.findall("joint")),
        warnings=(
            *impossible,
            *(f"{path.name}: {line}" for line in heard),
            *missing_meshes(path.name, missing, meshes),
        ),
    )


_ONE, _THREE = Numbers(1), Numbers(3)
_LENGTH, _LIMIT = Numbers(1, "length", positive=True), Numbers(1, "limit")
#: Geometries that are read.
SHAPES = ("box", "cylinder", "capsule", "sphere", "mesh")
_ROUND = {"radius": _LENGTH, "length": _LENGTH}
_MOMENTS = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
#: The attributes of links and joints that hold numbers, by element.
NUMBERS: dict[str, dict[str, Numbers]] = {
    "origin": {"xyz": Numbers(3, "length"), "rpy": _THREE},
    "axis": {"xyz": _THREE},
    "limit": dict.fromkeys(("lower", "upper", "effort", "velocity"), _LIMIT),
    "mass": {"value": Numbers(1, "mass", positive=True)},
    "inertia": dict.fromkeys(_MOMENTS, _ONE),
    "mimic": {"multiplier": _ONE, "offset": _ONE},
    "dynamics": {"damping": _ONE, "friction": _ONE},
    "box": {"size": Numbers(3, "length", positive=True)},
    "cylinder": _ROUND,
    "capsule": _ROUND,
    "sphere": {"radius": _LENGTH},
    "mesh": {"scale": _THREE},
}


def _check(xml: ET.Element) -> list[str]:
    """Refuse what no parser should get; returns warnings."""
    warnings = []
    check_names(xml.findall("link"), "link")
    check_names(xml.findall("joint"), "joint")
    for part in (*xml.findall("link"), *xml.findall("joint")):
        for element in part.iter():
            check_numbers(element, NUMBERS.get(element.tag, {}))
            if element.tag == "axis" and part.get("type") != "fixed":
                check_numbers(element, {"xyz": Numbers(3, direction=True)})
            if element.tag == "inertia":
                warnings.append(negative_moment(element, map(element.get, _MOMENTS)))
    strange = check_schema(xml)
    check_circles(xml)
    return [*(line for line in warnings if line), *strange]


def _mimics(xml: ET.Element) -> list[tuple[str, Follower]]:
    found = []
    for joint in xml.findall("joint"):
        mimic = joint.find("mimic")
        if mimic is not None:
            (ratio,) = numbers_of(mimic.get("multiplier"), "1")
            (offset,) = numbers_of(mimic.get("offset"), "0")
            follower = Follower(leader=mimic.get("joint", ""), ratio=ratio, offset=offset)
            found.append((joint.get("name", ""), follower))
    return found


def _shapes(
    xml: ET.Element, tag: str, path: Path, package_dirs: Sequence[Path]
) -> tuple[tuple[Shape, ...], list[tuple[str, ET.Element]]]:
    """Visual or collision shapes; link and geometry of those that cannot be read."""
    shapes, unread = [], []
    for frame, X, part in _parts(xml, tag):
        kind: Any = part.tag
        mesh = find_mesh(part.get("filename", ""), path, package_dirs) if kind == "mesh" else None
        if kind not in SHAPES or (kind == "mesh" and mesh is None):
            unread.append((frame, part))
        else:
            size = _urdf_size(part)
            shapes.append(Shape(frame=frame, placement=X, kind=kind, size=size, mesh=mesh))
    return tuple(shapes), unread


def _why_unseen(frame: str, part: ET.Element) -> str:
    if part.tag != "mesh":
        return f"{frame}: <{part.tag}> is not read; known: {', '.join(SHAPES)}"
    uri = part.get("filename", "")
    where = "; see package_dirs" if uri.startswith("package:") else ""
    return f"{frame}: mesh {uri}: there is no such file{where}"


def _parts(xml: ET.Element, tag: str) -> Iterator[tuple[str, pin.SE3, ET.Element]]:
    """Link, pose in it and geometry of each part."""
    for link in xml.findall("link"):
        for part in link.findall(tag):
            geometry = part.find("geometry")
            if geometry is not None and len(geometry):
                yield link.get("name", ""), _origin(part.find("origin")), geometry[0]


def _urdf_size(part: ET.Element) -> tuple[float, ...]:
    if part.tag == "mesh":
        return numbers_of(part.get("scale"), "1 1 1")
    if part.tag == "box":
        return numbers_of(part.get("size"), "")
    if part.tag in ("cylinder", "capsule"):
        return numbers_of(part.get("radius"), "") + numbers_of(part.get("length"), "")
    return numbers_of(part.get("radius"), "") if part.tag == "sphere" else ()


def _origin(origin: ET.Element | None) -> pin.SE3:
    if origin is None:
        return pin.SE3.Identity()
    roll, pitch, yaw = numbers_of(origin.get("rpy"), "0 0 0")
    place = numbers_of(origin.get("xyz"), "0 0 0")
    return pin.SE3(pin.rpy.rpyToMatrix(roll, pitch, yaw), np.array(place))


def find_mesh(uri: str, urdf: Path, package_dirs: Sequence[Path]) -> Path | None:
    """The file at a mesh's URI, or None.

    Args:
        uri: ``package://NAME/PATH`` (or ``model://``), ``file://PATH`` or a path, relative to
            the URDF's folder.
        urdf: the file with the URI.
        package_dirs: folders of packages.
    """
    scheme, _, rest = uri.rpartition("://")
    folder = absolute(urdf).parent
    if scheme in ("package", "model"):
        package, _, inside = rest.partition("/")
        candidates = []
        for parent in (*package_dirs, folder, *folder.parents):
            candidates.append(parent / package / inside)
            if parent.name == package:
                candidates.append(parent / inside)
    else:
        candidates = [folder / rest]
    return next((file for file in candidates if os.path.isfile(file)), None)
