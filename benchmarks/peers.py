"""One tick beside the peers, all in one run and in turns: quiet, beside a busy loop, and cold.

sh benchmarks/placo_env.sh; pip install mink    # once; without them their columns are empty
python benchmarks/peers.py                      # under four minutes
python benchmarks/peers.py --rounds 5 --only NAO

The job is that of ``peer_jobs.py``. A round is a motion of 300 ticks of each system, one after the
other; its number is the median of its ticks. Printed are the medians of the rounds, and the best. A
cold tick comes after a millisecond of sleep, as in a loop of 1 kHz.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from statistics import median
from time import monotonic

import peer_systems
from peer_jobs import Job, jobs
from peer_systems import Motion

HERE = Path(__file__).parent
SYSTEMS = {
    "kernel": peer_systems.kernel,
    "python": peer_systems.plain,
    "Pink": peer_systems.pinks,
    "mink": peer_systems.minks,
    "by hand": peer_systems.by_hand,
}
PLACO = "PlaCo"
LONGEST = 75.0  # of a table; fewer rounds where the machine is slow [s]
NEAR = 5e-3  # all end this close to the last target [m]
PAUSE = 1e-3  # before a cold tick [s]
BUSY = "while True: pass"
Rounds = dict[str, list[float]]


def main() -> None:
    """Print the tables."""
    asked = arguments()
    wanted = [job for job in jobs() if not asked.only or job.name in asked.only]
    print(", ".join(f"{name} {found(name)}" for name in ("pin-pink", "mink", "daqp", "pin")))
    with ExitStack() as stack:
        placo = stack.enter_context(placo_beside(asked.placo, wanted))
        motions = {job.name: motions_of(job, placo) for job in wanted}
        for loops, pause in ((0, 0.0), (asked.busy, 0.0), (0, PAUSE)):
            with busy(loops):
                measured = in_turns(motions, asked.rounds, pause)
            words = f"beside {loops} busy loop(s)" if loops else "nothing beside it"
            words = "cold, after 1 ms of sleep each" if pause else words
            rounds = len(next(iter(measured.values()))["kernel"])
            print(f"\n{words}: median of {rounds} rounds, and the best [us a tick]")
            table(measured)


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=15)
    parser.add_argument("--busy", type=int, default=1, help="how many loops run beside")
    parser.add_argument("--only", nargs="*", help="names of jobs, such as NAO or '8 arms'")
    parser.add_argument("--placo", type=Path, default=Path(".placo"), help="its environment")
    return parser.parse_args()


def motions_of(job: Job, placo: subprocess.Popen[str] | None) -> dict[str, Motion]:
    """A job's motions by system; those that are not installed are left out."""
    made = {name: make(job) for name, make in SYSTEMS.items()}
    if placo:
        made[PLACO] = lambda pause: answered(placo, job.name, pause)
    return {name: motion for name, motion in made.items() if motion}


def in_turns(motions: dict[str, dict[str, Motion]], rounds: int, pause: float) -> dict[str, Rounds]:
    """Times of every round [us], by job and system; a slow moment hits whoever runs then."""
    found: dict[str, Rounds] = {job: {name: [] for name in of} for job, of in motions.items()}
    end = monotonic() + LONGEST
    for k in range(rounds):
        if k and monotonic() > end:
            break
        for job, of_job in motions.items():
            for name, motion in of_job.items():
                us, missed = motion(pause)
                if not missed < NEAR:
                    sys.exit(f"{name} on {job} ends {1e3 * missed:.1f} mm from the target")
                found[job][name].append(us)
    return found


def table(measured: dict[str, Rounds]) -> None:
    """Medians and best of each system, and the kernel's ratio to PlaCo."""
    names = [*SYSTEMS, PLACO]
    print(f"{'':8}" + "".join(f"{name:>16}" for name in names) + "   kernel / PlaCo")
    for job, rounds in measured.items():
        print(f"{job:8}" + "".join(cell(rounds.get(name, ())) for name in names), end="")
        if PLACO in rounds:
            ours, theirs = rounds["kernel"], rounds[PLACO]
            print(f"   {median(ours) / median(theirs):.2f} ({min(ours) / min(theirs):.2f})", end="")
        print(flush=True)


def cell(times: Sequence[float]) -> str:
    """Median and best."""
    return f"{median(times):8.1f} {f'({min(times):.1f})':>7}" if times else f"{'-':>16}"


@contextmanager
def placo_beside(folder: Path, wanted: Sequence[Job]) -> Iterator[subprocess.Popen[str] | None]:
    """PlaCo in its own environment, which waits until it is its turn; None where there is none."""
    python = folder / "bin" / "python"
    if not python.exists():
        print(f"no PlaCo in {folder}: run sh benchmarks/placo_env.sh")
        yield None
        return
    with tempfile.NamedTemporaryFile("w", suffix=".json") as file:
        json.dump([job.flat() for job in wanted], file)
        file.flush()
        command = [str(python), str(HERE / "placo_peer.py"), file.name]
        pipe = subprocess.PIPE
        with subprocess.Popen(command, stdin=pipe, stdout=pipe, text=True) as process:
            try:
                yield process
            finally:
                process.kill()


def answered(placo: subprocess.Popen[str], job: str, pause: float) -> tuple[float, float]:
    """One motion of PlaCo; it says other things too."""
    assert placo.stdin
    assert placo.stdout
    placo.stdin.write(f"{job} {pause}\n")
    placo.stdin.flush()
    for line in placo.stdout:
        if line.startswith("placo "):
            _, us, missed = line.split()
            return float(us), float(missed)
    sys.exit("PlaCo has ended")


@contextmanager
def busy(count: int) -> Iterator[None]:
    """So many loops that only take time."""
    loops = [subprocess.Popen([sys.executable, "-c", BUSY]) for _ in range(count)]
    try:
        yield
    finally:
        for loop in loops:
            loop.kill()
            loop.wait()


def found(name: str) -> str:
    """Its version."""
    try:
        return version(name)
    except PackageNotFoundError:
        return "is not installed"


if __name__ == "__main__":
    main()
