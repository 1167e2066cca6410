"""Where the links and joints of a URDF file are no tree, told with the line that says so.

The parser in C++ says so as well, but without lines, and of some files nothing at all: links that
go round in a circle are left out without a word.
"""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from collections.abc import Sequence

from coopqp.base.errors import InvalidValueError
from coopqp.robot_files.xml import place_of

#: Joints between a link and the base; the parser in C++ dies of some thousands.
LONGEST = 500


def check_circles(xml: ET.Element) -> None:
    """Refuse links whose way to the base comes back to them.

    Raises:
        InvalidValueError: with the line.
    """
    moved_by = {_end(joint, "child"): joint for joint in xml.findall("joint")}
    joints_to: dict[str, int] = {}
    for first in moved_by:
        way, link = dict[str, None](), first
        while link in moved_by and link not in joints_to:
            if link in way:
                words = f"link '{link}' moves itself: the joints from it on go round in a circle"
                raise InvalidValueError(f"{place_of(moved_by[link])}: {words}")
            way[link] = None
            link = _end(moved_by[link], "parent")
        before = joints_to.get(link, 0)
        joints_to.update((link, before + i) for i, link in enumerate(reversed(way), 1))
        if joints_to[first] > LONGEST:
            words = f"more than {LONGEST} joints are between link '{first}' and the base"
            raise InvalidValueError(f"{place_of(moved_by[first])}: {words}")


def _end(joint: ET.Element, tag: str) -> str:
    """The link before or behind a joint."""
    end = joint.find(tag)
    return "" if end is None else end.get("link", "")


def told_place(xml: ET.Element, words: Sequence[str]) -> str:
    """The place of the first joint or link that the parser's words name in brackets; else the top.

    Args:
        xml: the file.
        words: such as "joint [elbow]: limit has no velocity".
    """
    named = {part.get("name"): part for tag in ("link", "joint") for part in xml.findall(tag)}
    for name in re.findall(r"\[(.*?)\]", "; ".join(words)):
        if name in named:
            return place_of(named[name])
    return place_of(xml)
