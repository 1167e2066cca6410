"""One variant: a scenario under some controllers, and a row for each of them.

A row's state is ``done``, ``invalid`` where the variant is no scenario, or the controller cannot be
used for it, and ``failed`` where something broke down that should not have.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
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
from coopqp.study.sweep.study import Study, Variant, changed

DONE, INVALID, FAILED = "done", "invalid", "failed"

Folders = tuple[tuple[Path, ...], tuple[Path, ...]]
"""With the user's own tasks, and plug-ins."""
Row = dict[str, Any]
"""What came of one variant under one controller: state, reason, success and so on, metrics."""


@dataclass(frozen=True)
class Job:
    """What a worker must know: the scenario's file, for faults, its data as JSON, and so on."""

    path: Path
    text: str
    data: str
    places: tuple[tuple[Any, ...], ...]
    controllers: tuple[str, ...]
    metrics: tuple[str, ...]
    folders: Folders


def job_of(study: Study, folders: Folders) -> Job:
    """What the workers must know."""
    places = tuple(one.location for one in study.varied)
    data = json.dumps(study.scenario.data)
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
