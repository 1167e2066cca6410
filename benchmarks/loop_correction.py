"""What errors of the model do to the object between the hands, as a markdown table.

python benchmarks/loop_correction.py [seeds] > table.md   (minutes a seed)

Columns: internal force at worst and in the mean of the last half second [N], share of ticks with a
saturated motor [%], error of the object's first task at worst and over the last half second [mm],
the observed loop offset [mm], ticks that were not OPTIMAL; the worst of all seeds,
which decide the errors' signs and directions. A row is accepted with
at most a tenth or 0.1 N more force at the end than without error, and no motor saturated that was
not.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

import coopqp
from coopqp.controller import Command
from coopqp.execution.rollout import rollout
from coopqp.limits import JointPosition, JointVelocity
from coopqp.metrics.internal_force import InternalForce
from coopqp.metrics.loop_offset import LoopOffset
from coopqp.model.state import State
from coopqp.plant import Disturbance, Plant, PlantModel, Slip
from coopqp.plants import Mujoco, RigidBody
from coopqp.scenario.scenario import Scenario
from coopqp.solver import Status
from coopqp.trace import Trace

PLANTS: dict[str, Plant] = {"rigid_body": RigidBody(), "mujoco": Mujoco()}
#: Joints stay this far from their stops, so that no encoder's offset drives one into its stop.
MARGIN = 0.006  # rad
HALF_A_SECOND = 0.5  # s
MORE, MORE_FORCE = 1.1, 0.1  # a tenth, or [N]

MIXED = Disturbance(
    link_length=5e-4, grasp_offset=1e-3, encoder_offset=5e-3, noise_position=1e-4, delay=2
)
ERRORS = {
    "none": Disturbance(),
    "links 0.5 mm": Disturbance(link_length=5e-4),
    "links 1 mm": Disturbance(link_length=1e-3),
    "links 2 mm": Disturbance(link_length=2e-3),
    "grasp 0.5 mm": Disturbance(grasp_offset=5e-4),
    "grasp 1 mm": Disturbance(grasp_offset=1e-3),
    "grasp 2 mm": Disturbance(grasp_offset=2e-3),
    "encoders 5 mrad": Disturbance(encoder_offset=5e-3),
    "slip 5 mm": Disturbance(slip=Slip(at=0.5, by=5e-3)),
    "all, noise, delay": MIXED,
}
FEW = ("none", "grasp 2 mm", "encoders 5 mrad", "all, noise, delay")


@dataclass(frozen=True)
class Case:
    """A scenario, the errors to try on it, and the seeds of their signs."""

    name: str
    scenario: Scenario
    errors: tuple[str, ...] = tuple(ERRORS)
    plants: tuple[str, ...] = tuple(PLANTS)
    old: bool = False


class Fed(PlantModel):
    """A plant whose measured joints are fed back as the configuration, as one should not."""

    def __init__(self, plant: PlantModel) -> None:
        super().__init__()
        self._plant, self.signals = plant, plant.signals

    def step(self, state: State, command: Command) -> None:
        self._plant.step(state, command)
        state.q[:], state.q_measured = self._plant.measured, None

    def truth(self, state: State) -> State:
        return self._plant.truth(state)

    def resume(self, before: PlantModel) -> None:
        raise NotImplementedError


def main() -> None:
    seeds = range(int(sys.argv[1]) if len(sys.argv) > 1 else 1)
    heads = (
        "case", "plant", "error", "force worst", "end", "saturated", "object worst", "end",
        "loop_offset", "not optimal", "accepted",
    )  # fmt: skip
    print("| " + " | ".join(heads) + " |\n|" + "---|" * len(heads))
    for case in cases():
        for plant in case.plants:
            for line in lines(case, plant, seeds):
                print("| " + " | ".join(line) + " |", flush=True)


def cases() -> Iterator[Case]:
    nao, pandas = away_from_stops("point_on_point"), away_from_stops("two_pandas")
    hinged = away_from_stops("passive_grasp_pose")
    yield Case("NAO, firm", nao, old=True)
    yield Case("NAO, hinges", replace(hinged, dt=0.01, kappa=100.0, tasks=slower(hinged)))
    yield Case("two Pandas", pandas, old=True)
    yield Case("three UR arms", away_from_stops("three_ur"), FEW)
    yield Case("regrasp, four phases", away_from_stops("regrasp"), FEW)
    (carry,) = pandas.tasks
    upright = replace(pandas.tasks[0], name="again", priority=1, weight=0.5)
    two = replace(pandas, tasks=(replace(carry, priority=0), upright))
    yield Case("two Pandas, two priorities", two, FEW, ("mujoco",))
    yield Case("NAO, firm, no margin", coopqp.load("point_on_point"), FEW, ("rigid_body",))


def away_from_stops(name: str) -> Scenario:
    limits = (JointPosition(margin=MARGIN), JointVelocity())
    return replace(coopqp.load(name), limits=limits)


def slower(scenario: Scenario) -> tuple[coopqp.Task, ...]:
    return tuple(replace(task, gain=5.0) for task in scenario.tasks)


def lines(case: Case, plant: str, seeds: range) -> Iterator[list[str]]:
    clean: dict[str, float] = {}
    for error in case.errors:
        print(f"{case.name}, {plant}, {error}", file=sys.stderr)
        scenario = replace(case.scenario, plant=PLANTS[plant], disturbance=ERRORS[error])
        found = worst(scenario, seeds)
        clean = clean or found
        more = max(MORE * clean["end"], clean["end"] + MORE_FORCE)
        fine = found["end"] <= more and found["saturated"] <= clean["saturated"]
        yield [case.name, plant, error, *cells(found), "yes" if fine else "NO"]
    if case.old:
        error = "grasp 1 mm"
        scenario = replace(case.scenario, plant=PLANTS[plant], disturbance=ERRORS[error])
        yield [case.name, plant, f"{error}, measured fed back", *cells(fed_back(scenario)), "-"]


def worst(scenario: Scenario, seeds: range) -> dict[str, float]:
    runs = [measured(coopqp.run(replace(scenario, seed=k), controller="qp")) for k in seeds]
    return {key: max(run[key] for run in runs) for key in runs[0]}


def fed_back(scenario: Scenario) -> dict[str, float]:
    problem = scenario.problem()
    law = scenario.controllers["qp"].build(problem)
    plant = Fed(scenario.plant.build(problem, scenario.seed, scenario.disturbance))
    return measured(rollout(law, plant, scenario.ticks, controller="qp", solver=None))


def measured(trace: Trace) -> dict[str, float]:
    force = InternalForce().measure(trace)
    assert force is not None
    metres = [i for i, task in enumerate(trace.tasks) if task.unit == "m"]
    error = np.nanmax(trace.task_error[:, metres], axis=1)
    last = -round(HALF_A_SECOND / trace.dt)
    saturated = (trace.signals["saturated"].max(axis=1) > 0.0).mean()
    return {
        **force,
        "saturated": float(saturated),
        "object": float(np.nanmax(error)),
        "object_end": float(np.nanmean(error[last:])),
        "loop_offset": LoopOffset().measure(trace)["position"],
        "odd": sum(status != Status.OPTIMAL.name for status in trace.status) / trace.ticks,
    }


def cells(found: dict[str, float]) -> list[str]:
    mm = [f"{1e3 * found[key]:.2f}" for key in ("object", "object_end", "loop_offset")]
    percent = [f"{100 * found[key]:.0f} %" for key in ("saturated", "odd")]
    force = [f"{found[key]:.3f}" if math.isfinite(found[key]) else "-" for key in ("worst", "end")]
    return [*force, percent[0], *mm, percent[1]]


if __name__ == "__main__":
    main()
