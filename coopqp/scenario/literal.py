"""Numbers are numbers: finds where pydantic has made one of true, or of "5".

Inside a slot it reads values of Python, either strictly, when no list is a tuple, or so that true
is 1.0. Slots are therefore not read strictly, and what came of them is looked at again.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from coopqp.wording import Location, shown


def mistaken(given: Any, read: Any) -> Iterator[tuple[Location, str]]:
    """Values that were made numbers or truths and are none, with what is wrong."""
    if isinstance(given, dict):
        for key, value in given.items():
            inside = read.get(key) if isinstance(read, dict) else getattr(read, key, None)
            yield from (((key, *place), words) for place, words in mistaken(value, inside))
    elif isinstance(given, list):
        if isinstance(read, list | tuple) and len(read) == len(given):
            for i, (value, inside) in enumerate(zip(given, read, strict=True)):
                yield from (((i, *place), words) for place, words in mistaken(value, inside))
    elif type(read) in (int, float) and isinstance(given, bool | str):
        yield (), f"found {shown(given)}; needs a number"
    elif type(read) is bool and not isinstance(given, bool):
        yield (), f"found {shown(given)}; needs true or false"
