"""What MuJoCo asks of geoms and joints beyond numbers, with what their classes give them."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Collection, Mapping
from pathlib import Path

from coopqp.base.errors import InvalidValueError, unknown_name
from coopqp.robot_files.mjcf_defaults import Given, all_given
from coopqp.robot_files.xml import numbers_of, place_of

#: How many sizes above zero each kind of geom needs, and what they are.
SIZES = {
    "sphere": (1, "its radius"),
    "capsule": (2, "its radius and half its length"),
    "cylinder": (2, "its radius and half its length"),
    "ellipsoid": (3, "its radii"),
    "box": (3, "half its edges"),
}
#: Kinds of geoms that are not drawn and not watched: neither pinocchio nor coal has them.
NOT_READ = ("hfield", "sdf")
KINDS = (*SIZES, "plane", "mesh", *NOT_READ)
#: Kinds that may go from one point to another.
FROM_TO = ("capsule", "cylinder", "ellipsoid", "box")
NEAREST = 1e-9  # such points [m]


def mesh_names(xml: ET.Element) -> dict[str, ET.Element]:
    """The meshes of a file by name; one without a name is called as its file."""
    meshes = xml.findall("asset/mesh")
    return {mesh.get("name") or Path(mesh.get("file", "")).stem: mesh for mesh in meshes}


def check_geoms(xml: ET.Element) -> None:
    """Refuse geoms that MuJoCo refuses: a mesh that is none, sizes that are missing.

    Raises:
        InvalidValueError: with file and line.
    """
    meshes = mesh_names(xml)
    for mesh in meshes.values():
        if not (mesh.get("file") or mesh.get("vertex")):
            raise InvalidValueError(f"{place_of(mesh)}: needs a file, or vertices")
    for geom in all_given(xml, "geom"):
        wrong = _wrong_mesh(geom.attributes, meshes) or _wrong_size(geom.attributes)
        if wrong:
            raise InvalidValueError(f"{place_of(geom.element)} {wrong}")


def _wrong_mesh(given: Mapping[str, str], meshes: Collection[str]) -> str:
    mesh = given.get("mesh")
    if mesh is not None and mesh not in meshes:
        return f"mesh: {unknown_name('mesh', mesh, meshes)}"
    if mesh is None and given.get("type") in ("mesh", "sdf"):
        known = ", ".join(meshes) or "none, put one under <asset>"
        return f"type: is {given['type']}, but no mesh is named; add mesh, known: {known}"
    return ""


def _wrong_size(given: Mapping[str, str]) -> str:
    kind, ends = given.get("type", "sphere"), given.get("fromto")
    if ends is not None:
        if kind not in FROM_TO:
            return f"fromto: a {kind} has none; type must be one of {', '.join(FROM_TO)}"
        numbers = numbers_of(ends, "")
        if math.dist(numbers[:3], numbers[3:]) < NEAREST:
            return f"fromto: found '{ends}', needs two points apart"
    if "mesh" in given or kind not in SIZES:
        return ""  # fitted to the mesh
    count, what = (1, "its radius, or half its width") if ends else SIZES[kind]
    sizes = numbers_of(given.get("size"), "")
    if len(sizes) >= count and min(sizes[:count]) > 0.0:
        return ""
    found = f"found '{given['size']}'" if "size" in given else "is missing"
    return f"size: {found}; a {kind} needs {count} above 0, {what} [m]"


def check_ranges(xml: ET.Element) -> None:
    """Refuse ranges of joints whose lower end is above the upper one.

    Raises:
        InvalidValueError: with file and line.
    """
    for joint in all_given(xml, "joint"):
        given = joint.attributes
        lower, upper = numbers_of(given.get("range"), "0 0")
        if lower > upper and given.get("limited") != "false":
            raise InvalidValueError(
                f"{place_of(joint.element)} range: found '{given['range']}', needs the lower "
                "number first"
            )


def without_unread(xml: ET.Element) -> tuple[str, ...]:
    """Take geoms out that pinocchio does not read; returns what is not watched, a sentence each.

    Args:
        xml: with a name for every body.
    """
    meshes, unseen = mesh_names(xml), []
    for geom in all_given(xml, "geom"):
        why = _why_unseen(geom, meshes)
        if why and _collides(geom.attributes):
            unseen.append(f"{geom.body.get('name')}: {why}")
        if geom.attributes.get("type") in NOT_READ:
            geom.body.remove(geom.element)
    for asset in xml.findall("asset"):
        for hfield in asset.findall("hfield"):
            asset.remove(hfield)
    return tuple(unseen)


def _why_unseen(geom: Given, meshes: Mapping[str, ET.Element]) -> str:
    kind, name = geom.attributes.get("type", "sphere"), geom.attributes.get("mesh", "")
    if kind in NOT_READ:
        return f"a geom of type {kind} is not read"
    if kind == "mesh" and not meshes[name].get("file"):
        return f"mesh {name}: is given by vertices, which are not read; put them in a file"
    return ""


def _collides(given: Mapping[str, str]) -> bool:
    return given.get("contype") != "0" or given.get("conaffinity") != "0"
