"""Contracts that everything in the catalogue keeps, so that a new file is tested by being there."""

from __future__ import annotations

import dataclasses
import inspect
from collections.abc import Iterable
from dataclasses import replace
from functools import cache
from pathlib import Path

import example_controllers
import example_grasps
import example_limits
import example_metrics
import example_plants
import example_robots
import example_signals
import example_solvers
import example_tasks
import numpy as np
import pytest
from scenario_files import LOADABLE, cut
from shipped_runs import beginning

import coopqp
from coopqp.controller import Controller
from coopqp.execution.controller_run import run
from coopqp.scenario.catalog import COLLECTIONS, Catalog, Entry
from coopqp.scenario.loader import load, with_solver
from coopqp.scenario.scenario import Scenario
from coopqp.solvers import qpsolvers
from coopqp.trace import Trace

CATALOG = Catalog()
ENTRIES = [
    pytest.param(entry, id=f"{kind}/{name}")
    for kind in COLLECTIONS
    for name, entry in CATALOG.entries(kind).items()
]
EXAMPLES: dict[str, Iterable[object]] = {
    "grasps": example_grasps.EXAMPLES.values(),
    "tasks": [*example_tasks.EXAMPLES.values(), *example_tasks.OF_FORCES.values()],
    "signals": example_signals.EXAMPLES.values(),
    "limits": example_limits.EXAMPLES,
    "controllers": example_controllers.EXAMPLES.values(),
    "solvers": example_solvers.EXAMPLES.values(),
    "plants": example_plants.EXAMPLES.values(),
    "metrics": example_metrics.EXAMPLES.values(),
}
CONTROLLERS = list(CATALOG.entries("controllers"))
SOLVERS = sorted({*CATALOG.entries("solvers"), *qpsolvers.installed()} - {"qpsolvers"})


def scenario_for(controller: str) -> Scenario:
    """One that the controller can run: torques need masses and six degrees of freedom."""
    plugin = CATALOG.entries("controllers")[controller].cls()
    assert isinstance(plugin, Controller)
    return load("passive_grasp_pose" if plugin.commands_torques else "point_on_point")


@pytest.mark.parametrize("entry", ENTRIES)
def test_a_plug_in_is_a_frozen_documented_dataclass(entry: Entry) -> None:
    assert dataclasses.is_dataclass(entry.cls)
    assert entry.cls.__dataclass_params__.frozen  # type: ignore[attr-defined]
    assert all(field.kw_only for field in dataclasses.fields(entry.cls))
    assert entry.help.endswith(".")
    parents = [base for base in COLLECTIONS.values() if issubclass(entry.cls, base)]
    for base in entry.cls.__bases__:
        assert issubclass(base, parents[0]), "plug-ins inherit from their idea alone"
        assert inspect.isabstract(base), "plug-ins do not inherit from each other"


@pytest.mark.parametrize("entry", ENTRIES)
def test_every_field_of_a_plug_in_is_explained(entry: Entry) -> None:
    for cls in entry.cls.__mro__:
        if not cls.__module__.startswith("coopqp"):
            continue
        source = inspect.getsource(cls)
        for field, hint in inspect.get_annotations(cls).items():
            if "ClassVar" in str(hint):
                continue  # explained where the idea is
            after = source.split(f"    {field}:", 1)[1].split("\n", 2)[1]
            assert '"""' in after


@pytest.mark.parametrize("kind", COLLECTIONS)
def test_every_plug_in_has_settings_of_an_example(kind: str, tmp_path: Path) -> None:
    robots = (make(tmp_path) for make in example_robots.EXAMPLES.values())
    seen = {type(example) for example in (robots if kind == "robots" else EXAMPLES[kind])}
    missing = [name for name, entry in CATALOG.entries(kind).items() if entry.cls not in seen]
    assert not missing, (
        f"nothing tests {', '.join(missing)} of {kind}: "
        f"tests/example_{kind}.py needs a line with settings for each"
    )


@pytest.mark.parametrize("name", LOADABLE)
def test_every_scenario_runs_ten_ticks_with_all_its_controllers(name: str) -> None:
    found = beginning(name)
    assert set(found.traces) == set(load(name).controllers)
    for trace in found.traces.values():
        assert trace.ticks == 10 * len(found.scenario.schedule)
        assert np.isfinite(trace.q).all()
        assert not trace.failures


@pytest.mark.parametrize("controller", CONTROLLERS)
def test_every_controller_moves_the_object_towards_the_goal(controller: str) -> None:
    scenario = scenario_for(controller)
    trace = run(replace(scenario, duration=1.3), controller=controller)
    goal = scenario.tasks[0].goal  # type: ignore[attr-defined]
    place = np.array(getattr(goal, "position", goal))
    distance = np.linalg.norm(trace.position - place, axis=1)
    assert distance[-1] < 0.6 * distance[0]


@cache
def by_the_default() -> Trace:
    return run(replace(load("point_on_point"), duration=2.0), controller="qp")


@pytest.mark.parametrize("solver", SOLVERS)
def test_every_solver_finds_the_velocity_of_the_default_or_says_it_is_inaccurate(
    solver: str,
) -> None:
    exact = by_the_default()
    asked = replace(load("point_on_point"), duration=2.0)
    other = run(with_solver(asked, solver), controller="qp")
    assert not other.failures
    # Until the first inaccurate tick both runs are in the same state.
    same = next((k for k, word in enumerate(other.status) if "INACCURATE" in word), other.ticks)
    assert np.abs(other.v[:same] - exact.v[:same]).max(initial=0.0) < 1e-5
    assert np.abs(other.q - exact.q).max() < 1e-2


@pytest.mark.parametrize("controller", CONTROLLERS)
def test_equal_seeds_give_equal_runs(controller: str) -> None:
    scenario = cut(scenario_for(controller), 10)
    first, second = (run(scenario, controller=controller) for _ in range(2))
    assert np.array_equal(first.q, second.q)
    assert np.array_equal(first.v, second.v)


def test_the_public_names_are_there() -> None:
    for name in coopqp.__all__:
        assert getattr(coopqp, name)
