"""What the attributes of a robot file must hold, before any parser makes something of them.

Parsers in C++ read "a b c" as whatever was in memory. So every number is looked at here: that it is
one, that there are as many as needed, and that a body can have it.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from typing import Literal
from xml.etree.ElementTree import Element

import numpy as np

from coopqp.base.errors import InvalidValueError
from coopqp.base.spec import FARTHEST
from coopqp.model.held_object import inertia_matrix
from coopqp.robot_files.schema import nearest
from coopqp.robot_files.xml import place_of

#: Largest size of a number of each kind; what is beyond it nobody has built.
LARGEST = {"length": FARTHEST, "mass": 1e6, "other": 1e12, "limit": math.inf}
#: What rounding may make a principal moment negative by [kg m2].
ROUNDING = 1e-6


@dataclass(frozen=True)
class Numbers:
    """What an attribute holds.

    Attributes:
        least, most: how many numbers.
        kind: lengths [m], masses [kg], limits, which may be infinite, or others.
        positive: whether none may be negative.
        direction: whether they are one, so that not all may be zero.
    """

    least: int
    most: int
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
    count = f"{needs.least}" if needs.least == needs.most else f"{needs.least} to {needs.most}"
    try:
        values = [float(word) for word in text.split()]
    except ValueError:
        return f"needs {count} numbers" if needs.most > 1 else "needs a number"
    if not needs.least <= len(values) <= needs.most:
        return f"needs {count} numbers" if needs.most > 1 else "needs a number"
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
    """What to say of an inertia with which turning would give energy away; empty of others.

    That principal moments exceed the sum of the others is let pass: many published robots have it.

    Args:
        element: for its place.
        moments: ixx ixy ixz iyy iyz izz as the file has them [kg m2]; what is missing is zero.
    """
    least, *_ = np.linalg.eigvalsh(inertia_matrix([float(m or 0.0) for m in moments]))
    if least >= -ROUNDING:
        return ""
    return f"{place_of(element)}: a principal moment is {least:.3g} kg m2; no body has that"


def check_word(
    element: Element, key: str, known: Collection[str], otherwise: Mapping[str, str]
) -> None:
    """Refuse a word that is none of those an attribute may have.

    Args:
        element: whose attribute.
        key: its name.
        known: the words.
        otherwise: words of other formats, and what this one has for them.

    Raises:
        InvalidValueError: names the nearest.
    """
    word = element.get(key)
    if word is not None and word not in known:
        words = nearest(key, word, known, otherwise)
        raise InvalidValueError(f"{place_of(element)} {key}: {words}")


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
