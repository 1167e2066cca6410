"""What a URDF file may have, what its attributes must hold, and how its parts fit together.

Parsers ignore unknown names, read "a b c" as whatever was in memory, leave out links in a circle,
and report without lines. So all that is checked here, before any parser. Elements of simulators, of
ROS and of robot makers are ignored unless they are a known name misspelt.
"""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal
from xml.etree.ElementTree import Element

import numpy as np

from coopqp.base.errors import InvalidValueError, unknown_name
from coopqp.base.spec import FARTHEST
from coopqp.model.held_object import inertia_matrix
from coopqp.robot_files.xml import ALIKE, place_of


@dataclass(frozen=True)
class Known:
    """What an element may have.

    Attributes:
        attributes, required: names of those it may have; of those it must have.
        inside: entry of KNOWN for each element that it may contain; empty for those not read.
        lenient: "attributes", "elements" or both, where others pass unless they are known names
            misspelt: files of many makers have elements and attributes of their own.
    """

    attributes: str = ""
    inside: Mapping[str, str] = field(default_factory=dict)
    required: str = ""
    lenient: str = ""


def _check_known(element: Element, entry: str) -> None:
    """Check an element and its contents against an entry of KNOWN."""
    known = KNOWN[entry]
    names = known.attributes.split()
    for name in element.attrib:
        absent = [other for other in names if other not in element.attrib]
        if name not in names and _is_refused(name, absent, "attributes" in known.lenient):
            words = _nearest("attribute", name, names)
            raise InvalidValueError(f"{place_of(element)}: {words}")
    for name in known.required.split():
        if not element.get(name):
            raise InvalidValueError(f"{place_of(element)}: needs {name}")
    for child in element:
        inner = known.inside.get(child.tag)
        if inner:
            _check_known(child, inner)
        elif inner is None and _is_refused(child.tag, known.inside, "elements" in known.lenient):
            words = _nearest("element", child.tag, known.inside)
            raise InvalidValueError(f"{place_of(child)} in <{element.tag}>: {words}")


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


#: Largest plausible size of a number of each kind.
LARGEST = {"length": FARTHEST, "mass": 1e6, "other": 1e12, "limit": math.inf}
#: Rounding error of a principal moment [kg m2].
ROUNDING = 1e-6


@dataclass(frozen=True)
class Numbers:
    """What an attribute holds.

    Attributes:
        count: how many numbers.
        kind: lengths [m], masses [kg], limits, which may be infinite, or others.
        positive: whether none may be negative.
        direction: whether not all may be zero.
    """

    count: int
    kind: Literal["length", "mass", "other", "limit"] = "other"
    positive: bool = False
    direction: bool = False


def check_numbers(element: Element, attributes: Mapping[str, Numbers]) -> None:
    """Check those attributes of an element that hold numbers.

    Raises:
        InvalidValueError: with the element's place, what was found and what is needed.
    """
    for key, needs in attributes.items():
        text = element.get(key)
        if text is not None:
            wrong = _wrong(text, needs)
            if wrong:
                shown = text if len(text) <= 40 else text[:37] + "..."
                raise InvalidValueError(f"{place_of(element)} {key}: found '{shown}', {wrong}")


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


def negative_moment(element: Element, moments: Iterable[str | None]) -> str:
    """Warning about an inertia that is not positive semidefinite; empty of others.

    A principal moment above the sum of the others passes: many published robots have it.

    Args:
        element: for its place.
        moments: ixx ixy ixz iyy iyz izz as the file has them [kg m2]; what is missing is zero.
    """
    smallest, *_ = np.linalg.eigvalsh(inertia_matrix([float(m or 0.0) for m in moments]))
    if smallest >= -ROUNDING:
        return ""
    return f"{place_of(element)}: a principal moment is {smallest:.3g} kg m2; no body has that"


def check_names(elements: Iterable[Element], kind: str) -> None:
    """Refuse two elements of one kind with one name.

    Raises:
        InvalidValueError: with the place of the second.
    """
    taken = set[str]()
    for element in elements:
        name = element.get("name")
        if name is not None:
            if name in taken:
                raise InvalidValueError(
                    f"{place_of(element)}: another {kind} has this name already; rename one"
                )
            taken.add(name)


_BOTH = "attributes elements"
_ROUND = Known("radius length name", required="radius length")
_LINK = Known("link", required="link")
_INERTIA = "ixx ixy ixz iyy iyz izz"
KNOWN: dict[str, Known] = {
    "robot": Known(
        "name version",
        {"link": "link", "joint": "joint", "material": "", "gazebo": "", "transmission": ""},
        lenient=_BOTH,
    ),
    "link": Known(
        "name type",
        {"inertial": "inertial", "visual": "part", "collision": "part"},
        required="name",
        lenient=_BOTH,
    ),
    "joint": Known(
        "name type",
        {
            "parent": "end", "child": "end", "calibration": "", "safety_controller": "",
            **{tag: tag for tag in ("origin", "axis", "limit", "mimic", "dynamics")},
        },
        required="name type",
        lenient=_BOTH,
    ),
    "part": Known(
        "name", {"origin": "origin", "geometry": "geometry", "material": ""}, lenient=_BOTH
    ),
    "inertial": Known(
        "", {"origin": "origin", "mass": "mass", "inertia": "inertia"}, lenient="elements"
    ),
    "geometry": Known(
        "name",
        {kind: kind for kind in ("box", "cylinder", "capsule", "sphere", "mesh")},
        lenient=_BOTH,
    ),
    "origin": Known("xyz rpy"),
    "end": _LINK,
    "axis": Known("xyz", required="xyz"),
    "limit": Known(
        "lower upper effort velocity", required="effort velocity", lenient="attributes"
    ),
    "mimic": Known("joint multiplier offset", required="joint"),
    "dynamics": Known("damping friction", lenient="attributes"),
    "mass": Known("value", required="value"),
    "inertia": Known(_INERTIA, required=_INERTIA),
    "box": Known("size name", required="size"),
    "cylinder": _ROUND,
    "capsule": _ROUND,
    "sphere": Known("radius name", required="radius"),
    "mesh": Known("filename scale", required="filename", lenient="attributes"),
}  # fmt: skip
KINDS = ("revolute", "continuous", "prismatic", "fixed", "floating", "planar")
#: Words of MuJoCo files, and what URDF has for them.
OTHERWISE = {
    "hinge": "revolute",
    "slide": "prismatic",
    "free": "floating",
    "body": "link",
    "geom": "collision",
    "pos": "xyz",
    "euler": "rpy",
    "file": "filename",
}


def check_schema(xml: Element) -> list[str]:
    """Refuse what is misspelt or missing, and links and joints that are no tree.

    Returns warnings: some published robots have joints that follow none.

    Raises:
        InvalidValueError: with file and line.
    """
    _check_known(xml, "robot")
    for part in (*xml.findall("link/visual"), *xml.findall("link/collision")):
        if part.find("geometry/*") is None:
            raise InvalidValueError(f"{place_of(part)}: needs a <geometry> with a shape in it")
    for joint in xml.findall("joint"):
        if (kind := joint.get("type", "")) not in KINDS:
            raise InvalidValueError(f"{place_of(joint)} type: {_nearest('type', kind, KINDS)}")
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
        raise InvalidValueError(
            f"{place_of(joint)}: needs <limit lower= upper= effort= velocity=>{without}"
        )
    lower, upper = float(limit.get("lower", 0.0)), float(limit.get("upper", 0.0))
    if lower > upper:
        raise InvalidValueError(
            f"{place_of(limit)} of joint {joint.get('name')}: lower {lower:g} is above upper "
            f"{upper:g}; swap them"
        )


def _check_tree(xml: Element) -> None:
    """Every link but one is the child of exactly one joint."""
    links = {link.get("name", ""): link for link in xml.findall("link")}
    carried: dict[str, str] = {}
    for joint in xml.findall("joint"):
        _end(joint, "parent", links)
        child = _end(joint, "child", links)
        name, link = joint.get("name", ""), child.get("link", "")
        if link in carried:
            raise InvalidValueError(
                f"{place_of(child)} of joint {name}: link {link} is the child of joint "
                f"{carried[link]} already"
            )
        carried[link] = name
    roots = [link for link in links if link not in carried]
    if not roots:
        raise InvalidValueError(
            f"{place_of(next(iter(links.values())))}: every link is the child of a joint; one, the "
            "base, must be none"
        )
    for name in roots[1:]:
        raise InvalidValueError(
            f"{place_of(links[name])}: is the child of no joint, as is link {roots[0]}; only the "
            "base may be"
        )


def _end(joint: Element, tag: str, links: Collection[str]) -> Element:
    """A joint's <parent> or <child>."""
    end = joint.find(tag)
    if end is None:
        raise InvalidValueError(f"{place_of(joint)}: needs <{tag} link=>")
    if (link := end.get("link", "")) not in links:
        words = unknown_name("link", link, links)
        raise InvalidValueError(f"{place_of(end)} of joint {joint.get('name')}: {words}")
    return end


#: Joints between a link and the base; the parser in C++ crashes with some thousands.
LONGEST = 500


def check_circles(xml: Element) -> None:
    """Refuse links whose way to the base comes back to them.

    Raises:
        InvalidValueError: with the line.
    """
    moved_by = {_link(joint, "child"): joint for joint in xml.findall("joint")}
    joints_to: dict[str, int] = {}
    for first in moved_by:
        way, link = dict[str, None](), first
        while link in moved_by and link not in joints_to:
            if link in way:
                words = f"link '{link}' moves itself: the joints from it on go round in a circle"
                raise InvalidValueError(f"{place_of(moved_by[link])}: {words}")
            way[link] = None
            link = _link(moved_by[link], "parent")
        before = joints_to.get(link, 0)
        joints_to.update((link, before + i) for i, link in enumerate(reversed(way), 1))
        if joints_to[first] > LONGEST:
            words = f"more than {LONGEST} joints are between link '{first}' and the base"
            raise InvalidValueError(f"{place_of(moved_by[first])}: {words}")


def _link(joint: Element, tag: str) -> str:
    """Name of a joint's parent or child link."""
    end = joint.find(tag)
    return "" if end is None else end.get("link", "")


def told_place(xml: Element, words: Sequence[str]) -> str:
    """The place of the joint or link in brackets in a parser's message; else of the outermost one.

    Messages are such as "joint [elbow]: limit has no velocity".
    """
    named = {part.get("name"): part for tag in ("link", "joint") for part in xml.findall(tag)}
    for name in re.findall(r"\[(.*?)\]", "; ".join(words)):
        if name in named:
            return place_of(named[name])
    return place_of(xml)
