"""A variant is the same scenario whatever was read before it."""

from __future__ import annotations

from collections.abc import Iterator
from copy import deepcopy
from typing import Any

import numpy as np
import pytest

from coopqp.base.errors import ScenarioError
from coopqp.execution.controller_run import run
from coopqp.scenario.catalog import Catalog
from coopqp.scenario.checks import Known
from coopqp.scenario.loader import find, load_file
from coopqp.scenario.scenario import Scenario
from coopqp.scenario.yaml import YamlFile, read_yaml

#: Keys and values, one after the other; each is set on top of those before it. Some are refused.
CHANGES: list[tuple[tuple[Any, ...], Any]] = [
    (("tasks", 0, "point_on_point", "goal"), [0.34, 0.05, 0.0]),
    (("object", "mass"), 1.5),
    (("object", "com"), [0.01, 0.0, 0.0]),
    (("object", "size"), [0.1, 0.2, 0.02]),
    (("tasks", 0, "point_on_point", "gain"), 500.0),  # more than 1/dt
    (("tasks", 0, "point_on_point", "gain"), 4.0),
    (("start_deg", "right"), [-20, 500, -50]),  # outside the limits
    (("start_deg", "right"), [-25, 75, -50]),
    (("start_deg", "left"), [25, -75, 50]),
    (("limits",), ["joint_position", {"joint_velocity": {"scale": 0.5}}]),
    (("limits",), [{"object_speed": {"linear": -1.0}}]),
    (("limits",), ["joint_position", {"object_speed": {"linear": 0.02}}]),
    (("dt",), 0.005),
    (("kappa",), 150.0),
    (("weights",), {"right": 1.0, "left": 0.0}),
    (("robot",), {"planar_pair": {"lengths": [0.31, 0.25, 0.1]}}),
    (("secondary",), []),
    (("grasp",), "no_such_grasp"),
    (("grasp",), "rigid"),
    (("duration",), 2.5),
    (("duration",), 0.1),  # ends before the reference does
]


def variants() -> Iterator[YamlFile]:
    """The planar pair, changed step by step."""
    file = read_yaml(find("planar_pair"))
    data = deepcopy(file.data)
    yield file
    for place, value in CHANGES:
        data = here = deepcopy(data)
        for key in place[:-1]:
            here = here[key]
        here[place[-1]] = value
        yield file.changed(data)


def read(file: YamlFile, known: Known | None) -> Scenario | str:
    """The scenario, or what is wrong with it."""
    try:
        return load_file(file, Catalog(), known)
    except ScenarioError as error:
        return str(error)


def test_variants_are_what_they_are_alone() -> None:
    known, outcomes = Known(), set()
    for file in variants():
        found, alone = read(file, known), read(file, None)
        outcomes.add(type(found))
        if isinstance(found, str) or isinstance(alone, str):
            assert found == alone
            continue
        assert found.chain.held == found.held == alone.held
        traces = [run(one, controller="qp", timed=False) for one in (found, alone)]
        for name in ("q", "v", "e", "position", "task_error"):
            np.testing.assert_array_equal(*(getattr(trace, name) for trace in traces))
        assert traces[0].status == traces[1].status
    assert outcomes == {Scenario, str}


def test_what_is_the_same_is_neither_built_nor_tried_again(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    first, goal, mass, *_ = variants()
    known = Known()
    before = load_file(first, Catalog(), known)
    tried: list[str] = []
    monkeypatch.setattr("coopqp.scenario.checks.try_task", lambda task, *_: tried.append(task.name))
    monkeypatch.setattr("coopqp.scenario.checks.try_limit", lambda *_: tried.append("limit"))
    same = load_file(goal, Catalog(), known)
    assert tried == ["slide"]
    assert (same.robot_model, same.chain) == (before.robot_model, before.chain)
    other = load_file(mass, Catalog(), known)
    assert tried == ["slide"]
    assert (other.chain.model, other.chain.held.mass) == (before.chain.model, 1.5)
    assert before.chain.held.mass == 0.5
