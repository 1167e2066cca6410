"""The kernel and the plain law side by side: ticks from Python in alternation.

python benchmarks/kernel.py           a table in us, and ratios
python benchmarks/kernel.py --own     a task of three rows in Python, beside the shipped one
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import replace
from statistics import median
from time import perf_counter, perf_counter_ns

import numpy as np
from test_scaling import job

from coopqp import ClosedChain, Evaluate, State, Task, TaskRows, spec
from coopqp.controller import ControlProblem, Law
from coopqp.controllers import QPController
from coopqp.scenario.loader import load
from coopqp.tasks import JointCentering, PointOnPoint

ROUNDS, TICKS = 15, 300
SCENARIOS = ("point_on_point", "baxter_tray", "two_pandas", "three_ur", "tiago_torso", "regrasp")
ARMS = (2, 3, 4, 8)


def problems() -> Iterator[tuple[str, ControlProblem]]:
    """Shipped scenarios, then seven-joint arms round one object, all with joint centring."""
    for name in SCENARIOS:
        yield name, load(name).problem()
    for count in ARMS:
        yield f"{count} arms", replace(job(count), secondary=[JointCentering(gain=0.5)])


def tick_us(law: Law) -> float:
    """Median of a motion [us]."""
    state, times = law.start(), []
    for _ in range(TICKS):
        before = perf_counter_ns()
        command = law.tick(state)
        times.append(perf_counter_ns() - before)
        state.advance(command.v, law.problem.dt)
    return 1e-3 * median(times)


def table() -> None:
    """Medians of rounds that take turns, and the best of each."""
    print(f"{'':16} {'kernel':>8} {'python':>8} {'ratio':>7} {'best':>6} {'best':>6} {'ratio':>7}")
    for name, problem in problems():
        laws = [QPController(engine=engine).build(problem) for engine in ("kernel", "python")]
        rounds = [[tick_us(law) for law in laws] for _ in range(ROUNDS)]
        kernel, python = (sorted(times) for times in zip(*rounds, strict=True))
        ratio = median(p / k for k, p in rounds)
        line = f"{name:16} {median(kernel):8.2f} {median(python):8.1f} {ratio:7.1f}"
        print(f"{line} {kernel[0]:6.2f} {python[0]:6.1f} {python[0] / kernel[0]:7.1f}", flush=True)


@spec
class OwnReach(Task):
    """As docs/plugins/task.md shows: the object's origin goes to a place (3 rows)."""

    goal: tuple[float, float, float]

    def rows(self, chain: ClosedChain) -> tuple[str, ...]:
        return ("x", "y", "z")

    def bind(self, start: State) -> Evaluate:
        goal = np.array(self.goal)

        def evaluate(state: State, rows: TaskRows) -> None:
            rows.e[:] = state.p_WO - goal
            rows.J[:] = state.J_task[:3]

        return evaluate


def own() -> None:
    """Medians of rounds that take turns, and the best, by law.step and by law.run [us]."""
    given, goal = load("point_on_point").problem(), (0.19, 0.02, 0.05)
    tasks = OwnReach(goal=goal), PointOnPoint(goal=goal)
    laws = [QPController(engine="kernel").build(replace(given, tasks=(task,))) for task in tasks]
    rounds = [[us for law in laws for us in step_and_run_us(law)] for _ in range(ROUNDS)]
    for name, times in zip(
        ("own, step", "own, run", "shipped, step", "shipped, run"),
        zip(*rounds, strict=True), strict=True,
    ):  # fmt: skip
        print(f"{name:16} {median(times):6.2f} {min(times):6.2f}")


def step_and_run_us(law: Law) -> tuple[float, float]:
    """Of a tick of a motion."""
    state, before = law.start(), perf_counter()
    for _ in range(TICKS):
        law.step(state)
    stepped, state, again = perf_counter() - before, law.start(), perf_counter()
    law.run(state, TICKS)
    return 1e6 * stepped / TICKS, 1e6 * (perf_counter() - again) / TICKS


if __name__ == "__main__":
    own() if "--own" in sys.argv else table()
