"""The rollouts, each from its own seed, wherever the engine does them."""

from __future__ import annotations

import gc
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from typing import TypeVar

from coopqp.errors import MissingDependencyError
from coopqp.plant import Plant
from coopqp.plants.kinematic import Kinematic
from coopqp.solver import Solver
from coopqp.study.engine import Engine, Lost

from .draw import DAQP, LAW, Draw, draw
from .driving import drive_on, record_of
from .ending import PartErrors
from .firmness import missed_hard_tasks, worse_than_soft
from .judgement import Rollout, judged
from .masses import draw_with_masses, run_pair

JOINTS = Kinematic()
HERE = Engine()
PATIENT = 10  # one in so many rollouts waits for swings that begin late
COLLECTED = 50_000  # objects that are made before unused ones in cycles are looked for
One = TypeVar("One")


def stress(
    count: int,
    solver: Solver = DAQP,
    plant: Plant = JOINTS,
    *,
    seed: int = 0,
    engine: Engine = HERE,
    progress: Callable[[int], None] | None = None,
) -> list[Rollout]:
    """Run many rollouts.

    Args:
        count: how many.
        solver: of the programs; it changes nothing of what is drawn.
        plant: one with masses has its own draws, each run without and with errors of the model.
        seed: of the first; the others count up.
        engine: where; on all cores when omitted.
        progress: called with the number done.

    Raises:
        MissingDependencyError: solver or plant needs a package that is not installed.
    """
    work = partial(rollouts, solver=solver, plant=plant)
    return gathered(work, range(seed, seed + count), Rollout, engine, progress)


def gathered(
    work: Callable[[Sequence[int]], list[One]],
    seeds: Sequence[int],
    kind: Callable[..., One],
    engine: Engine,
    progress: Callable[[int], None] | None = None,
) -> list[One]:
    """What an engine makes of seeds, in their order; who ends its process has broken a promise."""
    done: dict[int, One] = {}
    for own, found in engine.results(work, seeds):
        done[own] = kind(own, broken=(found.reason,)) if isinstance(found, Lost) else found
        if progress:
            progress(len(done))
    return [done[own] for own in sorted(done)]


def rollouts(seeds: Sequence[int], *, solver: Solver, plant: Plant) -> list[Rollout]:
    """A batch of rollouts, one after the other; what the engine has a worker do."""
    with _rare_collections():
        return [one_rollout(seed, solver, plant) for seed in seeds]


@contextmanager
def _rare_collections() -> Iterator[None]:
    """Let Python look for cycles that nobody holds once in some rollouts, not 50 times in each."""
    before = gc.get_threshold()
    gc.set_threshold(COLLECTED, *before[1:])
    try:
        yield
    finally:
        gc.set_threshold(*before)


def one_rollout(seed: int, solver: Solver = DAQP, plant: Plant = JOINTS) -> Rollout:
    """Draw a rollout from a seed and run it; an exception is a broken promise, not raised.

    Raises:
        MissingDependencyError: as for :func:`stress`.
    """
    try:
        if plant.takes_torques:
            return run_pair(draw_with_masses(seed, solver), plant, seed)
        return _run(draw(seed, solver), seed)
    except MissingDependencyError:
        raise
    except Exception as error:  # noqa: BLE001 - this is what the stress test looks for
        return Rollout(seed, broken=(f"raised {type(error).__name__}: {error}",))


def _run(drawn: Draw, seed: int) -> Rollout:
    law = LAW.unprepared(drawn.problem)
    state = law.start()
    record, errors = record_of(drawn.problem), PartErrors(drawn.problem, state)
    drive_on(law, state, record, errors, patient=seed % PATIENT == 0)
    rollout = judged(seed, drawn, law, state, record, errors)
    missed = [] if rollout.swinging else missed_hard_tasks(drawn.problem, state, record)
    worse = tuple(words for i in missed for words in worse_than_soft(law, state, i))
    return replace(
        rollout, broken=(*rollout.broken, *worse), worse=bool(worse), compared=len(missed)
    )
