"""The attributes of MuJoCo elements with what their classes give them."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterator, Mapping

#: The class of all that name none.
MAIN = "main"


def with_defaults(xml: ET.Element, tag: str) -> Iterator[tuple[ET.Element, dict[str, str]]]:
    """Every element of a kind in the world, and its attributes with those of its class.

    A class has those of the class it is in; an element without one has that of the nearest body
    round it with a childclass.

    Args:
        xml: of the whole file; a class that it does not describe gives nothing.
        tag: such as "geom".
    """
    classes: dict[str, Mapping[str, str]] = {}
    for default in xml.findall("default"):
        _read(default, tag, default.get("class", MAIN), {}, classes)
    waiting = [(world, MAIN) for world in reversed(xml.findall("worldbody"))]
    while waiting:
        holder, childclass = waiting.pop()
        childclass = holder.get("childclass", childclass)
        for element in holder.findall(tag):
            given = classes.get(element.get("class", childclass), {})
            yield element, {**given, **element.attrib}
        waiting += [(child, childclass) for child in reversed(holder) if child.tag != tag]


def _read(
    default: ET.Element,
    tag: str,
    name: str,
    outer: Mapping[str, str],
    classes: dict[str, Mapping[str, str]],
) -> None:
    own = default.find(tag)
    classes[name] = {**outer, **(own.attrib if own is not None else {})}
    for inner in default.findall("default"):
        _read(inner, tag, inner.get("class", name), classes[name], classes)
