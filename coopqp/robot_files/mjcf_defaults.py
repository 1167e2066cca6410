"""What the defaults of a MuJoCo file give to elements that do not say it themselves."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterator, Mapping
from dataclasses import dataclass


@dataclass(frozen=True)
class Given:
    """An element of a body.

    Attributes:
        element: as the file has it.
        body: in which it is; the world's is called worldbody.
        attributes: its own, and those that its class gives it.
    """

    element: ET.Element
    body: ET.Element
    attributes: Mapping[str, str]


def all_given(xml: ET.Element, tag: str) -> list[Given]:
    """All elements of the bodies that have a tag, with what their classes give them."""
    classes, usual = _classes(xml, tag)

    def search(body: ET.Element, childclass: str) -> Iterator[Given]:
        childclass = body.get("childclass", childclass)
        for child in body:
            if child.tag == tag:
                by_class = classes.get(child.get("class", childclass), {})
                yield Given(child, body, {**by_class, **child.attrib})
            elif child.tag == "body":
                yield from search(child, childclass)

    return [given for world in xml.findall("worldbody") for given in search(world, usual)]


def _classes(xml: ET.Element, tag: str) -> tuple[dict[str, dict[str, str]], str]:
    """What each class gives to elements of a tag, and the class of all that name none."""
    found: dict[str, dict[str, str]] = {}

    def read(default: ET.Element, name: str, inherited: Mapping[str, str]) -> None:
        found[name] = {**inherited}
        for part in default.findall(tag):
            found[name] |= part.attrib
        for child in default.findall("default"):
            read(child, child.get("class", ""), found[name])

    usual = "main"
    for default in xml.findall("default"):
        usual = default.get("class", usual)
        read(default, usual, {})
    return found, usual
