"""Runs a law on joints that do as told, and keeps what the signs are read from."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from coopqp.assessment.oscillation import SHORTEST, reach, smallest_ranges
from coopqp.base.spec import Array
from coopqp.controller import ControlProblem, Law
from coopqp.kernel.trajectory_evaluation import TrajectoryEvaluation, survey
from coopqp.limits import JointVelocity
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.state import State

from . import many_poses, signs
from .ending import PartErrors
from .signs import Record

#: Path over range of a joint that may come to oscillate.
TURNS = 1.1
FEWEST, ROUND, MOST = 200, 100, 500  # ticks; after each round it is asked whether it has ended
LONGEST = 24.0  # who may oscillate goes on for so long: a third is 1.6 periods of 0.2 Hz [s]
#: Targets with a velocity turn by at most 0.35 rad in this time, and move by a fifth of the reach:
#: joints that follow them do not go to and fro [s].
FOLLOWED = 2.0


def record_of(problem: ControlProblem) -> Record:
    """A record for a problem, of no ticks."""
    chain = problem.chain
    scale = min(k.scale for k in problem.limits if isinstance(k, JointVelocity))
    dt, asked = problem.dt, (*problem.tasks, *problem.secondary)
    return Record(
        chain.lower,
        chain.upper,
        scale * chain.velocity,
        chain.joint_units,
        dt,
        math.ceil(max((task.end for task in asked), default=0.0) / dt),
        FOLLOWED / dt if any(task.asks_velocity for task in asked) else math.inf,
        np.zeros((0, chain.n)),
        np.zeros((0, chain.n)),
    )


def drive_on(
    law: Law, state: State, record: Record, errors: PartErrors, *, patient: bool = False
) -> None:
    """Run until it has ended, or its time is up; the state of its start and the record are written.

    If ``patient``, all that has not ended goes on for :data:`LONGEST`.
    """
    record.q = state.q[None].copy()
    while _goes_on(state, record, errors, patient=patient):
        made = law.run(state, ROUND if len(record.v) else FEWEST)
        record.q = np.concatenate([record.q, made.q[1:]])
        record.v = np.concatenate([record.v, made.v])
        record.causes.extend(made.causes)
        record.plain += int(np.count_nonzero(~made.compiled))
        note_loops(record, state.loop_position_error, state.loop_orientation_error)
        if not np.isfinite(made.v).all():
            return
    note_loops(record, *(float(each.max()) for each in loop_errors(law.problem.chain, record.q)))


def loop_errors(chain: ClosedChain, q: Array) -> tuple[Array, Array]:
    """As :func:`many_poses.loop_errors`, compiled where the kernel can."""
    look = chain.once(_survey)
    if look is None or chain.holding < 2:
        return many_poses.loop_errors(chain, q)
    gaps = look.look(np.zeros(len(q)), q).loop_error.reshape(len(q), -1, 2, 3)
    sizes = np.sqrt(np.square(gaps[:, : chain.holding - 1]).sum(axis=3)).max(axis=1)
    return sizes[:, 0], sizes[:, 1]


def _survey(chain: ClosedChain) -> TrajectoryEvaluation | None:
    return survey(chain, (), State(chain), ())


def note_loops(record: Record, position: float, orientation: float) -> None:
    """Keep how far the loops are open; by pinocchio where a state has it, by the kernel in all."""
    record.loop_position = max(record.loop_position, position)
    record.loop_orientation = max(record.loop_orientation, orientation)


def _goes_on(state: State, record: Record, errors: PartErrors, *, patient: bool) -> bool:
    """Whether the end is open: at first, on the way, and where joints may oscillate."""
    ticks = len(record.v)
    if ticks < max(FEWEST, record.rest):
        return True
    turning = turns(record.q[record.rest :], record.units)
    late = ticks * record.dt >= LONGEST or (ticks >= MOST and not turning and not patient)
    return not late and (turning or not _ended(state, record, errors))


def turns(q: Array, units: Sequence[str]) -> bool:
    """Whether a joint turns round in the last half of the time, so that it may oscillate.

    q is since all references rest, shape (T + 1, n) [rad, m].
    """
    if len(q) <= SHORTEST:
        return False
    late = q[-(len(q) // 2) :]
    size = reach(late)
    wide = size > smallest_ranges(units)
    if not wide.any():
        return False
    path = np.abs(late[1:] - late[:-1]).sum(axis=0)
    return bool((path[wide] > TURNS * size[wide]).any())


def _ended(state: State, record: Record, errors: PartErrors) -> bool:
    """Whether nothing changes any more, now that the references have arrived."""
    inside = bool(((record.lower <= state.q) & (state.q <= record.upper)).all())
    return signs.slowest(record) < signs.STILL or (
        inside and errors.at_end(state, record).max() <= 1.0
    )
