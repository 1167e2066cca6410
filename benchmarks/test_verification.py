"""What safety costs: the tick with and without verification, and one explanation.

Rows get their names when the law is built, so naming costs a tick nothing.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from time import perf_counter

import numpy as np
import pytest
from laws import ticks
from pytest_benchmark.fixture import BenchmarkFixture

from coopqp.controller import ControlProblem
from coopqp.controllers import QPController
from coopqp.qp_law.law import QPLaw
from coopqp.qp_law.level import Program
from coopqp.scenario.loader import load
from coopqp.scenario.scenario import Scenario
from coopqp.solver import Status
from coopqp.study.explanation import explain
from coopqp.study.tick_record import record_tick

TICKS = 300
TURNS = 61
TARGET = 1.0 / 3.0  # of a tick of the plain law


def motion(law: QPLaw) -> Callable[[], None]:
    """The whole motion of the scenario."""

    def whole() -> None:
        for _ in ticks(law, law.start(), TICKS):
            pass

    return whole


@pytest.mark.benchmark(group="verification")
def test_tick_verified(benchmark: BenchmarkFixture, scenario: Scenario) -> None:
    """As it is."""
    benchmark(motion(QPController().plain(scenario.problem())))


@pytest.mark.benchmark(group="verification")
def test_tick_unverified(benchmark: BenchmarkFixture, scenario: Scenario) -> None:
    """The solver's word taken for everything, and no look at the loops after the step."""
    benchmark(motion(trusting(scenario.problem())))


@pytest.mark.benchmark(group="verification")
@pytest.mark.parametrize("levels", [1, 2])
def test_share(benchmark: BenchmarkFixture, scenario: Scenario, levels: int) -> None:
    """Share of a tick, the best of both over turns, so that a slow moment hits neither."""
    problem = scenario.problem()
    if levels == 1:
        problem = replace(problem, secondary=())
    verified = motion(QPController().plain(problem))
    unverified = motion(trusting(problem))
    times: list[tuple[float, float]] = []

    def measure() -> None:
        times.extend((seconds(verified), seconds(unverified)) for _ in range(TURNS))

    benchmark.pedantic(measure, rounds=1)
    whole, bare = (1e6 / TICKS * min(column) for column in zip(*times, strict=True))
    share = benchmark.extra_info["share"] = (whole - bare) / whole
    print(f"\n{levels} levels: {whole:.1f} us a tick, {share:.1%} of it verification")
    assert share <= TARGET


def trusting(problem: ControlProblem) -> QPLaw:
    """The law without any verification."""
    law = QPController().plain(problem)
    law.first._verifier.check = lambda: Status.OPTIMAL  # type: ignore[method-assign]
    for level in law.later:
        program = level._program  # by how many coordinates are left
        level._program = partial(_trusted, program)  # type: ignore[method-assign]
    law.probe.within = lambda state, v: True  # type: ignore[method-assign]
    return law


def _trusted(program: Callable[[int], Program], free: int) -> Program:
    made = program(free)
    made._verifier.check = lambda: Status.OPTIMAL  # type: ignore[method-assign]
    return made


def seconds(motion: Callable[[], None]) -> float:
    """How long it takes."""
    begin = perf_counter()
    motion()
    return perf_counter() - begin


@pytest.mark.benchmark(group="explain")
def test_explanation(benchmark: BenchmarkFixture) -> None:
    """Record a blocked tick and explain it; at most 50 ms."""
    scenario = load("joint_limit_stress")
    law = QPController().plain(scenario.problem())
    state = law.start()
    for _ in ticks(law, state, 150):
        pass

    def once() -> str:
        record = record_tick(law, state, scenario="", controller="qp", tick=150)
        return explain(record).sentence

    assert "RElbowRoll" in benchmark(once)
    assert np.isfinite(state.q).all()
