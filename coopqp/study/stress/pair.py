"""A rollout on a plant with masses, run without and with errors of the model, and compared."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from coopqp.disturbance import Disturbance
from coopqp.plant import Plant
from coopqp.plants._dynamic import DynamicModel
from coopqp.study.stress.draw import LAW
from coopqp.study.stress.driving import drive_for, record_of
from coopqp.study.stress.ending import PartErrors
from coopqp.study.stress.judgement import Rollout, judged
from coopqp.study.stress.masses import DrawWithMasses
from coopqp.study.stress.signs import Flags
from coopqp.study.stress.squeeze import Squeeze, squeeze

DURATION, END = 4.0, 0.5  # of a rollout, and of what counts as its end [s]
FOR_GOOD = 0.1  # share of the ticks of the last quarter in which a motor is at its limit
RESTS = 0.01  # slower than this share of the speed limits all through the end
MORE = 1.1  # what the force may be times more than it is without errors, or explained
DEVIATIONS = 3.0  # of noise
LEAST = 0.02  # a difference that says nothing [N]


@dataclass(frozen=True)
class _Run:
    """One of the two.

    Attributes:
        rollout: judged as on joints that do as told.
        force: in the mean of the end [N].
        rests: whether the commands do, all through the end.
        squeeze: what the statics say of where it is.
        saturated: motors that are at their limit for good, shape (n,).
        overloaded: motors that the statics ask for more than they have, shape (n,).
    """

    rollout: Rollout
    force: float
    rests: bool
    squeeze: Squeeze
    saturated: Flags
    overloaded: Flags


def run_pair(drawn: DrawWithMasses, plant: Plant, seed: int) -> Rollout:
    """Run a draw twice on a plant; once where it has no errors.

    Args:
        drawn: the problem.
        plant: with masses.
        seed: of it, and of the errors' signs.

    Returns:
        The run with errors, and what either of the two broke.
    """
    clean = run = _run(drawn, plant, seed, drawn.without_errors)
    broken: tuple[str, ...] = ()
    if drawn.errors != "none":
        run = _run(drawn, plant, seed, drawn.disturbance)
        broken = tuple(f"without errors: {words}" for words in clean.rollout.broken)
    # Who moves may need all of its torque, and lags behind.
    rests = run.rests or clean.rests
    motors = _saturated(drawn, run, clean) if rests else ()
    squeezes = _squeezes(run, clean) if rests else ()
    return replace(
        run.rollout,
        goal=drawn.goal,
        errors=drawn.errors,
        broken=(*broken, *run.rollout.broken, *motors, *squeezes),
        saturated=bool(motors),
        squeezed=bool(squeezes),
        force=run.force,
        explained=run.squeeze.weight,
    )


def _saturated(drawn: DrawWithMasses, run: _Run, clean: _Run) -> tuple[str, ...]:
    """Motors at their limits by the errors' doing, in words: the statics do not ask for it."""
    which = np.flatnonzero(run.saturated & ~run.overloaded & ~clean.saturated)
    names = [drawn.problem.chain.joint_names[i] for i in which.tolist()]
    return (f"saturated for good: {', '.join(names)}",) if names else ()


def _squeezes(run: _Run, clean: _Run) -> tuple[str, ...]:
    """More internal force than without errors and than the statics explain, in words."""
    most = MORE * max(clean.force, run.squeeze.weight) + DEVIATIONS * run.squeeze.noise + LEAST
    if run is clean or run.force <= most:
        return ()
    words = "" if run.rests else " and does not rest"
    return (f"squeezes with {run.force:.3g} N, more than {most:.3g} N{words}",)


def _run(drawn: DrawWithMasses, plant: Plant, seed: int, disturbance: Disturbance) -> _Run:
    problem = drawn.problem
    model = plant.build(problem, seed, disturbance)
    assert isinstance(model, DynamicModel)
    law, record = LAW.build(problem), record_of(problem)
    state = law.start(q_measured=model.measured)
    drive_for(round(DURATION / problem.dt), law, model, state, record)
    noise = disturbance.noise_position
    rollout = judged(seed, drawn, law, state, record, PartErrors(problem), noise)
    last, limit = round(END / problem.dt), model.servo.effort
    found = squeeze(model, problem.dt)
    return _Run(
        rollout=rollout,
        force=float(np.mean(record.forces[-last:])),
        rests=bool((np.abs(record.v[-last:]) < RESTS * record.scale).all()),
        squeeze=found,
        saturated=np.mean(record.saturated[-(len(record.saturated) // 4) :], axis=0) > FOR_GOOD,
        overloaded=np.abs(found.tau) > limit,
    )
