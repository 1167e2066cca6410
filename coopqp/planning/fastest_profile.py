"""The shares of a task's way at each tick, such that it takes the least time that joints allow.

A slow run of the law says where the joints are at each share of the way: q(s). Along that path the
motion is timed by the passes of :mod:`coopqp.planning.forward_backward_pass`.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from coopqp.base.errors import InvalidValueError
from coopqp.model.profile import FASTEST, Profile
from coopqp.planning.closed_path import closed_path
from coopqp.planning.given_path import LAW, SLOW, calm_run
from coopqp.planning.path_constraints import RowMaker, joint_bounds, motion_bounds
from coopqp.planning.time_along import POINTS, fastest
from coopqp.scenario.scenario import Scenario
from coopqp.task import Task

#: Runs of the law, and how much slower than the fastest they are: what else moves, such as joints
#: to their middle, is then about as far as it is in the fastest.
LOOKS, CALM = 3, 1.25
#: Share of the limits that the timing uses: the rest is for what the law corrects.
SHARE = 0.99


def with_fastest_profiles(scenario: Scenario) -> Scenario:
    """The scenario with ``kind: fastest`` as tables; all tasks that have it go alike.

    Raises:
        InvalidValueError: in phases, without limits of speed, where the law does not move, or where
            the scenario ends before.
    """
    if not any(_is_fastest(task) for phase in scenario.schedule for task in phase.tasks):
        return scenario
    if scenario.phases:
        words = "fastest is of a motion from the start, and this scenario has phases"
        raise InvalidValueError(f"{words}; use another kind there")
    laws = [name for name, law in scenario.controllers.items() if not law.commands_torques]
    law = next(iter(laws), LAW)
    way = Profile(duration=SLOW)
    for _ in range(LOOKS):
        found = _along(scenario, law, way)
        way = replace(found, duration=CALM * found.duration)
    for task in filter(_is_fastest, scenario.tasks):
        if task.way and (end := task.way.delay + found.duration) > scenario.duration:
            raise InvalidValueError(
                f"the fastest reference of '{task.name}' arrives at {end:.4g} s, after the end at "
                f"{scenario.duration:g} s; make the duration longer"
            )
    return _with(scenario, found)


def _along(scenario: Scenario, law: str, way: Profile) -> Profile:
    """The fastest along where a law's run has the joints by its share of the way."""
    trace = calm_run(scenario, _with(scenario, way, delay=0.0).tasks, way.duration, law)
    bounds = motion_bounds(scenario, *joint_bounds(scenario), SHARE)
    path = closed_path(scenario.chain, trace.q)
    found = fastest(RowMaker(path, bounds), POINTS)
    t = scenario.dt * np.arange(int(np.ceil(found.duration / scenario.dt)) + 1)
    shares = np.array([way.at(now)[0] for now in trace.t.tolist()])
    table = np.interp([found.where(now)[0] for now in t.tolist()], path.points, shares)
    inside = np.minimum(np.maximum.accumulate(table[1:-1]), 1.0)  # but for rounding
    return Profile(kind="table", duration=float(t[-1]), shares=[0.0, *inside.tolist(), 1.0])


def _with(scenario: Scenario, way: Profile, **keys: Any) -> Scenario:
    """The scenario with another profile where it is the fastest; delays stay."""
    tasks = []
    for task in scenario.tasks:
        keys_of = {"delay": task.way.delay, **keys} if task.way else {}
        moved: dict[str, Any] = {"profile": replace(way, **keys_of)} if _is_fastest(task) else {}
        tasks.append(replace(task, **moved))
    return replace(scenario, tasks=tuple(tasks))


def _is_fastest(task: Task) -> bool:
    return task.way is not None and task.way.kind == FASTEST
