"""A rollout on a plant with masses, run without and with errors of the model, and compared."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from coopqp.checked import Array
from coopqp.disturbance import Disturbance
from coopqp.plant import Plant
from coopqp.plants._dynamic import DynamicModel
from coopqp.qp_law.law import QPLaw
from coopqp.study.stress.driving import DAMPING, drive_for, note, record_of
from coopqp.study.stress.judgement import Rollout, judged
from coopqp.study.stress.masses import DrawWithMasses
from coopqp.study.stress.signs import Record
from coopqp.study.stress.squeeze import Squeeze, squeeze

DURATION, END = 4.0, 0.5  # of a rollout, and of what counts as its end [s]
FOR_GOOD = 0.1  # share of the ticks of the last quarter in which a motor is at its limit
MORE = 1.1  # what the force may be times more than it is without errors, or explained
DEVIATIONS = 3.0  # of noise
LEAST = 0.02  # a difference that says nothing [N]


@dataclass(frozen=True)
class _Run:
    """One of the two.

    Attributes:
        rollout: judged as on joints that do as told.
        force: in the mean of the end [N].
        squeeze: what the statics say of it.
        saturated: share of the ticks of the last quarter with each motor at its limit, (n,).
    """

    rollout: Rollout
    force: float
    squeeze: Squeeze
    saturated: Array


def run_pair(drawn: DrawWithMasses, plant: Plant, seed: int) -> Rollout:
    """Run a draw twice on a plant; once where it has no errors.

    Args:
        drawn: the problem.
        plant: with masses.
        seed: of it, and of the errors' signs.

    Returns:
        The run with errors, and what either of the two broke.
    """
    clean = _run(drawn, plant, seed, drawn.without_errors)
    if drawn.disturbance == drawn.without_errors:
        run, others = clean, ()
    else:
        run = _run(drawn, plant, seed, drawn.disturbance)
        others = tuple(f"without errors: {words}" for words in clean.rollout.broken)
    motors = [
        name
        for name, now, then in zip(
            drawn.problem.chain.joint_names, run.saturated, clean.saturated, strict=True
        )
        if now > FOR_GOOD >= then
    ]
    most = MORE * max(clean.force, run.squeeze.weight) + DEVIATIONS * run.squeeze.noise + LEAST
    squeezed = not run.force <= most
    words = (*_words(motors), *([f"squeezes with {run.force:.3g} N, {most:.3g} N"] * squeezed))
    return replace(
        run.rollout,
        goal=drawn.goal,
        errors=drawn.errors,
        broken=(*others, *run.rollout.broken, *words),
        saturated=bool(motors),
        squeezed=squeezed,
        force=run.force,
        explained=run.squeeze.weight,
    )


def _words(motors: list[str]) -> Iterator[str]:
    if motors:
        yield f"saturated for good: {', '.join(motors)}"


def _run(drawn: DrawWithMasses, plant: Plant, seed: int, disturbance: Disturbance) -> _Run:
    problem = drawn.problem
    model = plant.build(problem, seed, disturbance)
    assert isinstance(model, DynamicModel)
    law, record = QPLaw(problem, DAMPING), record_of(problem)
    state = law.start(q_measured=model.measured)
    drive_for(round(DURATION / problem.dt), law, model, state, record)
    note(record, model, state)
    rollout = judged(seed, drawn, law, state, record)
    last = round(END / problem.dt)
    return _Run(
        rollout,
        float(np.mean(record.forces[-last:])),
        squeeze(model, problem.dt),
        _shares(record),
    )


def _shares(record: Record) -> Array:
    """How much of the last quarter each motor was at its limit."""
    last = record.saturated[-(len(record.saturated) // 4) :]
    shares: Array = np.mean(last, axis=0)
    return shares
