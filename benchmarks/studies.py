"""Studies: throughput against a plain loop, results whoever is killed, and equal rows on Dask.

    python -m benchmarks.studies                      2,000 short variants: loop, then two processes
    python -m benchmarks.studies --kills 10           as many clients and workers killed on the way
    python -m benchmarks.studies --scheduler ADDRESS  the same study on a Dask cluster
    python -m benchmarks.studies --dask --kills 10    on a scheduler and two workers that it starts,
                                                      which are killed on the way

The first prints how much faster two processes do the study than one does (--jobs 1), and than a
plain loop over its variants, which keeps no results; and what two processes without any engine
reach, each with half of the variants: no engine can do more than that on a machine whose cores slow
each other down. They take turns, each as often as --rounds says; the best of each counts.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import random
import resource
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from joblib.externals.loky import get_reusable_executor
from pyarrow import parquet as pq

from coopqp.scenario.loader import shipped
from coopqp.study.engine import Engine
from coopqp.study.sweep import Progress, Study, read_study, sweep
from coopqp.study.sweep.results import head_of, records
from coopqp.study.sweep.sweep import job_of, run_variant

STUDY = """scenario: short.yaml
vary:
  tasks.slide.goal: {{box: [[0.24, -0.10, 0.0], [0.46, 0.20, 0.0]]}}
  object.mass: {{log: [0.1, 2.0]}}
samples: {{random: {variants}, seed: 1}}
"""
TICKS = 50  # of a variant
SHORT = {"duration: 3.0": "duration: 0.5", "duration: 2.0": "duration: 0.4"}
CONTROLLERS = "controllers: [qp, pseudoinverse, pseudoinverse_null_space, damped_pseudoinverse]"


def written(folder: Path, variants: int) -> Path:
    """A study of the planar pair, half a second a variant under the QP law."""
    folder.mkdir(exist_ok=True)
    text = shipped()["planar_pair"].read_text(encoding="utf-8")
    for before, after in {**SHORT, CONTROLLERS: "controllers: [qp]"}.items():
        assert before in text
        text = text.replace(before, after)
    (folder / "short.yaml").write_text(text, encoding="utf-8")
    (folder / "study.yaml").write_text(STUDY.format(variants=variants), encoding="utf-8")
    return folder / "study.yaml"


def processor() -> float:
    """Processor time of this process and of those it has waited for [s]."""
    return sum(
        used.ru_utime + used.ru_stime
        for used in map(resource.getrusage, (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    )


def loop(study: Study, first: int, step: int) -> float:
    """Time that every so manyeth variant takes, one after the other in this process [s]."""
    job, count = job_of(study), study.points.count
    run_variant(study.variant(0), job=job)  # what is imported late is imported
    begun = time.perf_counter()
    for k in range(first, count, step):
        run_variant(study.variant(k), job=job)
    return time.perf_counter() - begun


def share(path: Path, first: int, step: int, ready: Any, times: Any) -> None:
    """One of several processes that do so at the same time."""
    study = read_study(path)
    loop(study, 0, study.points.count)  # one variant
    ready.wait()
    times.put(loop(study, first, step))


def without_engine(path: Path, jobs: int) -> float:
    """Time until the last of several such processes is done, from when all are ready [s]."""
    context = multiprocessing.get_context("spawn")
    ready, times = context.Barrier(jobs), context.Queue()
    running = [
        context.Process(target=share, args=(path, first, jobs, ready, times))
        for first in range(jobs)
    ]
    for process in running:
        process.start()
    slowest = max(times.get() for _ in running)
    for process in running:
        process.join()
    return slowest


def with_engine(folder: Path, study: Study, jobs: int) -> tuple[float, float, float]:
    """Time of a sweep, and processor time of all its processes and of the first of them [s]."""
    before = processor()
    warm = read_study(written(folder / "warm", 8 * jobs))
    sweep(warm, folder / "warm", engine=Engine(jobs))  # starts workers, which the next sweep finds
    begun, used = time.perf_counter(), processor()
    sweep(study, folder / "out", engine=Engine(jobs))
    swept, here = time.perf_counter() - begun, processor() - used
    get_reusable_executor().shutdown(wait=True)  # whose processor time is known when it has ended
    whole = processor() - before
    for name in ("warm", "out"):
        shutil.rmtree(folder / name)
    return swept, whole, here


def in_one_process(folder: Path, study: Study) -> float:
    """Time of the same sweep in this process alone [s]."""
    begun = time.perf_counter()
    sweep(study, folder / "out", engine=Engine(1))
    swept = time.perf_counter() - begun
    shutil.rmtree(folder / "out")
    return swept


def throughput(folder: Path, variants: int, jobs: int, rounds: int) -> None:
    path = written(folder, variants)
    study, found = read_study(path), []
    for _ in range(rounds):
        plain = loop(study, 0, 1)
        ceiling = plain / without_engine(path, jobs)
        alone = in_one_process(folder, study)
        swept, whole, here = with_engine(folder, study, jobs)
        found.append((plain, ceiling, alone, swept, whole, here))
        print(f"loop {plain:.2f} s, one process {alone:.2f} s, {jobs} processes {swept:.2f} s: "
              f"{alone / swept:.2f} times one, of {ceiling:.2f} without an engine")  # fmt: skip
    plain, alone, swept = (min(row[k] for row in found) for k in (0, 2, 3))
    ceiling = plain / min(row[0] / row[1] for row in found)
    print(f"best of {rounds}: {variants} variants of {TICKS} ticks, {jobs} processes")
    print(f"plain loop {plain:.1f} s, {1e3 * plain / variants:.2f} ms a variant")
    print(f"sweep {swept:.1f} s, {variants / swept:.0f} variants a second")
    print(
        f"that is {alone / swept:.2f} times one process, {plain / swept:.2f} times the plain loop"
    )
    print(f"of at most {ceiling:.2f} times without an engine on this machine now")
    whole, here = (1e3 * min(row[k] for row in found) / variants for k in (4, 5))
    print(f"processor time a variant: {whole:.2f} ms, with the workers' start")
    print(f"of that in the process that hands out and writes: {here:.2f} ms")


def rows(folder: Path) -> object:
    return pq.read_table(folder / "results.parquet")


def killed(folder: Path, kills: int, seed: int) -> None:
    """Kill the client, then a worker, and so on; the results are those of an undisturbed run."""
    variants = 150 * kills
    study = read_study(written(folder, variants))
    sweep(study, folder / "whole", engine=Engine(2))
    rng, left = random.Random(seed), {"client": kills, "worker": kills}
    words = ["sweep", str(folder / "study.yaml"), "--out", str(folder / "out"), "--jobs", "2"]
    done = 0
    while done < variants and any(left.values()):
        client = subprocess.Popen([sys.executable, "-m", "benchmarks.studies", "--as", *words])
        while client.poll() is None and any(left.values()):
            time.sleep(rng.uniform(1.0, 3.0))
            before, done = done, _lines(folder / "out")
            if done <= before:
                continue  # nothing has come since the last one; it is still starting
            whom = rng.choice([kind for kind, n in left.items() if n])
            found = _workers(client.pid)
            if whom == "worker" and found:
                os.kill(rng.choice(found), signal.SIGKILL)
                left[whom] -= 1
            elif whom == "client" and client.poll() is None:
                client.kill()
                client.wait()
                left[whom] -= 1
        client.wait()
        done = _lines(folder / "out")
    print(f"not killed, because the study had ended: {left}")
    sweep(study, folder / "out", engine=Engine(2))
    print("rows equal:", rows(folder / "whole").equals(rows(folder / "out")))  # type: ignore[attr-defined]


def _lines(folder: Path) -> int:
    path = folder / "journal.sqlite3"
    return sum(1 for _ in records(path)) if path.exists() and head_of(path) else 0


def _workers(pid: int) -> list[int]:
    found = []
    path = Path(f"/proc/{pid}/task/{pid}/children")
    for child in path.read_text().split() if path.exists() else ():
        command = Path(f"/proc/{child}/cmdline")
        if command.exists() and b"LokyProcess" in command.read_bytes():
            found.append(int(child))
    return found


@contextmanager
def started() -> Iterator[str]:
    """The address of a scheduler with two workers, by the commands of docs/studies.md."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = str(free.getsockname()[1])
    address = f"tcp://127.0.0.1:{port}"
    commands = [
        ["scheduler", "--host", "127.0.0.1", "--port", port, "--no-dashboard"],
        ["worker", address, "--nthreads", "1", "--nworkers", "2", "--no-dashboard"],
    ]
    running = [
        subprocess.Popen([sys.executable, "-m", "dask", *words], stderr=subprocess.DEVNULL)
        for words in commands
    ]
    try:
        yield address
    finally:
        for process in reversed(running):
            process.terminate()
            process.wait()


def on_cluster(folder: Path, variants: int, address: str, kills: int, seed: int) -> None:
    """The rows are those of this machine's processes, also where workers are killed."""
    from distributed import Client

    study: Study = read_study(written(folder, variants))
    sweep(study, folder / "here", engine=Engine(2))
    rng, said = random.Random(seed), list[str]()
    moments = sorted(rng.sample(range(1, variants // 2), kills))

    with Client(address, set_as_default=False) as client:

        def kill(state: Progress) -> None:
            """One of the workers, as soon as so many variants are done and one is there."""
            if not moments or state.done < moments[0]:
                return
            if found := sorted(client.run(os.getpid, on_error="ignore").values()):
                os.kill(rng.choice(found), signal.SIGKILL)
                said.append(f"{state.done} (from {moments.pop(0)} on)")

        begun = time.perf_counter()
        sweep(study, folder / "there", engine=Engine(scheduler=address), progress=kill)
    print(f"{variants} variants on {address}: {time.perf_counter() - begun:.1f} s")
    if kills:
        print(f"{len(said)} of {kills} workers killed, after variants: {', '.join(said)}")
    print("rows equal:", rows(folder / "here").equals(rows(folder / "there")))  # type: ignore[attr-defined]


def main() -> None:
    if "--as" in sys.argv:
        from coopqp.cli import main as command

        command(sys.argv[sys.argv.index("--as") + 1 :])
        return
    asked = argparse.ArgumentParser(description=__doc__)
    asked.add_argument("--variants", type=int, default=2000)
    asked.add_argument("--jobs", type=int, default=2)
    asked.add_argument("--rounds", type=int, default=3)
    asked.add_argument("--kills", type=int, default=0)
    asked.add_argument("--seed", type=int, default=0)
    asked.add_argument("--scheduler", default="")
    asked.add_argument("--dask", action="store_true")
    given = asked.parse_args()
    with tempfile.TemporaryDirectory() as place:
        if given.dask:
            with started() as address:
                on_cluster(Path(place), given.variants, address, given.kills, given.seed)
        elif given.kills and not given.scheduler:
            killed(Path(place), given.kills, given.seed)
        elif given.scheduler:
            on_cluster(Path(place), given.variants, given.scheduler, given.kills, given.seed)
        else:
            throughput(Path(place), given.variants, given.jobs, given.rounds)


if __name__ == "__main__":
    main()
