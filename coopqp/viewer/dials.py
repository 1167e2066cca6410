"""Gains, weights, priorities and kappa as sliders, and a scenario with them turned."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Any

from coopqp.scenario.scenario import Scenario
from coopqp.task import Task
from coopqp.viewer.live import with_schedule
from coopqp.viewer.messages import Dial

KAPPA = "kappa"
SQUEEZE = "squeeze"
#: What sliders go up to at least; twice what a scenario says where that is more.
MOST_GAIN, MOST_WEIGHT, MOST_PRIORITY = 20.0, 10.0, 3
#: Least gain [1/s], and steps of a slider.
LEAST_GAIN, STEPS = 0.1, 200


def dials_of(scenario: Scenario) -> tuple[Dial, ...]:
    """Everything that can be turned."""
    found = list(_of_tasks(scenario))
    now = scenario.drift_gain
    most = max(1.0 / scenario.dt, now)  # which rounding may tell apart
    found.append(Dial(KAPPA, "loop", "kappa, drift gain [1/s]", 0.0, most, most / STEPS, now))
    return tuple(found)


def turned(scenario: Scenario, values: Mapping[str, float]) -> Scenario:
    """The scenario with its dials turned."""
    if not values:
        return scenario
    phases = [
        replace(
            phase,
            tasks=tuple(_turned(t, f"tasks.{i}.{j}", values) for j, t in enumerate(phase.tasks)),
        )
        for i, phase in enumerate(scenario.schedule)
    ]
    secondary = [_turned(t, f"secondary.{i}", values) for i, t in enumerate(scenario.secondary)]
    found = replace(with_schedule(scenario, phases), secondary=tuple(secondary))
    return replace(found, kappa=values[KAPPA]) if KAPPA in values else found


def task_and_field(key: str) -> tuple[str, int, int, str]:
    """List, phase, number and field that a dial of a task is of."""
    kind, *numbers, field = key.split(".")
    places = [int(number) for number in numbers]
    return kind, places[0] if len(places) == 2 else 0, places[-1], field


def _turned(task: Task, place: str, values: Mapping[str, float]) -> Task:
    found: dict[str, Any] = {}
    for field in ("gain", "weight", "priority", SQUEEZE):
        key = f"{place}.{field}"
        if key in values:
            found[field] = round(values[key]) if field == "priority" else values[key]
    return replace(task, **found) if found else task


def _of_tasks(scenario: Scenario) -> Iterator[Dial]:
    for i, phase in enumerate(scenario.schedule):
        for j, task in enumerate(phase.tasks):
            group = f"{phase.name}: {task.name}" if phase.name else task.name
            yield from _of_task(task, f"tasks.{i}.{j}", group, scenario.dt)
            if task.mode == "soft":
                label, most = "priority, 0 is first", max(MOST_PRIORITY, task.priority)
                key = f"tasks.{i}.{j}.priority"
                yield Dial(key, group, label, 0.0, float(most), 1.0, float(task.priority))
    for i, task in enumerate(scenario.secondary):
        yield from _of_task(task, f"secondary.{i}", task.name, scenario.dt)


def _of_task(task: Task, place: str, group: str, dt: float) -> Iterator[Dial]:
    wanted = getattr(task, SQUEEZE, None) if task.of_forces else None
    if isinstance(wanted, float | int) and wanted > 0.0:
        most = 2.0 * wanted
        yield Dial(f"{place}.{SQUEEZE}", group, "squeeze [N]", 0.0, most, most / STEPS, wanted)
    if not (task.asks_velocity or task.of_forces):
        most = max(min(max(MOST_GAIN, 2.0 * task.gain), 1.0 / dt), task.gain)
        least = min(LEAST_GAIN, task.gain)
        step = (most - least) / STEPS
        yield Dial(f"{place}.gain", group, "gain [1/s]", least, most, step, task.gain)
    most = max(MOST_WEIGHT, 2.0 * task.weight)
    yield Dial(f"{place}.weight", group, "weight", 0.0, most, most / STEPS, task.weight)
