"""One variant: a scenario under some controllers, and a row for each of them.

A row's state is ``done``, ``invalid`` where the variant is no scenario, or the controller cannot be
used for it, and ``failed`` where something broke down that should not have.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from coopqp.controller_run import run
from coopqp.errors import CoopqpError, InternalError
from coopqp.hold import CLOSED_ORIENTATION, CLOSED_POSITION
from coopqp.limit import ROUNDING
from coopqp.overrun import at_limits, broken, matters, outside, slowed_by
from coopqp.scenario.catalog import Catalog
from coopqp.scenario.known import Known
from coopqp.scenario.loader import load_file
from coopqp.scenario.scenario import Scenario
from coopqp.scenario.yaml import YamlFile, parsed
from coopqp.study.sweep.study import Study, Variant, changed
from coopqp.trace import Trace
from coopqp.verdict import FASTER
from coopqp.wording import by_user, raised

DONE, INVALID, FAILED = "done", "invalid", "failed"
#: What a run can break that is no limit: the closed loops, the hold of an object, the plant.
LOOP, HOLD, PLANT = "loop", "hold", "plant"

Row = dict[str, Any]
"""What came of one variant under one controller: state, reason, success and so on, metrics."""


@dataclass(frozen=True)
class Job:
    """What a worker must know of a study.

    Attributes:
        path, text: of the scenario's file, for faults.
        data: of the scenario, as JSON.
        places: of what is varied.
        controllers, metrics: names.
        folders: with the user's own tasks, and plug-ins.
    """

    path: Path
    text: str
    data: str
    places: tuple[tuple[Any, ...], ...]
    controllers: tuple[str, ...]
    metrics: tuple[str, ...]
    folders: tuple[tuple[Path, ...], tuple[Path, ...]]


def job_of(study: Study, folders: tuple[tuple[Path, ...], tuple[Path, ...]]) -> Job:
    """What the workers must know.

    Args:
        study: whose variants they run.
        folders: from the root on, with the user's own tasks, and plug-ins.
    """
    path, text = study.scenario_text
    places = tuple(one.location for one in study.varied)
    data = json.dumps(study.scenario.data)
    return Job(path, text, data, places, study.controllers, study.metrics, folders)


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
        measured = {name: entries[name].cls() for name in job.metrics}
        timed = any(metric.timed for metric in measured.values())
        trace = run(scenario, controller=controller, timed=timed)
        own: Row = {
            "success": succeeds(trace),
            "blocked_by": ", ".join(_blocked_by(trace)),
            "broken": ", ".join(_broken(trace)),
        }
        for name, metric in measured.items():
            own |= _flat(name, _measured(metric, trace))
    except InternalError as error:
        return _without(FAILED, str(error))
    except CoopqpError as error:
        return _without(INVALID, str(error))
    return {"state": DONE, "reason": "", **own}


def _without(state: str, reason: str) -> Row:
    return {"state": state, "reason": "; ".join(reason.splitlines())}


def succeeds(trace: Trace) -> bool:
    """Whether a run reaches all goals, goes beyond no limit and keeps the loops closed."""
    ends = zip(trace.final_error, trace.tasks, strict=True)
    return all(bool(error <= task.tolerance) for error, task in ends) and not any(_broken(trace))


def _broken(trace: Trace) -> Iterator[str]:
    """What the run broke, by name: limits of joints, other limits, the loop, the hold, the plant.

    A run that reaches its goals and breaks nothing is a success.
    """
    beyond = np.maximum(outside(trace), 0.0)
    worst = beyond.max(axis=0)
    fast = np.abs(trace.v).max(axis=0, initial=0.0) > (1.0 + FASTER) * trace.velocity
    for i, joint in enumerate(trace.joints):
        farther = worst[i] > beyond[0, i] + ROUNDING and matters(worst[i], trace.units[i])
        if farther or not math.isfinite(worst[i]):
            yield joint
        if fast[i]:
            yield f"speed of {joint}"
    yield from (found.row.owner for found in broken(trace) if found.farther)
    position, angle = trace.loop_position.max(), trace.loop_orientation.max()
    if not (position <= CLOSED_POSITION and angle <= CLOSED_ORIENTATION):  # a NaN is open
        yield LOOP
    if any(trace.torn) and "held" in trace.signals:
        yield HOLD
    elif trace.broke_down:
        yield PLANT


def _blocked_by(trace: Trace) -> dict[str, None]:
    """Limits at which the run stands where it has missed a goal, or that held it up on its way."""
    found: dict[str, None] = {}
    for k, (error, task) in enumerate(zip(trace.final_error, trace.tasks, strict=True)):
        if not error <= task.tolerance:
            found |= dict.fromkeys(at_limits(trace, trace.last_instants[k]))
            found |= dict.fromkeys(slowed_by(trace, k))
    return found


def _measured(metric: Any, trace: Trace) -> Any:
    """A metric's value; None where a user's own raises."""
    try:
        value = metric.measure(trace)
        json.dumps(value)
    except Exception as error:
        if by_user(error):
            return None
        raise
    return value


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
