"""Reading URDF files: joints by pinocchio, shapes and mimic joints from the XML.

Parsers ignore unknown names, read "a b c" as whatever was in memory, leave out links in a circle,
and report without lines. So all that is checked here, before any parser: what elements may have,
what their attributes must hold, and how links and joints fit together. Elements of simulators, of
ROS and of robot makers are ignored unless they are a known name misspelt.
"""

import difflib
import math
import os
import re
import xml.etree.ElementTree as ET
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal
from xml.etree.ElementTree import Element

import numpy as np
import pinocchio as pin

from coopqp.base.errors import InvalidValueError, unknown_name
from coopqp.base.reading import absolute
from coopqp.base.spec import FARTHEST
from coopqp.model.grasp_configuration import inertia_matrix
from coopqp.robot import Shape
from coopqp.robot_files.selection import Description, Follower
from coopqp.robot_files.xml import (
    ALIKE,
    fault,
    missing_meshes,
    numbers_of,
    pinocchio_says,
    place_of,
    read_xml,
    stderr_lines,
)


def read_urdf(path: Path, package_dirs: Sequence[Path] = ()) -> Description:
    """Read a URDF file; meshes are looked for, but not read.

    ``package_dirs`` are folders of ``package://`` packages, besides those above the file.
    InvalidValueError: no such file, or not a URDF file.
    """
    xml = read_xml(path, ["robot"], "URDF")
    for element in xml.iter():
        if "xacro" in element.tag:
            raise fault(element, "is a xacro file; make a URDF of it first: xacro FILE")
    if xml.find("link") is None:
        raise fault(xml, "is not a URDF file: has no <link>")
    impossible = _check(xml)
    printed: list[str] = []
    try:
        with stderr_lines(printed):
            model = pin.buildModelFromXML(ET.tostring(xml, encoding="unicode"))
    except Exception as error:  # noqa: BLE001 - pinocchio may raise anything
        why = printed or [pinocchio_says(error)]
        raise InvalidValueError(
            f"{_place_named(xml, why)}: is not a robot that can be read: {'; '.join(why)}"
        ) from None
    shapes, undrawn = _shapes(xml, "visual", path, package_dirs)
    collide, unread = _shapes(xml, "collision", path, package_dirs)
    missing = [part.get("filename", "") for _, part in undrawn if part.tag == "mesh"]
    meshes = sum(shape.kind == "mesh" for shape in shapes) + len(missing)
    placed = ((x.get("name", ""), getattr(x, "place", "")) for x in xml.findall("joint"))
    warnings = [*impossible, *(f"{path.name}: {line}" for line in printed)]
    return Description(
        name=xml.get("name") or path.stem,
        model=model,
        followers=dict(_mimics(xml)),
        shapes=shapes,
        collision_shapes=collide,
        unseen=tuple(_why_unseen(frame, part) for frame, part in unread),
        places={name: place for name, place in placed if place},
        warnings=(*warnings, *missing_meshes(path.name, missing, meshes)),
    )


#: Largest plausible size of a number of each kind.
LARGEST = {"length": FARTHEST, "mass": 1e6, "other": 1e12, "limit": math.inf}


@dataclass(frozen=True)
class Numbers:
    """What an attribute holds."""

    count: int  # how many numbers
    # lengths [m], masses [kg], limits, which may be infinite, or others
    kind: Literal["length", "mass", "other", "limit"] = "other"
    positive: bool = False  # whether none may be negative
    direction: bool = False  # whether not all may be zero


@dataclass(frozen=True)
class Known:
    """What an element may have."""

    attributes: str = ""  # names of those that it may have, but for ``numbers``
    # entry of KNOWN for each element that it may contain; empty for those not read
    inside: Mapping[str, str] = field(default_factory=dict)
    numbers: Mapping[str, Numbers] = field(default_factory=dict)  # the attributes that hold numbers
    required: str = ""  # names of those that it must have
    # "attributes", "elements" or both, where others pass unless they are known names misspelt:
    # files of many makers have elements and attributes of their own
    lenient: str = ""


def _check_known(element: Element, entry: str) -> None:
    known = KNOWN[entry]
    names = [*known.attributes.split(), *known.numbers]
    for name in element.attrib:
        absent = [other for other in names if other not in element.attrib]
        if name not in names and _is_refused(name, absent, "attributes" in known.lenient):
            raise fault(element, _nearest("attribute", name, names))
    for name in known.required.split():
        if not element.get(name):
            raise fault(element, f"needs {name}")
    for child in element:
        inner = known.inside.get(child.tag)
        if inner:
            _check_known(child, inner)
        elif inner is None and _is_refused(child.tag, known.inside, "elements" in known.lenient):
            words = _nearest("element", child.tag, known.inside)
            raise fault(child, words, f"in <{element.tag}>")


def _is_refused(name: str, known: Collection[str], lenient: bool) -> bool:
    if ":" in name:  # of another namespace
        return False
    return not lenient or bool(difflib.get_close_matches(name.lower(), known, cutoff=ALIKE))


def _nearest(kind: str, name: str, known: Collection[str]) -> str:
    """Sentence for an unknown name, with its name here or the nearest ones."""
    here = OTHERWISE.get(name)
    if here in known:
        return f"unknown {kind} '{name}'; it is called '{here}' here"
    return unknown_name(kind, name, known)


def _check_numbers(element: Element, attributes: Mapping[str, Numbers]) -> None:
    for key, needs in attributes.items():
        text = element.get(key)
        if text is not None and (wrong := _wrong(text, needs)):
            shown = text if len(text) <= 40 else text[:37] + "..."
            raise fault(element, f"found '{shown}', {wrong}", key)


def _wrong(text: str, needs: Numbers) -> str:
    """What is wrong with the numbers of an attribute; empty if nothing is."""
    try:
        values = [float(word) for word in text.split()]
    except ValueError:
        values = []
    if len(values) != needs.count:
        return f"needs {needs.count} numbers" if needs.count > 1 else "needs a number"
    largest = LARGEST[needs.kind]
    if any(math.isnan(value) or (math.isinf(value) and needs.kind != "limit") for value in values):
        return "needs finite numbers"
    if any(abs(value) > largest for value in values):
        return f"needs sizes of at most {largest:g}"
    if needs.positive and min(values) < 0.0:
        return "needs no negative number"
    if needs.direction and math.hypot(*values) < 1e-9:
        return "needs a direction, but all numbers are zero"
    return ""


def _negative_moment(element: Element) -> str:
    """Warning about a negative moment; one above the others' sum passes, as many robots have it."""
    moments = [float(element.get(name) or 0.0) for name in _MOMENTS]
    smallest, *_ = np.linalg.eigvalsh(inertia_matrix(moments))
    if smallest >= -ROUNDING:
        return ""
    return f"{place_of(element)}: a principal moment is {smallest:.3g} kg m2; no body has that"


_MOMENTS = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
#: Geometries that are read, and the attributes of their sizes.
SIZES = {
    "box": ("size",),
    "cylinder": ("radius", "length"),
    "capsule": ("radius", "length"),
    "sphere": ("radius",),
    "mesh": ("scale",),
}
_BOTH = "attributes elements"
_ONE, _THREE = Numbers(1), Numbers(3)
_LENGTH, _LIMIT = Numbers(1, "length", positive=True), Numbers(1, "limit")
_ROUND = Known("name", required="radius length", numbers={"radius": _LENGTH, "length": _LENGTH})
KNOWN: dict[str, Known] = {
    "robot": Known("name version", lenient=_BOTH, inside={
        "link": "link", "joint": "joint", "material": "", "gazebo": "", "transmission": "",
    }),
    "link": Known("name type", required="name", lenient=_BOTH, inside={
        "inertial": "inertial", "visual": "part", "collision": "part",
    }),
    "joint": Known("name type", required="name type", lenient=_BOTH, inside={
        "parent": "end", "child": "end", "calibration": "", "safety_controller": "",
        **{tag: tag for tag in ("origin", "axis", "limit", "mimic", "dynamics")},
    }),
    "part": Known("name", lenient=_BOTH, inside={
        "origin": "origin", "geometry": "geometry", "material": "",
    }),
    "inertial": Known(lenient="elements", inside={
        "origin": "origin", "mass": "mass", "inertia": "inertia",
    }),
    "geometry": Known("name", {kind: kind for kind in SIZES}, lenient=_BOTH),
    "origin": Known(numbers={"xyz": Numbers(3, "length"), "rpy": _THREE}),
    "end": Known("link", required="link"),
    "axis": Known(required="xyz", numbers={"xyz": _THREE}),
    "limit": Known(required="effort velocity", lenient="attributes", numbers=dict.fromkeys(
        ("lower", "upper", "effort", "velocity"), _LIMIT,
    )),
    "mimic": Known("joint", required="joint", numbers={"multiplier": _ONE, "offset": _ONE}),
    "dynamics": Known(numbers={"damping": _ONE, "friction": _ONE}, lenient="attributes"),
    "mass": Known(required="value", numbers={"value": Numbers(1, "mass", positive=True)}),
    "inertia": Known(required=" ".join(_MOMENTS), numbers=dict.fromkeys(_MOMENTS, _ONE)),
    "box": Known("name", required="size", numbers={"size": Numbers(3, "length", positive=True)}),
    "cylinder": _ROUND,
    "capsule": _ROUND,
    "sphere": Known("name", required="radius", numbers={"radius": _LENGTH}),
    "mesh": Known("filename", required="filename", lenient="attributes", numbers={"scale": _THREE}),
}  # fmt: skip
ROUNDING = 1e-6  # rounding error of a principal moment [kg m2]
KINDS = ("revolute", "continuous", "prismatic", "fixed", "floating", "planar")
#: Words of MuJoCo files, and what URDF has for them.
OTHERWISE = {
    "hinge": "revolute", "slide": "prismatic", "free": "floating", "body": "link",
    "geom": "collision", "pos": "xyz", "euler": "rpy", "file": "filename",
}  # fmt: skip


def _check_schema(xml: Element) -> list[str]:
    """Refuse what is misspelt, missing, or no tree; warnings of what follows no joint."""
    _check_known(xml, "robot")
    for part in (*xml.findall("link/visual"), *xml.findall("link/collision")):
        if part.find("geometry/*") is None:
            raise fault(part, "needs a <geometry> with a shape in it")
    for joint in xml.findall("joint"):
        if (kind := joint.get("type", "")) not in KINDS:
            raise fault(joint, _nearest("type", kind, KINDS), "type")
        _check_limit(joint)
    _check_tree(xml)
    names = [joint.get("name", "") for joint in xml.findall("joint")]
    return [
        f"{place_of(mimic)}: {unknown_name('joint', leader, names)}; it is kept still"
        for mimic in xml.findall("joint/mimic")
        if (leader := mimic.get("joint", "")) not in names
    ]


def _check_limit(joint: Element) -> None:
    kind, limit = joint.get("type"), joint.find("limit")
    if kind not in ("revolute", "prismatic"):
        return
    if limit is None:
        without = " or type 'continuous'" if kind == "revolute" else ""
        raise fault(joint, f"needs <limit lower= upper= effort= velocity=>{without}")
    lower, upper = float(limit.get("lower", 0.0)), float(limit.get("upper", 0.0))
    if lower > upper:
        words = f"lower {lower:g} is above upper {upper:g}; swap them"
        raise fault(limit, words, f"of joint {joint.get('name')}")


def _check_tree(xml: Element) -> None:
    """Every link but one is the child of exactly one joint."""
    links = {link.get("name", ""): link for link in xml.findall("link")}
    moved_by, parents = dict[str, Element](), dict[str, str]()
    for joint in xml.findall("joint"):
        parent, child = _end(joint, "parent", links), _end(joint, "child", links)
        link = child.get("link", "")
        if link in moved_by:
            words = f"link {link} is the child of joint {moved_by[link].get('name')} already"
            raise fault(child, words, f"of joint {joint.get('name')}")
        moved_by[link], parents[link] = joint, parent.get("link", "")
    roots = [link for link in links if link not in moved_by]
    if not roots:
        words = "every link is the child of a joint; one, the base, must be none"
        raise fault(next(iter(links.values())), words)
    for name in roots[1:]:
        words = f"is the child of no joint, as is link {roots[0]}; only the base may be"
        raise fault(links[name], words)
    _check_circles(moved_by, parents)


def _end(joint: Element, tag: str, links: Collection[str]) -> Element:
    end = joint.find(tag)
    if end is None:
        raise fault(joint, f"needs <{tag} link=>")
    if (link := end.get("link", "")) not in links:
        raise fault(end, unknown_name("link", link, links), f"of joint {joint.get('name')}")
    return end


LONGEST = 500  # joints between a link and the base; the parser in C++ crashes with some thousands


def _check_circles(moved_by: Mapping[str, Element], parents: Mapping[str, str]) -> None:
    """Refuse links whose way to the base comes back to them."""
    joints_to = dict.fromkeys(set(parents.values()) - set(moved_by), 0)
    for first in moved_by:
        way, link = dict[str, None](), first
        while link not in joints_to:
            if link in way:
                words = f"link '{link}' moves itself: the joints from it on go round in a circle"
                raise fault(moved_by[link], words)
            way[link], link = None, parents[link]
        for link in reversed(way):
            joints_to[link] = joints_to[parents[link]] + 1
        if joints_to[first] > LONGEST:
            words = f"more than {LONGEST} joints are between link '{first}' and the base"
            raise fault(moved_by[first], words)


def _place_named(xml: Element, messages: Sequence[str]) -> str:
    """Of the part in brackets, as in "joint [elbow]: limit has no velocity"; else of the whole."""
    named = {part.get("name"): part for tag in ("link", "joint") for part in xml.findall(tag)}
    for name in re.findall(r"\[(.*?)\]", "; ".join(messages)):
        if name in named:
            return place_of(named[name])
    return place_of(xml)


def _check(xml: Element) -> list[str]:
    """Refuse what no parser should get; returns warnings."""
    warnings, links, joints = [], xml.findall("link"), xml.findall("joint")
    for parts in (links, joints):
        taken = set[str | None]()
        for part in parts:
            name = part.get("name")
            if name in taken:
                words = f"another {part.tag} has this name already; rename one"
                raise fault(part, words)
            taken |= {name} - {None}
    for part in (*links, *joints):
        for element in part.iter():
            _check_numbers(element, KNOWN.get(element.tag, Known()).numbers)
            if element.tag == "axis" and part.get("type") != "fixed":
                _check_numbers(element, {"xyz": Numbers(3, direction=True)})
            if element.tag == "inertia":
                warnings.append(_negative_moment(element))
    return [*filter(None, warnings), *_check_schema(xml)]


def _mimics(xml: Element) -> Iterator[tuple[str, Follower]]:
    for joint in xml.findall("joint[mimic]"):
        mimic = joint.find("mimic")
        assert mimic is not None
        (ratio,) = numbers_of(mimic.get("multiplier"), "1")
        (offset,) = numbers_of(mimic.get("offset"), "0")
        leader = mimic.get("joint", "")
        yield joint.get("name", ""), Follower(leader=leader, ratio=ratio, offset=offset)


def _shapes(
    xml: Element, tag: str, path: Path, package_dirs: Sequence[Path]
) -> tuple[tuple[Shape, ...], list[tuple[str, Element]]]:
    """Visual or collision shapes; link and geometry of those that cannot be read."""
    shapes, unread = [], []
    for link in xml.findall("link"):
        frame = link.get("name", "")
        for whole in link.findall(tag):
            part = whole.find("geometry/*")
            assert part is not None  # which was checked
            kind: Any = part.tag
            file = part.get("filename", "")
            mesh = find_mesh(file, path, package_dirs) if kind == "mesh" else None
            if kind not in SIZES or (kind == "mesh" and mesh is None):
                unread.append((frame, part))
                continue
            X = _pose(whole.find("origin"))
            size = numbers_of(" ".join(part.get(key, "") for key in SIZES[kind]), "1 1 1")
            shapes.append(Shape(frame=frame, placement=X, kind=kind, size=size, mesh=mesh))
    return tuple(shapes), unread


def _why_unseen(frame: str, part: Element) -> str:
    if part.tag != "mesh":
        return f"{frame}: <{part.tag}> is not read; known: {', '.join(SIZES)}"
    uri = part.get("filename", "")
    where = "; see package_dirs" if uri.startswith("package:") else ""
    return f"{frame}: mesh {uri}: there is no such file{where}"


def _pose(origin: Element | None) -> pin.SE3:
    if origin is None:
        return pin.SE3.Identity()
    roll, pitch, yaw = numbers_of(origin.get("rpy"), "0 0 0")
    place = numbers_of(origin.get("xyz"), "0 0 0")
    return pin.SE3(pin.rpy.rpyToMatrix(roll, pitch, yaw), np.array(place))


def find_mesh(uri: str, urdf: Path, package_dirs: Sequence[Path]) -> Path | None:
    """The file at the URI of a mesh in a URDF file, or None.

    It is ``package://NAME/PATH`` (or ``model://``), of folders of packages, ``file://PATH`` or a
    path, relative to the URDF's folder.
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
