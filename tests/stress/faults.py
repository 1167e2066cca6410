"""Random rollouts in which sensors and motors fail, and nobody looks for faults.

The law cannot know, and what it is told may be nonsense. It still keeps its promises on commands:
they are finite, within the limits, and zero in ticks without a usable answer; nothing raises or
warns; readings that are lost are named in each of these ticks and in no other; no status says that
the plant broke down or that somebody wrote to the state, because neither is so.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from coopqp.controller import ControlProblem
from coopqp.execution.rollout import drive
from coopqp.plant import FAULTS, Disturbance, Fault, Plant
from coopqp.scenario.faulty_plant import FaultyPlant, Injected
from coopqp.solver import Solver, Status

from . import signs
from .draw import DAQP, LAW, Draw, draw
from .driving import record_of
from .goals import pick
from .judgement import Rollout
from .masses import DrawWithMasses, draw_with_masses
from .signs import Record
from .trial import JOINTS, tried

SECONDS = 1.5  # of a rollout
STREAM = 28  # so that draws are as without faults
LARGEST_JUMP = 0.1  # of an encoder's offset [rad, m]
#: What is never so here: plants stay whole, and nobody but the plant writes to the state.
NEVER = {Status.PLANT_FAILED, Status.OVERWRITTEN, Status.WRONG_STATE, Status.RAISED}


def faulty_rollout(seed: int, solver: Solver = DAQP, plant: Plant = JOINTS) -> Rollout:
    """Draw a rollout and one fault or two from a seed, and run it."""
    return tried(_run, Rollout, seed, solver, plant)


def draw_faults(seed: int, problem: ControlProblem, *, forces: bool) -> tuple[Fault, ...]:
    """One fault, or two in a quarter of the draws; half of them end by themselves."""
    rng, chain = np.random.default_rng([seed, STREAM]), problem.chain
    kinds = [kind for kind in FAULTS if forces or not kind.startswith("force")]
    found = []
    for _ in range(1 + (rng.random() < 0.25)):
        kind = pick(rng, kinds)
        driven = np.setdiff1d(np.arange(chain.n), chain.passive)
        joints = [chain.joint_names[j] for j in rng.permutation(driven)[:2]]
        size = float(rng.uniform(-LARGEST_JUMP, LARGEST_JUMP))
        values = {
            "joint": joints[0],
            "joints": tuple(joints),
            "arm": pick(rng, [arm.name for arm in chain.robot.arms]),
            "by": size if kind.startswith("encoder") else float(rng.uniform(-2.0, 2.0)),
        }
        start = 0.0 if rng.random() < 0.25 else float(rng.uniform(0.0, 0.7 * SECONDS))
        lasts = float(rng.uniform(0.05, 0.5)) if rng.random() < 0.5 else None
        keys = {key: values[key] for key in FAULTS[kind]}
        found.append(Fault(kind=kind, start=start, duration=lasts, **keys))  # type: ignore[arg-type]
    return tuple(found)


def _run(seed: int, solver: Solver, plant: Plant) -> Rollout:
    masses = plant.takes_torques
    drawn: Draw = draw_with_masses(seed, solver) if masses else draw(seed, solver)
    problem = drawn.problem
    faults = draw_faults(seed, problem, forces=masses)
    told = drawn.disturbance if isinstance(drawn, DrawWithMasses) else Disturbance()
    disturbance = replace(told, faults=faults)
    sound = plant.build(problem, seed, disturbance)
    places = [Injected(i, fault, problem.chain) for i, fault in enumerate(faults)]
    model = FaultyPlant(sound, problem, places)
    law, record = LAW.build(problem), record_of(problem)
    state = law.start(q_measured=model.measured, hand_wrench=model.hand_wrench)
    q, v, lost = [], [], []
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for command, _ in drive(law, model, state, round(SECONDS / problem.dt)):
            q.append(state.q.copy())
            v.append(command.v.copy())
            lost.append(state.q_measured is not None and bool(np.isnan(state.q_measured).all()))
            record.causes.append(command.causes)
            record.plain += not law.compiled
    record.q, record.v = np.array([*q, state.q]), np.array(v)
    first = round(min(fault.start for fault in faults) / problem.dt)
    silent = all(causes == (Status.OPTIMAL,) for causes in record.causes[first:])
    return Rollout(
        seed=seed,
        robot=drawn.robot,
        grasp=drawn.grasp,
        errors=faults[0].kind if len(faults) == 1 else "two at a time",
        outcome="silent" if silent else "spoken",
        reason=", ".join(fault.description for fault in faults),
        broken=(*signs.violations(record, problem.budget), *untrue(record, lost)),
        ticks=len(v),
        position_excess=signs.position_excess(record),
        velocity_excess=signs.velocity_excess(record),
        relaxations=record.given_up,
        inaccurate=record.inaccurate,
        plain=record.plain,
    )


def untrue(record: Record, lost: list[bool]) -> Iterator[str]:
    """What statuses said and was not so, or was so and they did not say."""
    for k, (v, causes, is_lost) in enumerate(zip(record.v, record.causes, lost, strict=True)):
        if wrong := NEVER & set(causes):
            yield f"tick {k} says {', '.join(sorted(cause.name for cause in wrong))}"
        if not causes[0].usable and v.any():
            yield f"tick {k} moves though it is {causes[0].name}"
        if (Status.NOT_MEASURED in causes) != is_lost:
            yield f"tick {k} {'does not say' if is_lost else 'says'} NOT_MEASURED"
