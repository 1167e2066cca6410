"""The loop at 500 Hz, or another rate, for minutes, with a plant in another process.

python benchmarks/real_time.py --minutes 10 --rate 1000

The plant is ten joints that follow the positions they are sent with a lag of 10 ms, a thousand
times a second, and say where they are; the two processes share a piece of memory. NAO carries a box
after a target that goes round and arrives 60 times a second. The loop records its session on disk.
It prints how many periods were missed, how long a tick took from reading to writing, how far off
its time it began, and how memory grew; and, of a tenth of the time before, how late a loop is woken
that does nothing, which is what the machine itself keeps back.
"""

from __future__ import annotations

import argparse
import ctypes
import math
import multiprocessing
import os
import resource
import tempfile
import time
from collections.abc import Mapping
from dataclasses import replace
from multiprocessing.sharedctypes import RawArray
from pathlib import Path
from typing import Any

import numpy as np

import coopqp
from coopqp import OnlineLoop, real_time
from coopqp.base.spec import Array

SCENARIO = Path(__file__).parents[1] / "examples" / "teleoperation" / "nao.yaml"
LAG, STEP = 0.010, 0.001  # of the plant [s]
RATE = 60.0  # of the targets [Hz]
CENTRE, RADIUS, TURN = (0.16, 0.0, 0.055), 0.015, 3.0  # of their circle [m], [m], [s]


class Shared:
    """Numbers that one process writes and the other reads, whole or not at all.

    Args:
        n: how many.
    """

    def __init__(self, n: int) -> None:
        self._count = RawArray(ctypes.c_int64, 1)
        self._numbers = RawArray(ctypes.c_double, n)

    def write(self, numbers: Array) -> None:
        """Put them there; while the count is odd they are not whole."""
        self._count[0] += 1
        np.frombuffer(self._numbers)[:] = numbers
        self._count[0] += 1

    def read(self) -> Array:
        """What is there."""
        while True:
            before = self._count[0]
            found = np.frombuffer(self._numbers).copy()
            if before == self._count[0] and before % 2 == 0:
                return found


def plant(start: Array, told: Shared, said: Shared, stop: Any) -> None:
    """Joints with a lag, until they are told to stop."""
    q, due = start.copy(), time.monotonic()
    while not stop.is_set():
        q += (told.read() - q) * (STEP / LAG)
        said.write(q)
        due = max(due + STEP, time.monotonic())
        time.sleep(max(0.0, due - time.monotonic()))


class Driver:
    """A robot in another process, with a stop-watch on each tick.

    Args:
        start: where it is.
        ticks: how many there will be at most.
    """

    def __init__(self, start: Array, ticks: int) -> None:
        self._told, self._said = Shared(len(start)), Shared(len(start))
        self._told.write(start)
        self._said.write(start)
        self._stop = multiprocessing.Event()
        self.process = multiprocessing.Process(
            target=plant, args=(start, self._told, self._said, self._stop), daemon=True
        )
        self.process.start()
        self.began, self.ended = np.ones((2, ticks + 1000))  # written to, so that memory is there
        self.count, self._began = 0, 0.0

    def read(self) -> Array:
        """Where the joints are."""
        self._began = time.monotonic()
        return self._said.read()

    def write(self, q: Array, v: Array) -> None:
        """Send them there."""
        self._told.write(q)
        if self.count < len(self.ended):
            self.began[self.count], self.ended[self.count] = self._began, time.monotonic()
            self.count += 1

    def close(self) -> None:
        """End the other process."""
        self._stop.set()
        self.process.join()


class Targets:
    """A target on a circle, 60 times a second, and a look at the memory now and then."""

    def __init__(self, loop: OnlineLoop) -> None:
        self._loop, self._next, self._look = loop, 0.0, 0.0
        self.memory: list[tuple[float, float]] = []

    def __call__(self) -> Mapping[str, Any] | None:
        """What has arrived."""
        now = self._loop.now
        if now >= self._look:
            self._look = now + 10.0
            self.memory.append((now, resident()))
        if now < self._next:
            return None
        self._next = now + 1.0 / RATE
        angle = 2.0 * math.pi * now / TURN
        y, z = CENTRE[1] + RADIUS * math.sin(angle), CENTRE[2] + RADIUS * math.cos(angle)
        return {"target": ([CENTRE[0], y, z], now)}


def resident() -> float:
    """Memory of this process that is in RAM [MB]; where the system does not say, its peak."""
    try:
        pages = int(Path("/proc/self/statm").read_text().split()[1])
    except OSError:
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
    return pages * os.sysconf("SC_PAGE_SIZE") / 2**20


def woken_late(period: float, seconds: float) -> str:
    """How often a loop without work is woken by more than half a period late."""
    due, count, late, most = time.monotonic(), round(seconds / period), 0, 0.0
    for _ in range(count):
        due = max(due + period, time.monotonic())
        time.sleep(max(due - time.monotonic(), 0.0))
        behind = time.monotonic() - due
        late, most = late + (behind > 0.5 * period), max(most, behind)
    share = f"{100.0 * late / count:.4f} %"
    return (
        f"a loop without work: {late} of {count} so late ({share}), by {1e3 * most:.2f} ms at most"
    )


def percentiles(name: str, seconds: Array) -> str:
    """One line [ms]."""
    ms = 1e3 * np.percentile(seconds, [50, 99, 99.9, 99.99, 100])
    return f"{name:28s}" + "".join(f"{x:9.3f}" for x in ms)


def main() -> None:
    """Run and tell."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--rate", type=float, default=500.0, help="ticks a second")
    asked = parser.parse_args()
    minutes: float = asked.minutes
    scenario = replace(coopqp.load(SCENARIO), dt=1.0 / asked.rate)
    without_work = woken_late(scenario.dt, 6.0 * minutes)
    with tempfile.TemporaryDirectory() as folder:
        loop = OnlineLoop(scenario, patience=2.0, out=Path(folder) / "session")
        driver = Driver(scenario.chain.q_start, round(60.0 * minutes / scenario.dt))
        targets, load = Targets(loop), os.getloadavg()[0]
        try:
            ended = real_time(loop, driver, inputs=targets, duration=60.0 * minutes)
        finally:
            driver.close()
    tell(driver, scenario.dt, targets.memory)
    late = loop.watch.late
    print(f"late by more than half a period {late} ({100.0 * late / loop.ticks:.4f} %)")
    print(without_work)
    print(ended)
    print(
        f"processors {os.cpu_count()}, load {load:.1f} at the start, {os.getloadavg()[0]:.1f} now"
    )


def tell(driver: Driver, dt: float, memory: list[tuple[float, float]]) -> None:
    """Print the figures."""
    began, ended = driver.began[: driver.count - 1], driver.ended[: driver.count - 1]
    periods = np.diff(began)[1:]
    missed = int(np.sum(np.maximum(0, np.round(periods / dt) - 1)))
    print(f"{len(began)} ticks in {began[-1] - began[0]:.1f} s, period {1e3 * dt:g} ms")
    print(f"missed periods {missed} ({100.0 * missed / len(began):.4f} %)")
    print(
        f"{'[ms]':28s}" + "".join(f"{p:>9s}" for p in ("50 %", "99 %", "99.9 %", "99.99 %", "max"))
    )
    print(percentiles("reading to writing", ended - began))
    print(percentiles("off the period", np.abs(periods - dt)))
    begin = memory[min(3, len(memory) - 1)]
    print(f"memory {begin[1]:.1f} MB after {begin[0] - memory[0][0]:.0f} s, "
          f"{memory[-1][1]:.1f} MB at the end")  # fmt: skip


if __name__ == "__main__":
    main()
