"""A study: a scenario, what of it is varied over what, and what is measured.

Keys of the scenario are given by paths: ``tasks.reach.goal``, ``robot.nao_t14.scale``, ``dt``. In a
list a name is that of a task, a phase or a controller, or of its type, and ``[i]`` its place;
``start.right[0]`` is one number. What the scenario does not say is where its form has it.

A variant under some controllers makes a row for each of them. Its state is ``done``, ``invalid``
where the variant is no scenario, or the controller cannot be used for it, and ``failed`` where
something broke down that should not have.
"""

import copy
import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from coopqp.base.errors import InvalidValueError, unknown_name
from coopqp.scenario.catalog import Catalog
from coopqp.scenario.yaml import YamlFile
from coopqp.study.sweep.space import Points, Variation

CONTROLLERS = "controllers"
SEED = "seed"
DONE, INVALID, FAILED = "done", "invalid", "failed"

Row = dict[str, Any]
"""What came of one variant under one controller: state, reason, success and so on, metrics."""


@dataclass(frozen=True)
class Varied:
    """A key of the scenario that is varied; keys and indices lead to it in the scenario's data."""

    path: str
    location: tuple[Any, ...]
    over: Variation

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the columns with its values, one for each number."""
        numbers = range(self.over.numbers)
        return tuple(f"{self.path}[{i}]" for i in numbers) or (self.path,)


@dataclass(frozen=True)
class Variant:
    """One point of a study: the seed of all that is random in it, and what is varied, in order."""

    index: int
    seed: int
    values: tuple[Any, ...]


@dataclass(frozen=True)
class Study:
    """What is asked."""

    file: YamlFile
    scenario: YamlFile  # with slots on the way to what is varied written out
    scenario_text: tuple[Path, str]  # path and text of its file
    catalog: Catalog
    varied: tuple[Varied, ...]
    controllers: tuple[str, ...]
    points: Points  # a dimension for each number that is varied
    metrics: tuple[str, ...]
    seed: int
    notes: tuple[str, ...] = ()  # what is odd, but no fault

    @property
    def name(self) -> str:
        return self.file.path.stem

    @property
    def rows(self) -> int:
        """One for each variant and controller."""
        return self.points.count * len(self.controllers)

    @property
    def exact(self) -> bool:
        """Whether nothing is drawn: a grid without a disturbance is all there is, no sample."""
        keys = {*self.scenario.data, *(one.location[0] for one in self.varied)}
        return bool(self.points.levels) and "disturbance" not in keys

    @cached_property
    def columns(self) -> tuple[str, ...]:
        """Names of the columns of all that is varied."""
        return tuple(name for one in self.varied for name in one.columns)

    def variant(self, index: int) -> Variant:
        """A point, whatever the others."""
        u, first, values = self.points.at(index), 0, []
        for one in self.varied:
            last = first + len(one.over.sides)
            values.append(one.over.at(u[first:last]))
            first = last
        child = np.random.SeedSequence(self.seed, spawn_key=(index,))
        return Variant(index, int(child.generate_state(1)[0]), tuple(values))

    def parts(self, variant: Variant) -> tuple[Any, ...]:
        """What stands in the columns; what is neither number nor text, as JSON."""
        found: list[Any] = []
        for one, value in zip(self.varied, variant.values, strict=True):
            found += one.over.parts(value)
        return tuple(json.dumps(x) if isinstance(x, dict | list) else x for x in found)

    @property
    def locations(self) -> tuple[tuple[Any, ...], ...]:
        return tuple(one.location for one in self.varied)


def changed(
    data: Mapping[str, Any], places: Sequence[tuple[Any, ...]], variant: Variant
) -> dict[str, Any]:
    """A scenario's data with the values of a variant, and its seed where that is not varied."""
    found: dict[str, Any] = {**data, SEED: variant.seed}
    for place, value in zip(places, variant.values, strict=True):
        found = put(found, place, value)
    return found


_STEP = re.compile(r"\[(\d{1,6})\]|\.?([^.\[\]]+)")


def located(data: Mapping[str, Any], path: str, defaults: Mapping[str, Any]) -> tuple[Any, ...]:
    """Keys and indices of a path in a file's data, where plain slots on the way become mappings.

    ``defaults`` stand, by key, for what the file leaves out. What is no path, or leads to what is
    not there, is refused with InvalidValueError.
    """
    rest, location, here = path, list[Any](), data
    while rest:
        if isinstance(here, list):
            keys, rest = _in_list(here, rest, path)
        else:
            step, rest = _step(here if isinstance(here, dict) else {}, rest, path)
            if not isinstance(here, dict):
                words = "leads into a value, which has no keys"
                raise InvalidValueError(f"'{path.removesuffix(rest)}' {words}")
            if isinstance(step, int):
                raise InvalidValueError(
                    f"'{path.removesuffix(rest)}': there is no list; needs a name"
                )
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
            raise InvalidValueError(
                f"'{path.removesuffix(after)}': the list has {len(here)} values"
            )
        if after:
            _check_slot(_opened(here, step), after, path)
        return [step], after
    places: list[str | int] = [i for i, item in enumerate(names) if step in item]
    if not places and not known:
        words = "is a list of values; needs a place in it, from [0] on"
        raise InvalidValueError(f"'{path.removesuffix(rest).rstrip('.')}' {words}")
    if not places:
        what = path.removesuffix(rest).rpartition(".")[2].rstrip("s") or "name"
        raise InvalidValueError(unknown_name(what, step, known))
    if len(places) > 1:
        raise InvalidValueError(f"'{step}' is the name of {len(places)} of them; needs [i] instead")
    item = _opened(here, places[0])
    return (places if "name" in item else [*places, next(iter(item))]), after


def _check_slot(item: Any, after: str, path: str) -> None:
    """Refuse keys of a plug-in that its type does not stand before."""
    name = _STEP.match(after)
    if name and isinstance(item, dict) and len(item) == 1 and name[2]:
        ((kind, fields),) = item.items()
        if name[2] != kind and (isinstance(fields, dict) or fields is None):
            to = path.removesuffix(after)
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
