"""Many motions at once: run_many beside law.run and law.step, ticks a second and ratios.

python benchmarks/many.py [SCENARIO]    rounds take turns; median and best; under a minute
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from statistics import median
from time import perf_counter

import numpy as np

import coopqp
from coopqp import ClosedChain, Scenario
from coopqp.base.spec import Array

ROUNDS, MOTIONS, TICKS = 9, 256, 300


def near(chain: ClosedChain, count: int) -> Array:
    """Starts near the scenario's own, with loops closed."""
    rng, state = np.random.default_rng(0), coopqp.State(chain)
    found = []
    for _ in range(count):
        state.q[:] = chain.q_start + 0.05 * rng.normal(size=chain.n)
        state.update()
        state.close_loops(4)
        found.append(np.clip(state.q, chain.lower, chain.upper))
    return np.array(found)


def ways_of(scenario: Scenario, starts: Array) -> dict[str, tuple[Callable[[], object], int]]:
    """How to run motions, and how many it runs."""
    law = scenario.controllers["qp"].build(scenario.problem())

    def stepped() -> None:
        for q in starts[: MOTIONS // 8]:
            state = law.start(q)
            for _ in range(TICKS):
                law.step(state)

    def ran() -> None:
        for q in starts:
            law.run(law.start(q), TICKS)

    def many(threads: int) -> None:
        coopqp.run_many(scenario, starts, ticks=TICKS, threads=threads)

    return {
        "law.step": (stepped, MOTIONS // 8),
        "law.run": (ran, MOTIONS),
        "run_many, 1 thread": (lambda: many(1), MOTIONS),
        "run_many, 2 threads": (lambda: many(2), MOTIONS),
    }


def main(name: str) -> None:
    """Ticks a second of each way, and how often as many as by law.run."""
    scenario = coopqp.load(name)
    starts = near(scenario.chain, MOTIONS)
    ways = ways_of(scenario, starts)
    rates: dict[str, list[float]] = {way: [] for way in ways}
    for _ in range(ROUNDS):
        for way, (work, motions) in ways.items():
            before = perf_counter()
            work()
            rates[way].append(motions * TICKS / (perf_counter() - before))
    first = rates["law.run"]
    print(f"{name}: {'ticks/s':>26} {'best':>10} {'of law.run':>12}")
    for way, rate in rates.items():
        ratio = median(a / b for a, b in zip(rate, first, strict=True))
        print(f"{way:24} {median(rate):18.0f} {max(rate):10.0f} {ratio:12.2f}")
    found = coopqp.run_many(scenario, starts, ticks=TICKS)
    print(f"{100.0 * found.share(coopqp.Status.OPTIMAL):.2f} % OPTIMAL, "
          f"{100.0 * found.compiled.mean():.2f} % the kernel's")  # fmt: skip


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else "point_on_point")
