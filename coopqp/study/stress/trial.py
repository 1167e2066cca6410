"""The rollouts, each from its own seed, on all cores."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from coopqp.errors import MissingDependencyError
from coopqp.plant import Plant
from coopqp.plants.kinematic import Kinematic
from coopqp.solver import Solver
from coopqp.study.pool import in_parallel
from coopqp.study.stress.draw import DAQP, LAW, Draw, draw
from coopqp.study.stress.driving import drive_on, record_of
from coopqp.study.stress.judgement import Rollout, judged
from coopqp.study.stress.masses import draw_with_masses
from coopqp.study.stress.pair import run_pair

JOINTS = Kinematic()


def stress(
    count: int,
    solver: Solver = DAQP,
    plant: Plant = JOINTS,
    *,
    seed: int = 0,
    jobs: int = 0,
    progress: Callable[[int], None] | None = None,
) -> list[Rollout]:
    """Run many rollouts on all cores.

    Args:
        count: how many.
        solver: of the programs; it changes nothing of what is drawn.
        plant: one with masses has its own draws, each run without and with errors of the model.
        seed: of the first; the others count up.
        jobs: processes; all cores when 0.
        progress: called with the number done.

    Raises:
        MissingDependencyError: solver or plant needs a package that is not installed.
    """
    seeds = range(seed, seed + count)
    done: list[Rollout] = []
    one = partial(one_rollout, solver=solver, plant=plant)
    done.append(one(seed))  # what is not installed shows in the first
    if progress:
        progress(1)
    for rollout in in_parallel(one, seeds[1:], jobs):
        done.append(rollout)
        if progress:
            progress(len(done))
    return sorted(done, key=lambda rollout: rollout.seed)


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
    law = LAW.build(drawn.problem)
    state = law.start()
    record = record_of(drawn.problem)
    drive_on(law, state, record)
    return judged(seed, drawn, state, record)
