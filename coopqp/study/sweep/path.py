"""A key of a scenario by its path: ``tasks.reach.goal``, ``robot.nao_t14.scale``, ``dt``.

In a list a name is that of a task, a phase or a controller, or of its type, and ``[i]`` its place;
``start.right[0]`` is one number. What the scenario does not say is where its form has it.
"""

from __future__ import annotations

import copy
import re
from collections.abc import Mapping
from typing import Any

from coopqp.base.errors import InvalidValueError, unknown_name

_STEP = re.compile(r"\[(\d{1,6})\]|\.?([^.\[\]]+)")


def located(data: Mapping[str, Any], path: str, defaults: Mapping[str, Any]) -> tuple[Any, ...]:
    """Keys and indices of a path in a file's data, where plain slots on the way become mappings.

    ``defaults`` stand, by key, for what the file leaves out.

    Raises:
        InvalidValueError: the path is none, or leads to what is not there.
    """
    rest, location, here = path, list[Any](), data
    while rest:
        if isinstance(here, list):
            keys, rest = _in_list(here, rest, path)
        else:
            step, rest = _step(here if isinstance(here, dict) else {}, rest, path)
            if not isinstance(here, dict):
                words = "leads into a value, which has no keys"
                raise InvalidValueError(f"'{_upto(path, rest)}' {words}")
            if isinstance(step, int):
                raise InvalidValueError(f"'{_upto(path, rest)}': there is no list; needs a name")
            if rest and not location and step not in here and step in defaults:
                here[step] = copy.deepcopy(defaults[step])
            keys = [step]
        location += keys
        for key in keys if rest else keys[:-1]:
            here = _opened(here, key)
    return tuple(location)


def _opened(here: Any, key: str | int) -> Any:
    """What is inside; a mapping where that was a plain slot, or a key without a value."""
    inside = here.get(key) if isinstance(here, dict) else here[key]
    if isinstance(inside, str):
        here[key] = {inside: {}}
    elif inside is None and isinstance(here, dict):
        here[key] = {}
    return here[key]


def _upto(path: str, rest: str) -> str:
    return path[: len(path) - len(rest)] if rest else path


def _step(here: Mapping[str, Any], rest: str, path: str) -> tuple[str | int, str]:
    """The next key or index, and what follows; keys may have dots in them."""
    text = rest.removeprefix(".")
    for key in sorted(here, key=len, reverse=True):
        after = text[len(key) :]
        if text.startswith(key) and (not after or after[0] in ".["):
            return key, after
    found = _STEP.match(rest)
    if not found:
        raise InvalidValueError(f"'{path}' is not a path; needs names with dots between them")
    index, name = found.groups()
    return (int(index) if index is not None else name), rest[found.end() :]


def _in_list(here: list[Any], rest: str, path: str) -> tuple[list[str | int], str]:
    """The place of a name, or of an index, in a list; with a name, inside what it names."""
    names = [_names(item) for item in here]
    known = {name: None for item in names for name in item}
    step, after = _step(known, rest, path)
    if isinstance(step, int):
        if step >= len(here):
            raise InvalidValueError(f"'{_upto(path, after)}': the list has {len(here)} values")
        if after:
            _check_slot(_opened(here, step), after, path)
        return [step], after
    found: list[str | int] = [i for i, item in enumerate(names) if step in item]
    if not found and not known:
        words = "is a list of values; needs a place in it, from [0] on"
        raise InvalidValueError(f"'{_upto(path, rest).rstrip('.')}' {words}")
    if not found:
        what = _upto(path, rest).rpartition(".")[2].rstrip("s") or "name"
        raise InvalidValueError(unknown_name(what, step, known))
    if len(found) > 1:
        raise InvalidValueError(f"'{step}' is the name of {len(found)} of them; needs [i] instead")
    item = _opened(here, found[0])
    return (found if "name" in item else [*found, next(iter(item))]), after


def _check_slot(item: Any, after: str, path: str) -> None:
    """Refuse keys of a plug-in that its type does not stand before."""
    name = _STEP.match(after)
    if name and isinstance(item, dict) and len(item) == 1 and name[2]:
        ((kind, fields),) = item.items()
        if name[2] != kind and (isinstance(fields, dict) or fields is None):
            to = _upto(path, after)
            raise InvalidValueError(f"'{to}' is a {kind}; write {to}.{kind}{after}")


def _names(item: Any) -> set[str]:
    """What something in a list is called: its own name, else its type's."""
    if isinstance(item, str):
        return {item}
    if not isinstance(item, dict) or not item:
        return set()
    if isinstance(item.get("name"), str):  # a phase
        return {item["name"]}
    ((kind, fields), *_) = item.items()
    own = fields.get("name") if isinstance(fields, dict) else None
    return {kind, own} if isinstance(own, str) else {kind}


def put(data: Any, location: tuple[Any, ...], value: Any) -> Any:
    """The data with another value at a location; what is not on the way there is shared."""
    if not location:
        return value
    key, rest = location[0], location[1:]
    if isinstance(data, list):
        return [*data[:key], put(data[key], rest, value), *data[key + 1 :]]
    inside = data.get(key) if rest else None
    return {**data, key: put({} if inside is None else inside, rest, value)}
