"""The rollouts, each from its own seed, wherever the engine does them."""

from __future__ import annotations

import gc
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import TypeVar

from coopqp.base.errors import MissingDependencyError
from coopqp.plant import Plant
from coopqp.plants.kinematic import Kinematic
from coopqp.solver import Solver
from coopqp.study.engine import Engine, Lost

from .draw import DAQP, LAW, draw
from .driving import drive_on, record_of
from .ending import PartErrors
from .firmness import missed_hard_tasks, worse_than_soft
from .judgement import Rollout, judged
from .masses import draw_with_masses, run_pair

JOINTS = Kinematic()
HERE = Engine()
PATIENT = 10  # one in so many rollouts waits for oscillations that begin late
COLLECTED = 50_000  # objects that are made before unused ones in cycles are looked for
One = TypeVar("One")


def stress(
    count: int,
    one: Callable[[int], One] | None = None,
    *,
    seed: int = 0,
    engine: Engine = HERE,
    kind: Callable[..., One] = Rollout,
    progress: Callable[[int], None] | None = None,
) -> list[One]:
    """Many rollouts in the order of their seeds; who ends its process has broken a promise.

    Args:
        count: how many.
        one: does one; :func:`one_rollout` when omitted.
        seed: of the first; the others count up.
        engine: where; on all cores when omitted.
        kind: what ``one`` makes.
        progress: called with the number done.

    Raises:
        MissingDependencyError: solver or plant needs a package that is not installed.
    """
    done: dict[int, One] = {}
    work = partial(_rollout, one=one or one_rollout)
    for own, found in engine.results(work, engine.share.taken(range(seed, seed + count))):
        done[own] = kind(own, broken=(found.reason,)) if isinstance(found, Lost) else found
        if progress:
            progress(len(done))
    return [done[own] for own in sorted(done)]


def _rollout(seed: int, *, one: Callable[[int], One]) -> One:
    """What the engine has a worker do.

    Python looks for cycles that nobody holds once in some rollouts, not 50 times in each.
    """
    before = gc.get_threshold()
    gc.set_threshold(COLLECTED, *before[1:])
    try:
        return one(seed)
    finally:
        gc.set_threshold(*before)


def tried(run: Callable[..., One], kind: Callable[..., One], seed: int, *given: object) -> One:
    """A run; an exception is a broken promise, unless a package is not installed."""
    try:
        return run(seed, *given)
    except MissingDependencyError:
        raise
    except Exception as error:  # noqa: BLE001 - this is what the stress test looks for
        return kind(seed, broken=(f"raised {type(error).__name__}: {error}",))


def one_rollout(seed: int, solver: Solver = DAQP, plant: Plant = JOINTS) -> Rollout:
    """Draw a rollout from a seed and run it; on a plant with masses it has draws of its own."""
    return tried(_run, Rollout, seed, solver, plant)


def _run(seed: int, solver: Solver, plant: Plant) -> Rollout:
    if plant.takes_torques:
        return run_pair(draw_with_masses(seed, solver), plant, seed)
    drawn = draw(seed, solver)
    law = LAW.unprepared(drawn.problem)
    state = law.start()
    record, errors = record_of(drawn.problem), PartErrors(drawn.problem, state)
    drive_on(law, state, record, errors, patient=seed % PATIENT == 0)
    rollout = judged(seed, drawn, law, state, record, errors)
    missed = [] if rollout.oscillating else missed_hard_tasks(drawn.problem, state, record)
    worse = tuple(words for i in missed for words in worse_than_soft(law, state, i))
    return replace(
        rollout, broken=(*rollout.broken, *worse), worse=bool(worse), compared=len(missed)
    )
