"""Elements and attributes of a URDF file, as far as it is read, and how its parts fit together.

Robots in the world carry elements of simulators, of ROS and of their makers; these are passed over
unless they are a known name misspelt.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Collection

from coopqp.base.errors import InvalidValueError, unknown_name
from coopqp.robot_files.attributes import check_word
from coopqp.robot_files.schema import Known, Unknown, check_known
from coopqp.robot_files.xml import place_of

_LIKE: Unknown = "refused if alike"
_PART = Known(
    "name",
    {"origin": "origin", "geometry": "geometry", "material": ""},
    attribute=_LIKE,
    element=_LIKE,
)
_ROUND = Known("radius length name", required="radius length")
_LINK = Known("link", required="link")
_INERTIA = "ixx ixy ixz iyy iyz izz"
KNOWN: dict[str, Known] = {
    "robot": Known(
        "name version",
        {"link": "link", "joint": "joint", "material": "", "gazebo": "", "transmission": ""},
        attribute=_LIKE,
        element=_LIKE,
    ),
    "link": Known(
        "name type",
        {"inertial": "inertial", "visual": "part", "collision": "part"},
        required="name",
        attribute=_LIKE,
        element=_LIKE,
    ),
    "joint": Known(
        "name type",
        {
            "origin": "origin",
            "parent": "end",
            "child": "end",
            "axis": "axis",
            "limit": "limit",
            "mimic": "mimic",
            "dynamics": "dynamics",
            "calibration": "",
            "safety_controller": "",
        },
        required="name type",
        attribute=_LIKE,
        element=_LIKE,
    ),
    "part": _PART,
    "inertial": Known(
        "", {"origin": "origin", "mass": "mass", "inertia": "inertia"}, element=_LIKE
    ),
    "geometry": Known(
        "name",
        {kind: kind for kind in ("box", "cylinder", "capsule", "sphere", "mesh")},
        attribute=_LIKE,
        element=_LIKE,
    ),
    "origin": Known("xyz rpy"),
    "end": _LINK,
    "axis": Known("xyz", required="xyz"),
    "limit": Known("lower upper effort velocity", required="effort velocity", attribute=_LIKE),
    "mimic": Known("joint multiplier offset", required="joint"),
    "dynamics": Known("damping friction", attribute=_LIKE),
    "mass": Known("value", required="value"),
    "inertia": Known(_INERTIA, required=_INERTIA),
    "box": Known("size name", required="size"),
    "cylinder": _ROUND,
    "capsule": _ROUND,
    "sphere": Known("radius name", required="radius"),
    "mesh": Known("filename scale", required="filename", attribute=_LIKE),
}
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


def check_schema(xml: ET.Element) -> list[str]:
    """Refuse what is misspelt or missing, and links and joints that are no tree.

    Returns what is only to be warned of: some published robots have joints that follow none.

    Raises:
        InvalidValueError: with file and line.
    """
    check_known(xml, "robot", KNOWN, OTHERWISE)
    for part in (*xml.findall("link/visual"), *xml.findall("link/collision")):
        if part.find("geometry/*") is None:
            raise InvalidValueError(f"{place_of(part)}: needs a <geometry> with a shape in it")
    for joint in xml.findall("joint"):
        check_word(joint, "type", KINDS, OTHERWISE)
        _check_limit(joint)
    _check_tree(xml)
    names = [joint.get("name", "") for joint in xml.findall("joint")]
    return [
        f"{place_of(mimic)}: {unknown_name('joint', leader, names)}; it is kept still"
        for mimic in xml.findall("joint/mimic")
        if (leader := mimic.get("joint", "")) not in names
    ]


def _check_limit(joint: ET.Element) -> None:
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


def _check_tree(xml: ET.Element) -> None:
    """Every link hangs on one other, but one."""
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


def _end(joint: ET.Element, tag: str, links: Collection[str]) -> ET.Element:
    """Where a joint says which link is before it, or after it."""
    end = joint.find(tag)
    if end is None:
        raise InvalidValueError(f"{place_of(joint)}: needs <{tag} link=>")
    if (link := end.get("link", "")) not in links:
        words = unknown_name("link", link, links)
        raise InvalidValueError(f"{place_of(end)} of joint {joint.get('name')}: {words}")
    return end
