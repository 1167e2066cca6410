"""What a MuJoCo file may have, and what its attributes must hold."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from collections.abc import Iterator

from coopqp.base.errors import InvalidValueError, unknown_name
from coopqp.robot_files.attributes import (
    Numbers,
    check_names,
    check_numbers,
    check_word,
    negative_moment,
)
from coopqp.robot_files.mjcf_geoms import KINDS, check_geoms, check_ranges
from coopqp.robot_files.mjcf_schema import KNOWN, OTHERWISE
from coopqp.robot_files.schema import check_known
from coopqp.robot_files.xml import numbers_of, place_of

_ONE, _NOT_NEGATIVE = Numbers(1, 1), Numbers(1, 1, positive=True)
_PLACE = {
    "pos": Numbers(3, 3, "length"),
    "quat": Numbers(4, 4, direction=True),
    "axisangle": Numbers(4, 4),
    "xyaxes": Numbers(6, 6, direction=True),
    "zaxis": Numbers(3, 3, direction=True),
    "euler": Numbers(3, 3),
}
_FORM = {
    **_PLACE,
    "fromto": Numbers(6, 6, "length"),
    "size": Numbers(1, 3, "length", positive=True),
    "mass": Numbers(1, 1, "mass", positive=True),
    "density": Numbers(1, 1, positive=True),
}
#: The attributes that hold numbers, by element; defaults have the same ones.
NUMBERS: dict[str, dict[str, Numbers]] = {
    "body": {**_PLACE, "gravcomp": _ONE},
    "frame": _PLACE,
    "geom": _FORM,
    "site": _FORM,
    "joint": {
        "pos": Numbers(3, 3, "length"),
        "axis": Numbers(3, 3, direction=True),
        "range": Numbers(2, 2, "limit"),
        "actuatorfrcrange": Numbers(2, 2, "limit"),
        "ref": _ONE,
        "springref": _ONE,
        "stiffness": Numbers(1, 3),
        "damping": Numbers(1, 3),
        "armature": _NOT_NEGATIVE,
        "frictionloss": _NOT_NEGATIVE,
        "margin": _ONE,
        "polycoef": Numbers(1, 5),
    },
    "freejoint": {},
    "inertial": {
        **_PLACE,
        "mass": Numbers(1, 1, "mass", positive=True),
        "diaginertia": Numbers(3, 3, positive=True),
        "fullinertia": Numbers(6, 6),
    },
    "mesh": {
        "scale": Numbers(3, 3),
        "refpos": Numbers(3, 3),
        "refquat": Numbers(4, 4),
        "vertex": Numbers(12, 10**6, "length"),
    },
    "option": {"gravity": Numbers(3, 3), "timestep": _NOT_NEGATIVE},
}
WORDS = {
    ("joint", "type"): ("free", "ball", "slide", "hinge"),
    ("geom", "type"): KINDS,
    ("joint", "limited"): ("true", "false", "auto"),
    ("joint", "active"): ("true", "false"),
    ("compiler", "angle"): ("degree", "radian"),
    ("compiler", "coordinate"): ("local",),
    ("compiler", "autolimits"): ("true", "false"),
}
SEQUENCE = re.compile("[xyzXYZ]{3}")
#: Elements whose names are theirs alone among their like.
NAMED = ("body", "joint", "site", "geom")
#: What MuJoCo makes bodies and geoms of, and we do not.
NOT_READ = {
    "frame": "make it a <body> at the same place, which moves alike",
    "replicate": "write out what it repeats",
    "attach": "write out what it attaches, or include it",
    "composite": "take it out",
    "flexcomp": "take it out",
}


def check_schema(xml: ET.Element) -> None:
    """Refuse elements and attributes that MuJoCo does not know.

    Args:
        xml: with all includes filled in.

    Raises:
        InvalidValueError: with file and line.
    """
    check_known(xml, "mujoco", KNOWN, OTHERWISE)


def check(xml: ET.Element) -> None:
    """Refuse what no parser should make something of.

    Args:
        xml: the same, with one section of each name.

    Raises:
        InvalidValueError: with file and line.
    """
    for element in xml.iter():
        _check_one(element)
    world = xml.find("worldbody")
    if world is not None:
        for tag in NAMED:
            check_names(world.iter(tag), tag)
        _check_classes(xml, world)
        _check_ties(xml, world)
    check_geoms(xml)
    check_ranges(xml)


def _check_one(element: ET.Element) -> None:
    check_numbers(element, NUMBERS.get(element.tag, {}))
    for (tag, key), known in WORDS.items():
        if element.tag == tag:
            check_word(element, key, known, OTHERWISE)
    _check_needed(element)
    if element.tag in NOT_READ:
        raise InvalidValueError(f"{place_of(element)}: is not read; {NOT_READ[element.tag]}")
    full = element.get("fullinertia")
    if full and element.tag == "inertial":
        xx, yy, zz, xy, xz, yz = map(str, numbers_of(full, ""))
        if wrong := negative_moment(element, (xx, xy, xz, yy, yz, zz)):
            raise InvalidValueError(wrong)


def _check_needed(element: ET.Element) -> None:
    """Refuse what lacks a part, or has a word that stands for three."""
    if element.tag == "inertial" and element.get("mass") is None:
        raise InvalidValueError(f"{place_of(element)}: needs a mass")
    sequence = element.get("eulerseq", "xyz")
    if not SEQUENCE.fullmatch(sequence):
        words = f"found '{sequence[:40]}', needs three of x, y, z, X, Y and Z"
        raise InvalidValueError(f"{place_of(element)} eulerseq: {words}")
    for inner in element.findall("default") if element.tag == "default" else ():
        if not inner.get("class"):
            raise InvalidValueError(f"{place_of(inner)}: needs a class")


def _check_classes(xml: ET.Element, world: ET.Element) -> None:
    """Refuse classes that no default describes."""
    known = {"main", *_classes(xml)}
    for element in world.iter():
        for key in ("class", "childclass"):
            name = element.get(key)
            if name is not None and name not in known:
                words = unknown_name("class", name, known)
                raise InvalidValueError(f"{place_of(element)} {key}: {words}")


def _check_ties(xml: ET.Element, world: ET.Element) -> None:
    """Refuse equalities of joints that are not there."""
    joints = [joint.get("name", "") for joint in world.iter("joint")]
    for tie in xml.findall("equality/joint"):
        for key in ("joint1", "joint2"):
            name = tie.get(key)
            if name is not None and name not in joints:
                words = unknown_name("joint", name, joints)
                raise InvalidValueError(f"{place_of(tie)} {key}: {words}")


def _classes(xml: ET.Element) -> Iterator[str]:
    for outer in xml.findall("default"):
        for default in outer.iter("default"):
            yield default.get("class", "main")
