"""Which elements and attributes a kind of robot file knows.

Parsers pass over what they do not know, and another robot runs than the one that was meant: without
the geom in ``<geon>``, about another axis than that in ``axes=``.
"""

from __future__ import annotations

import difflib
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from typing import Literal
from xml.etree.ElementTree import Element

from coopqp.base.errors import InvalidValueError, unknown_name
from coopqp.robot_files.xml import place_of

#: Names that are as alike as these are one name misspelt: "axes" and "axis" have 0.75.
ALIKE = 0.75

#: What happens to a name that is not known.
Unknown = Literal["refused", "refused if alike"]


@dataclass(frozen=True)
class Known:
    """What an element may have.

    Attributes:
        attributes: their names.
        inside: of the elements in it, by name: which entry of the table describes them; empty for
            those that are not read, and so not looked at.
        required: attributes that it must have.
        attribute, element: what happens to others; files of many makers bring elements and
            attributes of their own, which are let pass unless they are known names misspelt.
    """

    attributes: str = ""
    inside: Mapping[str, str] = field(default_factory=dict)
    required: str = ""
    attribute: Unknown = "refused"
    element: Unknown = "refused"


def check_known(
    element: Element, entry: str, table: Mapping[str, Known], otherwise: Mapping[str, str]
) -> None:
    """Refuse what the table does not know, in an element and in all that is in it.

    Args:
        element: where to begin.
        entry: of the table that describes it.
        table: by entry.
        otherwise: words of other formats, and what this one has for them.

    Raises:
        InvalidValueError: with its line and the nearest known name.
    """
    known = table[entry]
    names = known.attributes.split()
    for name in element.attrib:
        absent = [other for other in names if other not in element.attrib]
        if name not in names and _is_refused(name, absent, known.attribute):
            words = nearest("attribute", name, names, otherwise)
            raise InvalidValueError(f"{place_of(element)}: {words}")
    for name in known.required.split():
        if not element.get(name):
            raise InvalidValueError(f"{place_of(element)}: needs {name}")
    for child in element:
        inner = known.inside.get(child.tag)
        if inner:
            check_known(child, inner, table, otherwise)
        elif inner is None and _is_refused(child.tag, known.inside, known.element):
            words = nearest("element", child.tag, known.inside, otherwise)
            raise InvalidValueError(f"{place_of(child)} in <{element.tag}>: {words}")


def _is_refused(name: str, known: Collection[str], unknown: Unknown) -> bool:
    if ":" in name:  # somebody's own, and said to be so
        return False
    alike = difflib.get_close_matches(name.lower(), known, cutoff=ALIKE)
    return unknown == "refused" or bool(alike)


def nearest(kind: str, name: str, known: Collection[str], otherwise: Mapping[str, str]) -> str:
    """Sentence for a name that is not known, with what it is called here or the nearest ones."""
    here = otherwise.get(name)
    if here in known:
        return f"unknown {kind} '{name}'; it is called '{here}' here"
    return unknown_name(kind, name, known)
