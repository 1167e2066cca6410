"""Internal force and loop offset, by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import coopqp
from coopqp.metrics.internal_force import InternalForce
from coopqp.metrics.loop_offset import LoopOffset
from coopqp.trace import Trace


@pytest.fixture(scope="module")
def trace() -> Trace:
    return coopqp.run(coopqp.load("point_on_point"), controller="qp")


def test_the_largest_force_of_a_hand_at_worst_and_in_the_last_half_second(trace: Trace) -> None:
    wrench = np.zeros((trace.ticks, 12))
    wrench[10, :3] = [3.0, 0.0, 4.0]
    wrench[10, 3:6] = [0.0, 6.0, 8.0]  # a moment is no force
    wrench[-50:, 6:9] = [0.0, 2.0, 0.0]
    squeezed = replace(trace, signals={"internal_wrench": wrench})
    assert InternalForce().measure(squeezed) == {
        "worst": 5.0, "end": 2.0, "moment_worst": 10.0, "moment_end": 0.0,
    }  # fmt: skip


def test_plants_that_do_not_tell_the_force_have_none(trace: Trace) -> None:
    assert InternalForce().measure(trace) is None


def test_the_loop_offset_is_the_last_and_largest(trace: Trace) -> None:
    loop_offset = np.zeros((trace.ticks, 12))
    loop_offset[5] = 1.0
    loop_offset[-1, :3], loop_offset[-1, 9:] = [3e-3, 0.0, 4e-3], [0.0, 0.01, 0.0]
    found = LoopOffset().measure(replace(trace, loop_offset=loop_offset))
    assert found == {"position": pytest.approx(5e-3), "orientation": pytest.approx(0.01)}
