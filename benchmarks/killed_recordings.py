"""How much a recording loses when its process is killed at any moment (SIGKILL).

python benchmarks/killed_recordings.py [--kills 20]

Each process runs a loop at 500 Hz and says every tick on a pipe. Printed is the time between the
last tick that it said and the last that is in its file [ms].
"""

from __future__ import annotations

import argparse
import random
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import coopqp
from coopqp.online.recording import LiveRecording
from coopqp.recordings import read

PERIOD = 0.002  # [s]


def loop(path: Path) -> None:
    """Run until killed."""
    scenario = coopqp.load("point_on_point")
    law = scenario.controllers["qp"].build(scenario.problem())
    state = law.start(q_measured=scenario.chain.q_start)
    recording = LiveRecording(path, scenario, law, state, controller="qp")
    tick = 0
    while True:
        command = law.tick(state)
        recording.tick(state, command, 100.0)
        print(tick, time.monotonic(), flush=True)
        state.advance(command.v, PERIOD)
        state.q_measured = state.q.copy()
        tick += 1
        time.sleep(PERIOD)


def killed(path: Path, after: float) -> float:
    """What was lost of a process that was killed after a time [ms]."""
    code = [sys.executable, __file__, "--loop", str(path)]
    said: list[list[str]] = []
    with subprocess.Popen(code, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout
        said.append(process.stdout.readline().split())
        end = time.monotonic() + after
        while time.monotonic() < end:
            said.append(process.stdout.readline().split())
        process.kill()
        said += [line.split() for line in process.stdout.read().splitlines()]
    when = {int(words[0]): float(words[1]) for words in said if len(words) == 2}
    rows = read(path).columns["tick"].tolist()
    assert rows == list(range(len(rows)))
    return 1e3 * (when[max(when)] - when[rows[-1]])


def main() -> None:
    options = argparse.ArgumentParser()
    options.add_argument("--kills", type=int, default=20)
    options.add_argument("--loop", type=Path)
    given = options.parse_args()
    if given.loop:
        loop(given.loop)
    chance = random.Random(14)
    with tempfile.TemporaryDirectory() as folder:
        paths = (Path(folder) / f"{i}.arrows" for i in range(given.kills))
        lost = [killed(path, chance.uniform(0.5, 2.0)) for path in paths]
    print(f"{len(lost)} kills, lost on average and at most [ms]:")
    print(f"{sum(lost) / len(lost):.0f} {max(lost):.0f}")


if __name__ == "__main__":
    main()
