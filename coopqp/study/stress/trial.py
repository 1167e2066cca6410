"""The rollouts, each from its own seed, on all cores."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from coopqp.controller import ControlProblem
from coopqp.limits import JointVelocity
from coopqp.plants.kinematic import KinematicModel
from coopqp.qp_law.law import QPLaw
from coopqp.rollout import drive
from coopqp.solver import Status
from coopqp.state import State
from coopqp.study.pool import in_parallel
from coopqp.study.stress import signs
from coopqp.study.stress.draw import Draw, draw
from coopqp.study.stress.ending import Ending, ending, part_errors
from coopqp.study.stress.signs import Record

ROUND, FEWEST, MOST = 100, 200, 500  # ticks; after each round it is asked whether it has ended
DAMPING = 1e-6  # as the controller qp has it


@dataclass(frozen=True)
class Rollout:
    """How one rollout went.

    Attributes:
        seed: from which it can be repeated.
        robot, grasp, start, limits, kappa, tasks: as drawn.
        outcome: how it ended; empty when it raised.
        reason: why there.
        broken: promises that were broken, in words.
        frozen, rattling, never_back: signs that were seen; each is a broken promise too.
        ringing: a joint flips in more than 2 % of the ticks; for information.
        ticks: how many.
        position_excess: largest overrun of a position limit that held before [rad].
        velocity_excess: of a velocity limit [rad/s].
        loop_position, loop_orientation: largest loop error [m], [rad].
        fallbacks: ticks that gave something up or held still.
        inaccurate: ticks that were not optimal to the declared accuracy.
    """

    seed: int
    robot: str = ""
    grasp: str = ""
    start: str = ""
    limits: str = ""
    kappa: str = ""
    tasks: tuple[str, ...] = ()
    outcome: str = ""
    reason: str = ""
    broken: tuple[str, ...] = ()
    frozen: bool = False
    rattling: bool = False
    never_back: bool = False
    ringing: bool = False
    ticks: int = 0
    position_excess: float = 0.0
    velocity_excess: float = 0.0
    loop_position: float = 0.0
    loop_orientation: float = 0.0
    fallbacks: int = 0
    inaccurate: int = 0


def stress(
    count: int, *, seed: int = 0, jobs: int = 0, progress: Callable[[int], None] | None = None
) -> list[Rollout]:
    """Run many rollouts on all cores.

    Args:
        count: how many.
        seed: of the first; the others count up.
        jobs: processes; all cores when 0.
        progress: called with the number done.
    """
    seeds = range(seed, seed + count)
    done: list[Rollout] = []
    for rollout in in_parallel(one_rollout, seeds, jobs):
        done.append(rollout)
        if progress:
            progress(len(done))
    return sorted(done, key=lambda rollout: rollout.seed)


def one_rollout(seed: int) -> Rollout:
    """Draw a rollout from a seed and run it; an exception is a broken promise, not raised."""
    try:
        drawn = draw(seed)
        return _run(drawn, seed)
    except Exception as error:  # noqa: BLE001 - this is what the stress test looks for
        return Rollout(seed, broken=(f"raised {type(error).__name__}: {error}",))


def _run(drawn: Draw, seed: int) -> Rollout:
    law = QPLaw(drawn.problem, DAMPING)
    state = law.start()
    record = record_of(drawn.problem)
    drive_on(law, state, record)
    end = ending(drawn.problem, law, state, record)
    share = signs.flips(record)
    rattling, ringing = share > signs.RATTLING, share > signs.RINGING
    return Rollout(
        seed, drawn.robot, drawn.grasp, drawn.start, drawn.limits, drawn.kappa, drawn.tasks,
        end.outcome, end.reason,
        (*signs.overruns(record, drawn.problem.budget), *_seen(end, rattling=rattling)),
        end.frozen, rattling, end.never_back, ringing, len(record.v),
        signs.position_excess(record), signs.velocity_excess(record),
        record.loop_position, record.loop_orientation,
        sum(c[0].fallback or not c[0].usable for c in record.causes),
        record.count(Status.INACCURATE),
    )  # fmt: skip


def _seen(end: Ending, *, rattling: bool) -> Iterator[str]:
    """The signs in words."""
    if end.frozen:
        yield f"froze: {end.reason}"
    if rattling:
        yield "rattled"
    if end.never_back:
        yield f"never came back: {end.reason}"


def record_of(problem: ControlProblem) -> Record:
    """An empty record for a problem."""
    chain = problem.chain
    scale = min(k.scale for k in problem.limits if isinstance(k, JointVelocity))
    return Record(chain.lower, chain.upper, scale * chain.velocity)


def drive_on(law: QPLaw, state: State, record: Record) -> None:
    """Run until it has ended, or its time is up."""
    problem = law.problem
    plant = KinematicModel(problem.dt, problem.chain.n)
    while len(record.v) < MOST:
        for command, _ in drive(law, plant, state, ROUND):
            record.v.append(command.v.copy())
            record.causes.append(command.causes)
            _note(record, state)
            if not np.isfinite(command.v).all():
                return
        if len(record.v) >= FEWEST and _ended(problem, state, record):
            break
    _note(record, state)


def _note(record: Record, state: State) -> None:
    """Keep where the state is."""
    record.q.append(state.q.copy())
    record.loop_position = max(record.loop_position, state.loop_position_error)
    record.loop_orientation = max(record.loop_orientation, state.loop_orientation_error)


def _ended(problem: ControlProblem, state: State, record: Record) -> bool:
    """Whether the references have arrived and nothing changes any more."""
    if state.t < max(task.end for task in problem.tasks):
        return False
    if signs.slowest(record) < signs.STILL:
        return True
    inside = bool(((problem.chain.lower <= state.q) & (state.q <= problem.chain.upper)).all())
    return inside and part_errors(problem, state, record).max() <= 1.0
