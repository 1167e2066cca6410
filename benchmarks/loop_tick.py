"""A tick of the loop for robots beside ``law.step`` of the same law, in turns, in one run.

sh benchmarks/placo_env.sh     # once, for PlaCo's column
python benchmarks/loop_tick.py

Joints follow with a lag and are measured with noise; the reading is made outside of the time. A
round is a motion of 300 ticks of each, its numbers are the median and the mean of its ticks:
``law.step``, ``OnlineLoop.tick``, that without the monitor of faults, that with a recording on
disk, and PlaCo's bare tick in the job of ``peers.py`` (for two Pandas that of two such arms).
Cold: each tick after 1 ms of sleep.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from statistics import mean, median
from time import perf_counter_ns
from unittest.mock import patch

import numpy as np
import peers
from peer_jobs import jobs
from test_scaling import READY, job, ring

import coopqp
from coopqp import OnlineLoop
from coopqp.base.spec import spec
from coopqp.controller import Law
from coopqp.controllers import QPController
from coopqp.online.faults import FaultMonitor
from coopqp.online.recording import LiveRecording
from coopqp.robot import Robot, RobotModel
from coopqp.scenario.scenario import Scenario
from coopqp.tasks import JointCentering

TICKS, COLD, FIRST = 300, 200, 20  # of a motion; of a cold one; left out, as the loop begins there
LAG, NOISE = 0.5, 2e-4  # share of the way in a tick; of an encoder [rad]
SLEEP = 1e-3  # [s]
PLACO = {"NAO": "NAO", "two Pandas": "2 arms", "eight arms": "8 arms"}
Times = list[float]


@spec
class Ring(Robot):
    """Arms on a circle, as in test_scaling.py."""

    count: int = 8

    def build(self) -> RobotModel:
        """Seven joints each."""
        return ring(self.count)


def scenarios() -> Iterator[tuple[str, Scenario]]:
    """Each with its name in the table."""
    yield "NAO", coopqp.load("point_on_point")
    yield "two Pandas", coopqp.load("two_pandas")
    task = job(8).tasks[0]
    start = {arm.name: READY for arm in ring(8).arms}
    centring = (JointCentering(gain=0.5),)
    controllers = {"qp": QPController()}
    yield "eight arms", Scenario(
        name="ring", robot=Ring(), start=start, tasks=(task,), secondary=centring,
        controllers=controllers, duration=TICKS * 0.01,
    )  # fmt: skip


def timed(tick: Callable[[], object], sleep: float) -> float:
    """What one call takes [us]."""
    if sleep:
        time.sleep(sleep)
    before = perf_counter_ns()
    tick()
    return 1e-3 * (perf_counter_ns() - before)


def steps(law: Law, ticks: int, sleep: float) -> Times:
    """``law.step`` along a motion [us]."""
    state = law.start()
    return [timed(lambda: law.step(state), sleep) for _ in range(ticks)][FIRST:]


def loop_ticks(scenario: Scenario, ticks: int, sleep: float, folder: str = "") -> Times:
    """``OnlineLoop.tick`` along one [us]; with a recording where there is a folder."""

    def record(loop: OnlineLoop) -> LiveRecording:
        path = Path(folder) / f"{time.monotonic_ns()}.arrows"
        return LiveRecording(path, loop.scenario, loop.law, loop.state, controller="qp",
                             source=loop.source or "name: none")  # fmt: skip

    loop = OnlineLoop(scenario, clock=None, record=record if folder else None)
    rng, q, times = np.random.default_rng(0), scenario.chain.q_start.copy(), []
    for _ in range(ticks):
        reading = q + NOISE * rng.standard_normal(len(q))
        times.append(timed(partial(loop.tick, reading), sleep))
        q += LAG * (loop.setpoint - q)
    loop.close()
    assert loop.status.usable, loop.note
    assert loop.law.compiled
    return times[FIRST:]


def table(given: list[tuple[str, Scenario]], rounds: int, ticks: int, sleep: float) -> None:
    """Medians of the rounds and the best, and ratios to ``law.step`` of both."""
    wanted = [each for each in jobs() if each.name in PLACO.values()]
    columns = ("law.step", "loop.tick", "no monitor", "recorded", "PlaCo")
    print(
        f"{'':12}" + "".join(f"{c:>16}" for c in columns) + "   loop/step       mean of loop.tick"
    )
    with peers.placo_beside(Path(".placo"), wanted) as placo, tempfile.TemporaryDirectory() as out:
        for name, scenario in given:
            law = OnlineLoop(scenario, clock=None).law
            found: dict[str, Times] = {column: [] for column in columns}
            means: Times = []
            for _ in range(rounds):
                looped = loop_ticks(scenario, ticks, sleep)
                means.append(mean(looped))
                found["law.step"].append(median(steps(law, ticks, sleep)))
                found["loop.tick"].append(median(looped))
                with patch.object(FaultMonitor, "update", lambda *_: None):
                    found["no monitor"].append(median(loop_ticks(scenario, ticks, sleep)))
                found["recorded"].append(median(loop_ticks(scenario, ticks, sleep, out)))
                if placo:
                    found["PlaCo"].append(peers.answered(placo, PLACO[name], sleep)[0])
            step, loop = found["law.step"], found["loop.tick"]
            ratios = f"{median(loop) / median(step):.1f} ({min(loop) / min(step):.1f})"
            cells = "".join(peers.cell(found[column]) for column in columns)
            print(f"{name:12}{cells}   {ratios:14}{peers.cell(means)}", flush=True)


def main() -> None:
    """All three tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=15)
    rounds = parser.parse_args().rounds
    given = list(scenarios())
    for busy, sleep in ((0, 0.0), (1, 0.0), (0, SLEEP)):
        words = "beside a busy loop" if busy else "nothing beside it"
        cold = f", cold: after {1e3 * sleep:g} ms of sleep" if sleep else ""
        print(f"\n{words}{cold}: median of {rounds} rounds, and the best [us a tick]")
        few, ticks = (max(3, rounds // 3), COLD) if sleep else (rounds, TICKS)
        with peers.busy(busy):
            table(given, few, ticks, sleep)


if __name__ == "__main__":
    main()
