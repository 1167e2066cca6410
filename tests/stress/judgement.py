"""How one rollout went: what it ended as, and which promises it broke."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from coopqp.assessment.oscillation import Oscillation, oscillation
from coopqp.controller import Law
from coopqp.model.state import State

from . import signs
from .draw import Draw
from .ending import Ending, PartErrors, ending
from .signs import Record


@dataclass(frozen=True)
class Rollout:
    """How one rollout went.

    Attributes:
        goal, errors: as drawn on plants with masses; else empty.
        outcome, reason: how it ended, and why there; empty when it raised.
        broken: promises that were broken, in words.
        frozen, oscillating, worse, never_back: signs that were seen; each is a broken promise too.
        saturated, squeezed: the same on plants with masses.
        compared: hard tasks that it rests short of, and that were tried as soft ones.
        position_excess: largest violation of a position limit that held before [rad].
        velocity_excess: of a velocity limit [rad/s].
        loop_position, loop_orientation: largest loop error [m], [rad].
        force, explained: internal force at the end on plants with masses, and what of it the
            servos' gravity feed-forward explains [N].
        relaxations: ticks that gave something up or held still.
        inaccurate: ticks that were not optimal to the declared accuracy.
        plain: ticks that the kernel left to the plain law; all of them without a kernel.
    """

    seed: int
    robot: str = ""
    grasp: str = ""
    start: str = ""
    limits: str = ""
    kappa: str = ""
    tasks: tuple[str, ...] = ()
    goal: str = ""
    errors: str = ""
    outcome: str = ""
    reason: str = ""
    broken: tuple[str, ...] = ()
    frozen: bool = False
    oscillating: bool = False
    worse: bool = False
    never_back: bool = False
    saturated: bool = False
    squeezed: bool = False
    compared: int = 0
    ticks: int = 0
    position_excess: float = 0.0
    velocity_excess: float = 0.0
    loop_position: float = 0.0
    loop_orientation: float = 0.0
    force: float = 0.0
    explained: float = 0.0
    relaxations: int = 0
    inaccurate: int = 0
    plain: int = 0


def judged(
    seed: int,
    drawn: Draw,
    law: Law,
    state: State,
    record: Record,
    errors: PartErrors,
    noise: float = 0.0,
) -> Rollout:
    """Judge a rollout whose time is up; the encoders' noise has this standard deviation [rad]."""
    end = ending(law, state, record, errors)
    resting, units = record.q[record.rest :], record.units
    oscillates = oscillation(resting, units, record.dt, longest=record.longest, noise=noise)
    excess = signs.position_excess(record), signs.velocity_excess(record)
    return Rollout(
        seed=seed,
        robot=drawn.robot,
        grasp=drawn.grasp,
        start=drawn.start,
        limits=drawn.limits,
        kappa=drawn.kappa,
        tasks=drawn.tasks,
        outcome=end.outcome,
        reason=end.reason,
        broken=(
            *signs.violations(record, drawn.problem.budget, excess),
            *_seen(end, drawn, oscillates),
        ),
        frozen=end.frozen,
        oscillating=oscillates is not None,
        never_back=end.never_back,
        ticks=len(record.v),
        position_excess=excess[0],
        velocity_excess=excess[1],
        loop_position=record.loop_position,
        loop_orientation=record.loop_orientation,
        relaxations=record.given_up,
        inaccurate=record.inaccurate,
        plain=record.plain,
    )


def _seen(end: Ending, drawn: Draw, oscillates: Oscillation | None) -> Iterator[str]:
    """The signs in words."""
    chain = drawn.problem.chain
    if end.frozen:
        yield f"froze: {end.reason}"
    if oscillates:
        name, unit = chain.joint_names[oscillates.joint], chain.joint_units[oscillates.joint]
        yield f"oscillates: {name} by {oscillates.size:.2g} {unit} at {oscillates.frequency:.2g} Hz"
    if end.never_back:
        yield f"never came back: {end.reason}"
