"""What a recording costs the loop that it records, at 500 Hz.

python benchmarks/recording.py [--seconds 120]

Ten seconds without a recording and ten with one take turns, so that both see the same machine. A
tick's latency is from when it was due to when its command was there. Printed are percentiles [us].
"""

from __future__ import annotations

import argparse
import tempfile
import time
from contextlib import ExitStack
from pathlib import Path

import numpy as np

import coopqp
from coopqp.controller import Law
from coopqp.online.recording import LiveRecording
from coopqp.scenario.scenario import Scenario

PERIOD = 2_000_000  # [ns]
TURN = 10.0  # [s]
SHARES = (50, 99, 99.9, 100)


def turn(scenario: Scenario, law: Law, path: Path | None) -> tuple[list[float], list[float]]:
    """Latency of each tick and, where there is a recording, what it took of it [us]."""
    state = law.start(q_measured=scenario.chain.q_start)
    late, taken = [], []
    with ExitStack() as stack:
        recording = None
        if path:
            recording = LiveRecording(path, scenario, law, state, controller="qp")
            stack.enter_context(recording)
        due = time.perf_counter_ns() + PERIOD
        for _ in range(round(TURN * 1e9 / PERIOD)):
            while (left := due - time.perf_counter_ns()) > 0:
                time.sleep(left * 1e-9)
            before = time.perf_counter_ns()
            command = law.tick(state)
            after = time.perf_counter_ns()
            if recording:
                recording.tick(state, command, 1e-3 * (after - before))
                taken.append(1e-3 * (time.perf_counter_ns() - after))
            late.append(1e-3 * (time.perf_counter_ns() - due))
            state.advance(command.v, 1e-9 * PERIOD)
            state.q_measured = state.q.copy()
            due += PERIOD
        if recording and recording.dropped:
            print(f"dropped {recording.dropped}")
    return late, taken


def main() -> None:
    options = argparse.ArgumentParser()
    options.add_argument("--seconds", type=float, default=120.0)
    scenario = coopqp.load("point_on_point")
    law = scenario.controllers["qp"].build(scenario.problem())
    without: list[float] = []
    recorded: list[float] = []
    taken: list[float] = []
    with tempfile.TemporaryDirectory() as folder:
        for i in range(max(1, round(options.parse_args().seconds / 2 / TURN))):
            without += turn(scenario, law, None)[0]
            path = Path(folder) / f"{i}.arrows"
            late, took = turn(scenario, law, path)
            recorded, taken = recorded + late, taken + took
            size = path.stat().st_size
    print("percentile      " + "".join(f"{share:>10}" for share in SHARES))
    rows = {"without": without, "recorded": recorded, "recording.tick": taken}
    for name, values in rows.items():
        print(f"{name:16}" + "".join(f"{x:10.0f}" for x in np.percentile(values, SHARES)))
    missed = [np.mean(np.array(v) > 1e-3 * PERIOD) for v in (without, recorded)]
    print(f"over a period: {missed[0]:.2%} without, {missed[1]:.2%} recorded")
    print(f"file: {size / TURN / 1e3:.0f} kB/s")


if __name__ == "__main__":
    main()
