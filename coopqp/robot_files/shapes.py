"""What the bodies of a MuJoCo file look like, and what of them must not hit others.

pinocchio places the geoms, since it knows defaults, classes and fromto. Meshes take time to read
and matter only when drawn, so that it is handed one triangle for each, in a file that is named by
the mesh's number. Left out are planes; drawn are no geoms that only collide (group above 2).
"""

from __future__ import annotations

import copy
import os
import tempfile
import xml.etree.ElementTree as ET
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import coal
import pinocchio as pin

from coopqp.robot import Shape
from coopqp.robot_files.xml import missing_meshes, pinocchio_says

MESH_FILES = "asset/mesh[@file]"
TRIANGLE, SUFFIX = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", ".obj"

#: Of coal's geometries: kind and size as a shape has them.
SIZES: dict[type, tuple[Any, Callable[[Any], Sequence[float]]]] = {
    coal.Box: ("box", lambda box: 2.0 * box.halfSide),
    coal.Sphere: ("sphere", lambda sphere: (sphere.radius,)),
    coal.Ellipsoid: ("ellipsoid", lambda ellipsoid: ellipsoid.radii),
    coal.Capsule: ("capsule", lambda capsule: (capsule.radius, 2.0 * capsule.halfLength)),
    coal.Cylinder: ("cylinder", lambda cylinder: (cylinder.radius, 2.0 * cylinder.halfLength)),
}


def read_shapes(
    xml: ET.Element, model: pin.Model, folder: Path, source: str
) -> tuple[tuple[Shape, ...], tuple[str, ...]]:
    """Shapes of the bodies, and warnings about those that cannot be drawn.

    Args:
        xml: as pinocchio reads it.
        model: made of it.
        folder: of the meshes.
        source: name of the file, for warnings.
    """
    meshes = xml.findall("asset/mesh")
    names = [mesh.get("file", "") for mesh in xml.findall(MESH_FILES)]
    files = [folder / name for name in names]
    missing = [name for name, file in zip(names, files, strict=True) if not os.path.isfile(file)]
    missing += [f"{mesh.get('name')}, of vertices" for mesh in meshes if not mesh.get("file")]
    warnings = missing_meshes(source, missing, len(meshes))
    try:
        geoms = _placed(xml, model, pin.GeometryType.VISUAL)
    except (ValueError, RuntimeError) as error:
        why = pinocchio_says(error)
        return (), (
            *warnings,
            f"{source}: geoms cannot be read, links are drawn as capsules: {why}",
        )
    shapes = [_shape(geom, model.frames[geom.parentFrame], files) for geom in geoms]
    return tuple(s for s in shapes if s and _is_there(s)), warnings


def read_collision_shapes(
    xml: ET.Element, model: pin.Model, folder: Path
) -> tuple[tuple[Shape, ...], tuple[str, ...]]:
    """What must not hit others, and what cannot be had of it, a sentence each.

    A mesh whose file is not there stays a shape, to be told of.

    Args:
        xml: as pinocchio reads it.
        model: made of it.
        folder: of the meshes.
    """
    files = [folder / mesh.get("file", "") for mesh in xml.findall(MESH_FILES)]
    try:
        geoms = _placed(xml, model, pin.GeometryType.COLLISION)
    except (ValueError, RuntimeError) as error:
        return (), (f"all bodies: {pinocchio_says(error)}",)
    shapes = [_shape(geom, model.frames[geom.parentFrame], files) for geom in geoms]
    return tuple(shape for shape in shapes if shape), ()


def hidden(collide: Sequence[Shape], drawn: Sequence[Shape], source: str) -> tuple[str, ...]:
    """The warning about bodies all of whose geoms are of groups that are not drawn, if any are.

    Args:
        collide: what must not hit others.
        drawn: what the bodies look like.
        source: name of the file.
    """
    seen = {shape.frame for shape in drawn}
    frames = dict.fromkeys(shape.frame for shape in collide if _is_there(shape))
    names = [frame for frame in frames if frame not in seen]
    if not names:
        return ()
    shown = ", ".join(names[:3]) + (", ..." if len(names) > 3 else "")
    return (
        f"{source}: {len(names)} bodies are not drawn as they are, since all their geoms are of "
        f"groups above 2 ({shown})",
    )


def with_numbered_meshes(xml: ET.Element) -> ET.Element:
    """A copy in which meshes have their numbers as files, of which none can be wrong."""
    plain = copy.deepcopy(xml)
    for i, mesh in enumerate(plain.findall(MESH_FILES)):
        mesh.set("name", mesh.get("name") or Path(mesh.get("file", "")).stem)
        mesh.set("file", f"{i}{SUFFIX}")
    return plain


def _is_there(shape: Shape) -> bool:
    return shape.mesh is None or os.path.isfile(shape.mesh)


def _placed(xml: ET.Element, model: pin.Model, kind: pin.GeometryType) -> list[Any]:
    """The geoms as pinocchio has them, with a triangle for each mesh."""
    plain = with_numbered_meshes(xml)
    with tempfile.TemporaryDirectory() as folder:
        for mesh in plain.findall(MESH_FILES):
            (Path(folder) / mesh.get("file", "")).write_text(TRIANGLE, encoding="utf-8")
        for compiler in plain.findall("compiler"):
            compiler.set("meshdir", folder)
        file = Path(folder) / "robot.xml"
        ET.ElementTree(plain).write(file, encoding="utf-8")
        geometry = pin.buildGeomFromMJCF(model, str(file), kind)
        return list(geometry.geometryObjects)


def _shape(geom: Any, frame: pin.Frame, files: Sequence[Path]) -> Shape | None:
    """As Shape has it; nothing for a plane, or a mesh that is in no file."""
    mesh = None
    if type(geom.geometry) in SIZES:
        kind, size_of = SIZES[type(geom.geometry)]
        size = size_of(geom.geometry)
    else:
        kind, size = "mesh", geom.meshScale
        mesh = files[int(Path(geom.meshPath).stem)] if geom.meshPath.endswith(SUFFIX) else None
        if mesh is None:
            return None
    return Shape(
        frame=frame.name,
        placement=frame.placement.actInv(geom.placement),
        kind=kind,
        size=tuple(float(number) for number in size),
        mesh=mesh,
    )
