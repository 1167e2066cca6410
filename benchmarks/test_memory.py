"""Memory over a million ticks: nothing may grow."""

from __future__ import annotations

import gc
import os
from pathlib import Path

from pytest_benchmark.fixture import BenchmarkFixture

from coopqp.controllers import QPController
from coopqp.scenario.scenario import Scenario

TICKS = 1_000_000
WARM_UP = 50_000  # caches and allocators have settled
GROWTH = 1.0  # [MB], the resolution of what the kernel reports


def resident_mb() -> float:
    """Resident memory of this process [MB]."""
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def test_a_million_ticks_do_not_grow(benchmark: BenchmarkFixture, scenario: Scenario) -> None:
    """Ticks back and forth along the scenario's motion."""
    problem = scenario.problem()
    law = QPController().build(problem)
    plant = scenario.plant.build(problem, 0, scenario.disturbance)
    state = law.start()

    def ticks(count: int) -> None:
        for k in range(count):
            if k % scenario.ticks == 0:
                state.t = 0.0
            plant.step(state, law.tick(state))

    ticks(WARM_UP)
    gc.collect()
    before = resident_mb()
    benchmark.pedantic(ticks, args=(TICKS,), rounds=1)
    gc.collect()
    growth = resident_mb() - before
    benchmark.extra_info["growth_mb"] = growth
    assert growth < GROWTH
