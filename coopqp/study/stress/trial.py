"""The rollouts, each from its own seed, on all cores."""

from __future__ import annotations

import multiprocessing
import signal
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial

from coopqp.plant import Plant
from coopqp.qp_law.law import QPLaw
from coopqp.solver import Solver
from coopqp.study.stress.draw import DAQP, Draw, draw
from coopqp.study.stress.driving import DAMPING, drive_on, record_of
from coopqp.study.stress.judgement import Rollout, judged
from coopqp.study.stress.masses import draw_with_masses
from coopqp.study.stress.pair import run_pair


def stress(
    count: int,
    *,
    seed: int = 0,
    jobs: int = 0,
    solver: Solver = DAQP,
    plant: Plant | None = None,
    progress: Callable[[int], None] | None = None,
) -> list[Rollout]:
    """Run many rollouts on all cores.

    Args:
        count: how many.
        seed: of the first; the others count up.
        jobs: processes; all cores when 0.
        solver: of the programs; it changes nothing of what is drawn.
        plant: with masses, on which each is run without and with errors of the model; joints that
            do as told when omitted.
        progress: called with the number done.
    """
    seeds = range(seed, seed + count)
    done: list[Rollout] = []
    one = partial(one_rollout, solver=solver, plant=plant)
    for rollout in _all(one, seeds, jobs or multiprocessing.cpu_count()):
        done.append(rollout)
        if progress:
            progress(len(done))
    return sorted(done, key=lambda rollout: rollout.seed)


def _all(one: Callable[[int], Rollout], seeds: range, jobs: int) -> Iterator[Rollout]:
    if jobs == 1 or len(seeds) == 1:
        yield from map(one, seeds)
        return
    with multiprocessing.Pool(min(jobs, len(seeds)), _leave_interrupts) as pool:
        yield from pool.imap_unordered(one, seeds, chunksize=8)


def _leave_interrupts() -> None:
    """Ctrl-C is the parent's to hear, who then ends the workers."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def one_rollout(seed: int, solver: Solver = DAQP, plant: Plant | None = None) -> Rollout:
    """Draw a rollout from a seed and run it; an exception is a broken promise, not raised."""
    try:
        if plant:
            return run_pair(draw_with_masses(seed, solver), plant, seed)
        return _run(draw(seed, solver), seed)
    except Exception as error:  # noqa: BLE001 - this is what the stress test looks for
        return Rollout(seed, broken=(f"raised {type(error).__name__}: {error}",))


def _run(drawn: Draw, seed: int) -> Rollout:
    law = QPLaw(drawn.problem, DAMPING)
    state = law.start()
    record = record_of(drawn.problem)
    drive_on(law, state, record)
    return judged(seed, drawn, law, state, record)
