"""What the geoms and meshes of a MuJoCo file must hold.

pinocchio reads the numbers that a geom's size lacks from whatever was in memory, and gives up a
whole file for a geom or a mesh that it does not know.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Mapping
from pathlib import Path

from coopqp.errors import InvalidValueError, unknown_name
from coopqp.robot_files.mjcf_defaults import with_defaults
from coopqp.robot_files.xml import place_of

#: How many numbers the size of each kind of geom needs; of those with ``fromto`` one.
SIZES = {"sphere": 1, "capsule": 2, "cylinder": 2, "box": 3, "ellipsoid": 3, "plane": 0, "mesh": 0}
FROMTO = ("capsule", "cylinder", "box", "ellipsoid")


def check_geoms(xml: ET.Element) -> None:
    """Refuse geoms of which no body can be made.

    Args:
        xml: with all includes filled in.

    Raises:
        InvalidValueError: with file and line.
    """
    meshes = set()
    for mesh in xml.findall("asset/mesh"):
        if not (mesh.get("file") or (mesh.get("vertex") and mesh.get("name"))):
            raise InvalidValueError(f"{place_of(mesh)}: needs a file, or a name and vertices")
        meshes.add(mesh.get("name") or Path(mesh.get("file", "")).stem)
    for geom, given in with_defaults(xml, "geom"):
        if wrong := _wrong(given, meshes):
            raise InvalidValueError(f"{place_of(geom)} {wrong}")


def _wrong(given: Mapping[str, str], meshes: set[str]) -> str:
    """What is wrong with a geom; empty if nothing is."""
    kind = given.get("type", "sphere")
    if kind not in SIZES:
        return f"type: {unknown_name('type of geom', kind, SIZES)}"
    if "mesh" in given and given["mesh"] not in meshes:
        return f"mesh: {unknown_name('mesh', given['mesh'], meshes)}"
    if kind == "mesh" and "mesh" not in given:
        return "needs a mesh"
    if "fromto" in given and kind not in FROMTO:
        return f"fromto: is not for a {kind}; it is for {', '.join(FROMTO)}"
    needed = min(1, SIZES[kind]) if "fromto" in given else SIZES[kind]
    found = given.get("size", "").split()
    if len(found) < needed:  # also where MuJoCo would fit it to a mesh
        return f"size: found {len(found)} numbers, a {kind} needs {needed}"
    return ""
