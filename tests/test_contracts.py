"""Contracts that everything in the catalogue keeps, so that a new file is tested by being there."""

from __future__ import annotations

import dataclasses
import inspect
from dataclasses import replace

import numpy as np
import pytest

import coopqp
from coopqp.catalog import COLLECTIONS, Catalog, Entry
from coopqp.comparison import run
from coopqp.scenario import Scenario, load, shipped, with_solver
from coopqp.solvers import qpsolvers

CATALOG = Catalog()
ENTRIES = [
    pytest.param(entry, id=f"{kind}/{name}")
    for kind in COLLECTIONS
    for name, entry in CATALOG.entries(kind).items()
]
CONTROLLERS = list(CATALOG.entries("controllers"))
SOLVERS = sorted({*CATALOG.entries("solvers"), *qpsolvers.installed()} - {"qpsolvers"})


def ten_ticks(scenario: Scenario) -> Scenario:
    """The same scenario, cut to ten ticks."""
    return replace(scenario, duration=10 * scenario.dt)


@pytest.mark.parametrize("entry", ENTRIES)
def test_a_plug_in_is_a_frozen_documented_dataclass(entry: Entry) -> None:
    assert dataclasses.is_dataclass(entry.cls)
    assert entry.cls.__dataclass_params__.frozen  # type: ignore[attr-defined]
    assert all(field.kw_only for field in dataclasses.fields(entry.cls))
    assert entry.help.endswith(".")
    parents = [base for base in COLLECTIONS.values() if issubclass(entry.cls, base)]
    assert entry.cls.__bases__ == (parents[0],), "plug-ins do not inherit from each other"


@pytest.mark.parametrize("entry", ENTRIES)
def test_every_field_of_a_plug_in_is_explained(entry: Entry) -> None:
    for cls in entry.cls.__mro__:
        if not cls.__module__.startswith("coopqp"):
            continue
        source = inspect.getsource(cls)
        for field in inspect.get_annotations(cls):
            after = source.split(f"    {field}:", 1)[1].split("\n", 2)[1]
            assert '"""' in after or field in ("unit", "joint_space", "constant", "uses_solver")


@pytest.mark.parametrize("name", shipped())
def test_every_scenario_runs_ten_ticks_with_all_its_controllers(name: str) -> None:
    scenario = ten_ticks(load(name))
    for controller in scenario.controllers:
        trace = run(scenario, controller=controller)
        assert trace.ticks == 10
        assert np.isfinite(trace.q).all()
        assert trace.usable.all()


@pytest.mark.parametrize("controller", CONTROLLERS)
def test_every_controller_moves_the_object_towards_the_goal(controller: str) -> None:
    scenario = load("point_on_point")
    trace = run(replace(scenario, duration=1.0), controller=controller)
    goal = np.array(scenario.tasks[0].goal)  # type: ignore[attr-defined]
    distance = np.linalg.norm(trace.position - goal, axis=1)
    assert distance[-1] < 0.6 * distance[0]


@pytest.mark.parametrize("solver", SOLVERS)
def test_every_solver_finds_the_velocity_of_the_default_or_says_it_is_inaccurate(
    solver: str,
) -> None:
    scenario = load("point_on_point")
    exact = run(scenario, controller="qp")
    other = run(with_solver(scenario, solver, CATALOG), controller="qp")
    assert other.usable.all()
    # Until the first inaccurate tick both runs are in the same state.
    same = int(np.argmax(other.inaccurate)) if other.inaccurate.any() else other.ticks
    assert np.abs(other.v[:same] - exact.v[:same]).max(initial=0.0) < 1e-5
    assert np.abs(other.q - exact.q).max() < 1e-2


@pytest.mark.parametrize("controller", CONTROLLERS)
def test_equal_seeds_give_equal_runs(controller: str) -> None:
    scenario = ten_ticks(load("tilting_plane"))
    first, second = (run(scenario, controller=controller) for _ in range(2))
    assert np.array_equal(first.q, second.q)
    assert np.array_equal(first.v, second.v)


def test_the_public_names_are_there() -> None:
    for name in coopqp.__all__:
        assert getattr(coopqp, name)
