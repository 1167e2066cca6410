"""A small share of ``benchmarks/explanations.py``, on the robots that need no other package."""

from __future__ import annotations

import importlib.util
import sys
from itertools import islice
from pathlib import Path
from typing import Any

import pytest

SCRIPT = Path(__file__).parents[2] / "benchmarks" / "explanations.py"


@pytest.fixture(scope="module")
def bench() -> Any:
    given = importlib.util.spec_from_file_location("explanations", SCRIPT)
    assert given
    assert given.loader
    module = importlib.util.module_from_spec(given)
    sys.modules["explanations"] = module  # dataclasses look their module up there
    given.loader.exec_module(module)
    module.ROBOTS = {"NAO": "point_on_point", "planar pair": "planar_pair"}
    yield module
    del sys.modules["explanations"]


def test_what_is_called_curable_is_cured_by_exactly_what_is_said(bench: Any) -> None:
    outcomes = [bench.explained(case) for case in islice(bench.blocked(7), 4)]
    missed = [outcome for outcome in outcomes if outcome.found.kind != "reached"]
    assert missed
    for outcome in missed:
        assert outcome.found.kind == "limits"
        assert outcome.found.tried
        assert bench.cured(outcome)


def test_goals_out_of_reach_are_blamed_on_nothing_else(bench: Any) -> None:
    kinds = [bench.explained(case).found.kind for case in islice(bench.far(7), 2)]
    assert kinds == ["reach"] * 2


def test_tasks_that_contradict_each_other_are_named(bench: Any) -> None:
    for case, names in islice(bench.pairs(7), 6):
        found = bench.explained(case).found
        assert found.kind == "contradiction"
        assert set(found.tasks) == names
