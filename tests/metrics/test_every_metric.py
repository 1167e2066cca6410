"""What every metric keeps: it is a pure function of a trace that JSON can hold."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest
from example_metrics import EXAMPLES
from laws import LIMITS, NEAR, UNREACHABLE, problem, run

from coopqp.controllers import Pseudoinverse, QPController
from coopqp.metric import OF_STUDIES, Metric, measured
from coopqp.model.closed_chain import ClosedChain
from coopqp.study.sweep.results import FIRST, LAST, OWN_SEED
from coopqp.tasks import PointOnPoint
from coopqp.trace import Trace


@pytest.fixture(scope="module")
def traces(chain: ClosedChain) -> dict[str, Trace]:
    """One that goes well, one beyond the limits, one that stands still from the start."""
    near, far = (PointOnPoint(name="reach", goal=goal) for goal in (NEAR, UNREACHABLE))
    impossible = PointOnPoint(name="reach", goal=UNREACHABLE, mode="hard", gain=100.0)
    return {
        "good": run(QPController(), problem(chain, near, limits=LIMITS), 20),
        "beyond": run(Pseudoinverse(), problem(chain, far, limits=LIMITS), 200),
        "stopped": run(
            QPController(), problem(chain, impossible, limits=LIMITS, on_infeasible="stop"), 200
        ),
    }


def test_the_traces_differ_in_what_metrics_see(traces: dict[str, Trace]) -> None:
    assert not traces["good"].failures
    assert traces["stopped"].failures
    beyond = traces["beyond"]
    assert (beyond.q > beyond.upper).any() or (beyond.q < beyond.lower).any()


@pytest.mark.parametrize("trace", ["good", "beyond", "stopped"])
@pytest.mark.parametrize("metric", EXAMPLES.values(), ids=EXAMPLES.keys())
def test_a_metric_is_a_pure_function_that_json_can_hold(
    metric: Metric, trace: str, traces: dict[str, Trace]
) -> None:
    given = traces[trace]
    arrays = {f.name: getattr(given, f.name) for f in fields(given)}
    before = {k: a.copy() for k, a in arrays.items() if isinstance(a, np.ndarray)}
    first, again = metric.measure(given), metric.measure(given)
    assert json.dumps(first) == json.dumps(again)
    assert json.loads(json.dumps(first)) == first
    for name, array in before.items():
        np.testing.assert_array_equal(getattr(given, name), array)


class Own(Metric):
    """One that somebody has written."""

    def __init__(self, value: Callable[[Trace], Any]) -> None:
        self.measure = value  # type: ignore[method-assign]

    def measure(self, trace: Trace) -> Any: ...


def _writes(trace: Trace) -> int:
    trace.signals.clear()
    trace.task_error[:] = 99.0
    return 1


@pytest.mark.parametrize(
    ("value", "kept", "fault"),
    [
        (lambda trace: {"n": np.int64(3), "x": np.array([0.5])}, {"n": 3, "x": [0.5]}, ""),
        (lambda trace: 10**30, 1e30, ""),
        (lambda trace: 10**400, None, "OverflowError"),
        (lambda trace: {1, 2}, None, "TypeError: set is no number, text, list or dict"),
        (_writes, None, "read-only"),
    ],
)
def test_metrics_of_ones_own_give_json_and_write_to_nothing(
    value: Callable[[Trace], Any], kept: object, fault: str, traces: dict[str, Trace]
) -> None:
    given = replace(traces["good"], signals={"tau": traces["good"].v.copy()})
    before = given.task_error.copy()
    found, faults = measured({"own": Own(value)}, given)
    assert found == {"own": kept}
    assert fault in "; ".join(faults)
    np.testing.assert_array_equal(given.task_error, before)
    assert given.signals


def test_columns_of_studies_are_no_names_of_metrics() -> None:
    assert {*FIRST, *LAST, OWN_SEED} == OF_STUDIES
