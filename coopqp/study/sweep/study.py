"""A study: a scenario, what of it is varied over what, and what is measured.

A variant under some controllers makes a row for each of them. Its state is ``done``, ``invalid``
where the variant is no scenario, or the controller cannot be used for it, and ``failed`` where
something broke down that should not have.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from coopqp.assessment import assess
from coopqp.base.errors import CoopqpError, InternalError
from coopqp.base.wording import raised
from coopqp.execution.controller_run import run
from coopqp.metric import measured
from coopqp.scenario.catalog import Catalog
from coopqp.scenario.checks import Known
from coopqp.scenario.loader import load_file
from coopqp.scenario.scenario import Scenario
from coopqp.scenario.yaml import YamlFile, parsed
from coopqp.study.sweep.path import put
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


@dataclass(frozen=True)
class Job:
    """What a worker must know: the scenario's file, for faults, its data as JSON, and so on."""

    path: Path
    text: str
    data: str
    places: tuple[tuple[Any, ...], ...]
    controllers: tuple[str, ...]
    metrics: tuple[str, ...]
    folders: tuple[tuple[Path, ...], ...]


def job_of(study: Study) -> Job:
    """What the workers must know."""
    places = tuple(one.location for one in study.varied)
    data, folders = json.dumps(study.scenario.data), study.catalog.folders
    return Job(*study.scenario_text, data, places, study.controllers, study.metrics, folders)


def run_variants(variants: Sequence[Variant], *, job: Job) -> list[list[Row]]:
    """A batch; what the engine has a worker do."""
    with np.errstate(all="ignore"):  # laws that run away leave the range of numbers
        return [_rows(job, variant) for variant in variants]


def lost_rows(job: Job, reason: str) -> list[Row]:
    """The rows of a variant that ended the process that ran it."""
    return [_without(FAILED, reason) for _ in job.controllers]


@lru_cache(maxsize=2)
def _prepared(job: Job) -> tuple[YamlFile, Mapping[str, Any], Catalog, Known]:
    return parsed(job.path, job.text), json.loads(job.data), Catalog(*job.folders), Known()


def _rows(job: Job, variant: Variant) -> list[Row]:
    file, data, catalog, known = _prepared(job)
    try:
        scenario = load_file(file.changed(changed(data, job.places, variant)), catalog, known)
    except CoopqpError as error:
        return [_without(INVALID, str(error)) for _ in job.controllers]
    except Exception as error:  # noqa: BLE001 - one variant is not to end a study
        return [_without(FAILED, raised(error)) for _ in job.controllers]
    return [_row(job, scenario, name) for name in job.controllers]


def _row(job: Job, scenario: Scenario, controller: str) -> Row:
    try:
        entries = scenario.catalog.entries("metrics")
        metrics = {name: entries[name].cls() for name in job.metrics}
        timed = any(metric.timed for metric in metrics.values())
        trace = run(scenario, controller=controller, timed=timed)
        found = assess(trace)
        own: Row = {
            "success": found.succeeds,
            "blocked_by": ", ".join(found.blocked_by),
            "broken": ", ".join(found.broken),
        }
        values, faults = measured(metrics, trace)
        for name, value in values.items():
            own |= _flat(name, value)
    except InternalError as error:
        return _without(FAILED, str(error))
    except CoopqpError as error:
        return _without(INVALID, str(error))
    return {"state": DONE, "reason": "; ".join(faults), **own}


def _without(state: str, reason: str) -> Row:
    return {"state": state, "reason": "; ".join(reason.splitlines())}


def _flat(name: str, value: Any) -> Row:
    """Numbers by name; None for what is not finite, for which JSON has no word."""
    if isinstance(value, dict):
        parts = (_flat(f"{name}.{key}", inside) for key, inside in value.items())
        return {key: inside for part in parts for key, inside in part.items()}
    if isinstance(value, list | tuple):
        return {name: json.dumps(value)}
    if isinstance(value, float) and not math.isfinite(value):
        return {name: None}
    return {name: value}
