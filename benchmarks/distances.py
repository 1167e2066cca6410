"""What keeping bodies apart costs a tick of the kernel, and a check of a configuration.

    python benchmarks/distances.py [--rounds 15] [--busy 1]

The same motions of shipped scenarios with and without self_collision take turns in one process,
quiet and then beside busy loops; pairs that start too near are ignored. "own" is the scenario's
motion, "goal" one towards a random goal, into the robot itself and things in the world; "alone" is
the scenario's motion with self_collision as its only limit. Of the slowest ticks the fastest round
of each counts. Checks are of random configurations, 200 in a call.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from statistics import median
from time import perf_counter, perf_counter_ns

import numpy as np
from peers import busy

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from watched_bodies import driven, watching, without_bodies

from coopqp.base.spec import Array
from coopqp.controller import ControlProblem
from coopqp.controllers import QPController
from coopqp.kernel.free_space import FreeSpace
from coopqp.kernel.law import KernelLaw

SCENARIOS = ("two_pandas", "two_so101", "tiago_torso", "baxter_tray", "pr2_circle", "three_ur")
TICKS, CHECKS, CALLS = 300, 20_000, 100


def main() -> None:
    parser = argparse.ArgumentParser(prog="benchmarks/distances.py", description=__doc__)
    parser.add_argument("--rounds", type=int, default=15)
    parser.add_argument("--busy", type=int, default=1, help="loops beside the second table")
    asked = parser.parse_args()
    for loops in sorted({0, asked.busy}):
        with busy(loops):
            print(f"beside {loops} busy loop(s)" if loops else "nothing beside it")
            table(asked.rounds)


def table(rounds: int) -> None:
    head = "".join(f" {word:>16}" for word in ("without", "with", "more", "slowest 1 %", "a check"))
    print(f"{'us: median (best)':24} {head}", flush=True)
    for name in SCENARIOS:
        own, goal = watching(name, things=False), driven(name, 1)
        alone = watching(name, things=False, alone=True)
        check = checked(own)
        for how, problem in (("own", own), ("goal", goal), ("alone", alone)):
            laws = {with_: law_of(p) for with_, p in ((False, without(problem)), (True, problem))}
            print(f"{name:18} {how:5} {row(laws, rounds)} {check:16.2f}", flush=True)


def without(problem: ControlProblem) -> ControlProblem:
    return replace(problem, limits=without_bodies(problem.limits))


def law_of(problem: ControlProblem) -> KernelLaw:
    law = QPController(engine="kernel").build(problem)
    assert isinstance(law, KernelLaw)
    return law


def row(laws: Mapping[bool, KernelLaw], rounds: int) -> str:
    """Of a motion's median ticks the median of the rounds, and the best; and its slowest."""
    turns = [{with_: ticks(law) for with_, law in laws.items()} for _ in range(rounds)]
    plain, kept = ([median(turn[with_]) for turn in turns] for with_ in (False, True))
    more = [b - a for a, b in zip(plain, kept, strict=True)]
    slow = np.quantile(np.min([turn[True] for turn in turns], axis=0), 0.99)
    return " ".join(cell(times) for times in (plain, kept, more)) + f" {slow:16.1f}"


def cell(times: list[float]) -> str:
    return f"{f'{median(times):.1f} ({min(times):.1f})':>16}"


def ticks(law: KernelLaw) -> list[float]:
    """Of each tick of a motion [us]; each is the kernel's."""
    state, times = law.start(), []
    for _ in range(TICKS):
        before = perf_counter_ns()
        law.step(state)
        times.append(1e-3 * (perf_counter_ns() - before))
        assert law.compiled
    return times


def checked(problem: ControlProblem) -> float:
    """A check of a random configuration, of each call of some the fastest of five [us]."""
    chain = problem.chain
    space = FreeSpace(chain, [limit.program(chain, problem.dt) for limit in problem.limits])
    q = np.array(list(chain.sample(np.random.default_rng(0), CHECKS)))
    calls = np.array_split(q, CALLS)
    return 1e6 * sum(min(seconds(space, some) for _ in range(5)) for some in calls) / CHECKS


def seconds(space: FreeSpace, q: Array) -> float:
    before = perf_counter()
    space.is_free(q)
    return perf_counter() - before


if __name__ == "__main__":
    main()
