"""A study: a scenario, what of it is varied over what, and what is measured."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from coopqp.scenario.catalog import Catalog
from coopqp.scenario.yaml import YamlFile
from coopqp.study.sweep.path import put
from coopqp.study.sweep.space import Points, Variation

CONTROLLERS = "controllers"
SEED = "seed"


@dataclass(frozen=True)
class Varied:
    """A key of the scenario that is varied; keys and indices lead to it in the scenario's data."""

    path: str
    location: tuple[Any, ...]
    over: Variation

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the columns with its values."""
        return tuple(f"{self.path}{suffix}" for suffix in self.over.suffixes)


@dataclass(frozen=True)
class Variant:
    """One point of a study: the seed of all that is random in it, and what is varied, in order."""

    index: int
    seed: int
    values: tuple[Any, ...]


@dataclass(frozen=True)
class Study:
    """What is asked.

    Attributes:
        scenario: the scenario's, with slots on the way to what is varied written out.
        scenario_text: path and text of its file.
        controllers: names; each variant is run under all of them.
        points: a dimension for each number that is varied.
        notes: what is odd, but no fault.
    """

    file: YamlFile
    scenario: YamlFile
    scenario_text: tuple[Path, str]
    catalog: Catalog
    varied: tuple[Varied, ...]
    controllers: tuple[str, ...]
    points: Points
    metrics: tuple[str, ...]
    seed: int
    notes: tuple[str, ...] = ()

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
            last = first + one.over.dimensions
            values.append(one.over.at(u[first:last]))
            first = last
        child = np.random.SeedSequence(self.seed, spawn_key=(index,))
        return Variant(index, int(child.generate_state(1)[0]), tuple(values))

    def seed_of(self, variant: Variant) -> Any:
        """The scenario's in a variant; the variant's own unless it is varied."""
        values = zip(self.varied, variant.values, strict=True)
        return next((x for one, x in values if one.location == (SEED,)), variant.seed)

    def parts(self, variant: Variant) -> tuple[Any, ...]:
        """What stands in the columns; what is neither number nor text, as JSON."""
        found: list[Any] = []
        for one, value in zip(self.varied, variant.values, strict=True):
            found += one.over.parts(value)
        return tuple(json.dumps(x) if isinstance(x, dict | list) else x for x in found)

    def changed(self, variant: Variant) -> dict[str, Any]:
        places = [one.location for one in self.varied]
        return changed(self.scenario.data, places, variant)


def changed(
    data: Mapping[str, Any], places: Sequence[tuple[Any, ...]], variant: Variant
) -> dict[str, Any]:
    """A scenario's data with the values of a variant, and its seed where that is not varied."""
    found: dict[str, Any] = {**data, SEED: variant.seed}
    for place, value in zip(places, variant.values, strict=True):
        found = put(found, place, value)
    return found
