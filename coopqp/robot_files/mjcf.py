"""Reading MuJoCo files (MJCF).

pinocchio reads MJCF, but of several bodies in the world only the first, of several joints in a
body one composite, of bodies without a name nothing, and a slide's range as degrees. So it is
handed a plain copy of the file: includes filled in, every body and joint named, one body round the
whole world and one round each of its geoms, one joint to a body, keyframes left out, bodies that
are free in space fixed. A body with several joints keeps its name for the last of them.
"""

from __future__ import annotations

import copy
import tempfile
import xml.etree.ElementTree as ET
from functools import cache
from pathlib import Path

import numpy as np
import pinocchio as pin

from coopqp.base.errors import InvalidValueError
from coopqp.base.reading import absolute
from coopqp.robot_files.description import Description, Follower
from coopqp.robot_files.mjcf_attributes import check, check_schema
from coopqp.robot_files.mjcf_defaults import all_given
from coopqp.robot_files.mjcf_geoms import without_unread
from coopqp.robot_files.shapes import (
    hidden,
    read_collision_shapes,
    read_shapes,
    with_numbered_meshes,
)
from coopqp.robot_files.xml import (
    DEEPEST,
    MOST_ELEMENTS,
    numbers_of,
    pinocchio_says,
    place_of,
    places,
    read_xml,
)

#: Name of the body round the world; a slash keeps it apart from names in files.
WORLD = "world/"


def read_mjcf(path: Path) -> Description:
    """Read a MuJoCo file.

    Args:
        path: of the file.

    Raises:
        InvalidValueError: no such file, or not an MJCF file.
    """
    xml = read_xml(path, ["mujoco"], "MJCF")
    _Includes(absolute(path)).fill_in(xml)
    check_schema(xml)  # while every attribute has its own line
    _merge(xml)
    check(xml)
    _without_looks(xml)
    if not xml.findall("worldbody/body"):
        raise InvalidValueError(f"{place_of(xml)}: is not a robot: has no <body>")
    folder = _absolute_folders(xml, absolute(path).parent)
    floating = _prepare(xml)
    unseen = without_unread(xml)
    try:
        model, followers = _parsed(xml), _followers(xml)
    except Exception as error:  # noqa: BLE001 - pinocchio may raise anything
        raise InvalidValueError(
            f"{place_of(xml)}: is not a robot that can be read: {pinocchio_says(error)}"
        ) from None
    shapes, warnings = read_shapes(xml, model, folder, path.name)
    collide, lost = read_collision_shapes(xml, model, folder)
    return Description(
        name=xml.get("model") or path.stem,
        model=model,
        followers=followers,
        floating=floating,
        shapes=shapes,
        collision_shapes=collide,
        unseen=(*unseen, *lost),
        warnings=(*warnings, *hidden(collide, shapes, path.name)),
        places=places(xml.iter("joint")),
    )


def _parsed(xml: ET.Element) -> pin.Model:
    model = _pinocchio(with_numbered_meshes(xml))
    compiler = xml.find("compiler")
    in_degrees = compiler is None or compiler.get("angle", "degree") == "degree"
    lower, upper = np.array(model.lowerPositionLimit), np.array(model.upperPositionLimit)
    for kind in list(model.joints)[1:]:
        slides = "Prismatic" in kind.shortname() or kind.shortname()[-2:] in ("PX", "PY", "PZ")
        if slides and in_degrees:
            lower[kind.idx_q] /= _slide_scale()
            upper[kind.idx_q] /= _slide_scale()
    for name in _unlimited(xml):
        kind = model.joints[model.getJointId(name)]
        if kind.nq == 1:
            lower[kind.idx_q], upper[kind.idx_q] = -np.inf, np.inf
    model.lowerPositionLimit, model.upperPositionLimit = lower, upper
    return model


def _unlimited(xml: ET.Element) -> list[str]:
    """Joints whose range does not count: ``limited="false"``, their own or their class's."""
    return [
        joint.element.get("name", "")
        for joint in all_given(xml, "joint")
        if joint.attributes.get("limited") == "false"
    ]


@cache
def _slide_scale() -> float:
    """What pinocchio makes of a slide of 1 m when angles are in degrees: 4.1 takes it for one."""
    body = '<body name="a"><joint name="s" type="slide" axis="1 0 0" range="0 1"/></body>'
    xml = ET.fromstring(f"<mujoco><worldbody>{body}</worldbody></mujoco>")
    return float(_pinocchio(xml).upperPositionLimit[0])


def _pinocchio(xml: ET.Element) -> pin.Model:
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "robot.xml"
        ET.ElementTree(xml).write(file, encoding="utf-8")
        return pin.buildModelFromMJCF(str(file))


class _Includes:
    """Puts the files that are included where they are included.

    Args:
        path: of the outermost file.
    """

    def __init__(self, path: Path) -> None:
        self._folder, self._seen, self._left = path.parent, {path}, MOST_ELEMENTS

    def fill_in(self, element: ET.Element, depth: int = 0) -> None:
        """Put in all that an element, and what is in it, includes.

        Raises:
            InvalidValueError: a file cannot be read, or is included a second time; too much is.
        """
        if depth > DEEPEST:
            words = f"elements inside elements are more than {DEEPEST} deep"
            raise InvalidValueError(f"{place_of(element)}: {words}")
        children: list[ET.Element] = []
        for child in element:
            if child.tag == "include":
                children.extend(self._included(child, depth))
            else:
                self.fill_in(child, depth + 1)
                children.append(child)
        element[:] = children

    def _included(self, include: ET.Element, depth: int) -> ET.Element:
        path = absolute(self._folder / include.get("file", ""))
        if path in self._seen:  # as MuJoCo has it; else ten small files can be ten billion
            name = include.get("file")
            raise InvalidValueError(f"{place_of(include)}: file '{name}' is included already")
        self._seen.add(path)
        try:
            found = read_xml(path, ["mujocoinclude", "mujoco"], "MJCF")
        except InvalidValueError as error:
            raise InvalidValueError(f"{place_of(include)}: {error}") from None
        self._left -= sum(1 for _ in found.iter())
        if self._left < 0:
            words = f"what is included has more than {MOST_ELEMENTS} elements"
            raise InvalidValueError(f"{place_of(include)}: {words}")
        self.fill_in(found, depth)
        return found


def _merge(xml: ET.Element) -> None:
    """Make sections of one name one, as MuJoCo reads them."""
    first: dict[str, ET.Element] = {}
    for section in xml:
        same = first.setdefault(section.tag, section)
        if same is not section:
            same.attrib.update(section.attrib)
            same.extend(list(section))
    xml[:] = list(first.values())


def _without_looks(xml: ET.Element) -> None:
    """Take out colours, which nothing here shows, so that none can be wrong."""
    for asset in xml.findall("asset"):
        asset[:] = [part for part in asset if part.tag == "mesh"]
    for geom in xml.iter("geom"):
        geom.attrib.pop("material", None)


def _absolute_folders(xml: ET.Element, folder: Path) -> Path:
    """Make the folder of the meshes absolute, since the copy lies elsewhere; returns it."""
    compiler = xml.find("compiler")
    if compiler is None:
        compiler = ET.Element("compiler")
        xml.insert(0, compiler)
    meshes = folder / (compiler.get("meshdir") or compiler.get("assetdir") or "")
    compiler.set("meshdir", str(meshes))
    return meshes


def _prepare(xml: ET.Element) -> dict[str, frozenset[str]]:
    """Turn the world into one tree that pinocchio reads; returns the floating joints."""
    for keyframe in xml.findall("keyframe"):
        xml.remove(keyframe)
    world = xml.find("worldbody")
    assert world is not None  # it has bodies
    _name_all(world)
    _bodies_of_geoms(world)
    floating = _without_floating(world)
    for parent in reversed(list(world.iter())):  # inside before outside
        for i, body in enumerate(list(parent)):
            if body.tag == "body":
                parent[i] = _one_joint_each(body)
    everything = ET.Element("body", {"name": WORLD})
    everything.extend(list(world))
    world[:] = [everything]
    return floating


def _name_all(world: ET.Element) -> None:
    """Name bodies and joints that have no name, after their place in the file."""
    for i, body in enumerate(world.iter("body")):
        body.set("name", body.get("name") or f"body_{i + 1}")
        for k, joint in enumerate(_joints(body)):
            joint.set("name", joint.get("name") or f"{body.get('name')}_joint_{k + 1}")


def _bodies_of_geoms(world: ET.Element) -> None:
    """Put each geom of the world into a body with its name, so that limits can name it."""
    taken = {element.get("name") for element in world.iter() if element not in list(world)}
    taken |= {child.get("name") for child in world if child.tag != "geom"}
    for i, geom in enumerate(list(world)):
        if geom.tag == "geom":
            name = geom.get("name") or f"geom_{i + 1}"
            body = ET.Element("body", {"name": f"{WORLD}{name}" if name in taken else name})
            body.append(geom)
            world[i] = body


def _joints(body: ET.Element) -> list[ET.Element]:
    return [child for child in body if child.tag in ("joint", "freejoint")]


def _without_floating(world: ET.Element) -> dict[str, frozenset[str]]:
    """Fix floating bodies where the file puts them; returns what each of their joints moves."""
    floating: dict[str, frozenset[str]] = {}
    for body in world.iter("body"):
        for joint in _joints(body):
            if joint.tag == "freejoint" or joint.get("type") == "free":
                moved = [e.get("name", "") for e in body.iter() if e.tag != "geom"]
                floating[joint.get("name", "")] = frozenset(moved)
                body.remove(joint)
    return floating


def _one_joint_each(body: ET.Element) -> ET.Element:
    """The body, with one body round it for every joint but the last."""
    others = _joints(body)[:-1]
    if not others:
        return body
    inner = copy.copy(body)
    inner.attrib = {k: v for k, v in body.attrib.items() if k in ("name", "childclass")}
    outermost = ET.Element("body", {k: v for k, v in body.attrib.items() if k != "name"})
    outer = outermost
    for i, joint in enumerate(others):
        if i:
            outer = ET.SubElement(outer, "body")
        outer.set("name", f"{body.get('name')}/{joint.get('name')}")
        outer.append(joint)
        inner.remove(joint)
    outer.append(inner)
    return outermost


def _followers(xml: ET.Element) -> dict[str, Follower]:
    """Joints that an equality ties to another one."""
    followers = {}
    for tie in xml.findall("equality/joint"):
        if tie.get("active", "true") == "false":
            continue
        polynomial = (*numbers_of(tie.get("polycoef"), "0 1 0 0 0"), 0.0, 0.0)
        followers[tie.get("joint1", "")] = Follower(
            leader=tie.get("joint2", ""), ratio=polynomial[1], offset=polynomial[0]
        )
    return followers
