"""What every metric keeps: it is a pure function of a trace that JSON can hold."""

from __future__ import annotations

import json
from dataclasses import fields

import numpy as np
import pytest
from example_metrics import EXAMPLES
from laws import LIMITS, NEAR, UNREACHABLE, problem, run

from coopqp.controllers import Pseudoinverse, QPController
from coopqp.metric import Metric
from coopqp.model.closed_chain import ClosedChain
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
    assert traces["good"].usable.all()
    assert not traces["stopped"].usable.all()
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
