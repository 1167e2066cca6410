"""A small share of ``benchmarks/explanations.py``, on the robots that need no other package."""

from __future__ import annotations

import importlib
from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from typing import Any

import pytest

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"


@pytest.fixture(scope="module")
def bench() -> Iterator[Any]:
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(BENCHMARKS)
        cases = importlib.import_module("explained_cases")
        patch.setattr(cases, "ROBOTS", {"NAO": "point_on_point", "planar pair": "planar_pair"})
        yield importlib.import_module("explanations")


def test_what_is_called_curable_is_cured_by_exactly_what_is_said(bench: Any) -> None:
    outcomes = [bench.explained(case) for case in islice(bench.blocked(7), 4)]
    missed = [outcome for outcome in outcomes if outcome.found.kind != "reached"]
    assert missed
    for outcome in missed:
        assert outcome.found.kind == "limits"
        assert outcome.found.tried
        assert bench.cured(outcome)


def test_unreachable_goals_are_blamed_on_nothing_else(bench: Any) -> None:
    kinds = [bench.explained(case).found.kind for case in islice(bench.far(7), 2)]
    assert kinds == ["reach"] * 2


def test_tasks_that_contradict_each_other_are_named(bench: Any) -> None:
    for case, names in islice(bench.pairs(7), 6):
        found = bench.explained(case).found
        assert found.kind == "contradiction"
        assert set(found.tasks) == names
