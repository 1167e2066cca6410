"""What safety costs: the tick with and without verification, and one explanation."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from coopqp.controllers.qp import QPLaw
from coopqp.explanation import explain, record_tick
from coopqp.scenario import Scenario, load
from coopqp.solver import Status

TICKS = 300


def motion(law: QPLaw, dt: float) -> Callable[[], None]:
    """The whole motion of the scenario."""

    def ticks() -> None:
        state = law.start()
        for _ in range(TICKS):
            state.update()
            state.q += law.tick(state).v * dt
            state.t += dt

    return ticks


@pytest.mark.benchmark(group="verification")
def test_tick_verified(benchmark: BenchmarkFixture, scenario: Scenario) -> None:
    """As it is."""
    benchmark(motion(QPLaw(scenario.problem(), 1e-6), scenario.dt))


@pytest.mark.benchmark(group="verification")
def test_tick_unverified(benchmark: BenchmarkFixture, scenario: Scenario) -> None:
    """The solver's word taken for everything, and no look at the loops after the step."""
    law = QPLaw(scenario.problem(), 1e-6)
    for level in law.levels:
        level._verifier.check = lambda: Status.OPTIMAL  # type: ignore[method-assign]
    law._probe.within = lambda state, v: True  # type: ignore[method-assign]
    benchmark(motion(law, scenario.dt))


@pytest.mark.benchmark(group="explain")
def test_explanation(benchmark: BenchmarkFixture) -> None:
    """Record a blocked tick and explain it; at most 50 ms."""
    scenario = load("joint_limit_stress")
    law = QPLaw(scenario.problem(), 1e-6)
    state = law.start()
    for _ in range(150):
        state.update()
        state.v[:] = law.tick(state).v
        state.q += state.v * scenario.dt
        state.t += scenario.dt
    state.update()

    def once() -> str:
        record = record_tick(law, state, scenario="", controller="qp", tick=150)
        return explain(record).sentence

    assert "RElbowRoll" in benchmark(once)
    assert np.isfinite(state.q).all()
