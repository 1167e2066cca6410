"""How position_pair comes to its 60 N, from soft hands to stiff ones, and where it begins to ring.

python benchmarks/admittance.py     # the tables of docs/forces.md, about two minutes

The box stays where it is. The stiffness is what MuJoCo shows: the force at the end over the way
that the hands were told to approach each other.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

import coopqp
from coopqp.base.spec import Array
from coopqp.closed_loop.admittance import Admittance, stability_limit
from coopqp.closed_loop.grasp_matrix import section
from coopqp.controllers import QPController
from coopqp.plants import Mujoco
from coopqp.plants.mujoco import SpringHand
from coopqp.scenario.scenario import Scenario
from coopqp.task import Task
from coopqp.tasks import InternalWrench
from coopqp.trace import Trace

WANTED = 60.0  # [N]
STIFFNESSES = (1e3, 2e3, 5e3, 1e4)  # [N/m]
CAUTIONS = (0.2, 0.5, 1.0, 1.5, 2.0, 2.5, 2.9)
LAG, DELAY = 0.01, 1  # [s], [ticks]
END = 50  # ticks


@dataclass(frozen=True)
class Ran:
    """A run: squeeze after each tick [N], and the stiffness that it shows [N/m]."""

    squeeze: Array
    stiffness: float
    dt: float

    @property
    def overshoot(self) -> float:
        return 100.0 * max(0.0, float(self.squeeze.max()) / WANTED - 1.0)

    @property
    def settled(self) -> float:
        """When it is within 2 % for good [s]; NaN where it never is."""
        off = np.flatnonzero(np.abs(self.squeeze - WANTED) > 0.02 * WANTED)
        last = int(off[-1]) + 1 if len(off) else 0
        return np.nan if last == len(self.squeeze) else (last + 1) * self.dt


def squeezes(trace: Trace) -> Array:
    """By the plant's force sensors, shape (T,) [N]."""
    told = zip(trace.signals["hand_point"], trace.signals["hand_wrench"], strict=True)
    return np.array([section(*p.reshape(2, 3)).of(h)[0] for p, h in told])


def ran(scenario: Scenario, hand: float, stated: float, share: float, seconds: float) -> Ran:
    """Hands of so many newtons per metre each; a share of the gain for what is stated."""
    admittance = Admittance(stiffness=stated, lag=LAG, delay=DELAY)
    default = admittance.gain_of(scenario.dt, 1.0 / scenario.dt)
    law = QPController(admittance=replace(admittance, gain=share * default))
    plant = scenario.plant
    assert isinstance(plant, Mujoco)
    trace = coopqp.run(
        replace(
            scenario,
            tasks=(*still(scenario), InternalWrench(squeeze=WANTED)),
            controllers={"qp": law},
            plant=replace(plant, spring_hands=SpringHand(stiffness=hand)),
            duration=seconds,
        ),
        controller="qp",
    )
    found = squeezes(trace)
    way = float(np.linalg.norm(trace.loop_offset[-END:, :3].mean(axis=0)))
    return Ran(found, float(found[-END:].mean()) / way, scenario.dt)


def still(scenario: Scenario) -> tuple[Task, ...]:
    """The scenario's motion, put off for good."""
    return tuple(
        replace(task, profile=replace(task.way, delay=1e3)) for task in scenario.tasks if task.way
    )


def main() -> None:
    scenario = coopqp.load("position_pair")
    servos = 1.0 / (1.0 / ran(scenario, 2e4, 1e4, 1.0, 2.0).stiffness - 2.0 / 2e4)
    print(f"the servos alone are {servos:.0f} N/m\n")
    print(
        "| hands [N/m] | in series [N/m] | stated [N/m] | reached [N] | overshoot [%] | 2 % [s] |"
    )
    print("|---|---|---|---|---|---|")
    for k in STIFFNESSES:
        hand = 2.0 / (1.0 / k - 1.0 / servos)
        for stated in dict.fromkeys((k, max(STIFFNESSES))):
            run = ran(scenario, hand, stated, 1.0, 2.0 + 1.0 * stated / k)
            end = run.squeeze[-END:].mean()
            print(
                f"| {hand:.0f} | {run.stiffness:.0f} | {stated:g} | {end:.3f} | "
                f"{run.overshoot:.2f} | {run.settled:.2f} |"
            )
    k = 1e4
    hand = 2.0 / (1.0 / k - 1.0 / servos)
    print("\n| c | g k dt | limit without lag | overshoot [%] | oscillation at the end [N] |")
    print("|---|---|---|---|---|")
    for c in CAUTIONS:
        run = ran(scenario, hand, k, c / 0.2, 4.0)
        gain = c / (k * (LAG + (DELAY + 1) * scenario.dt))
        oscillation = np.ptp(run.squeeze[-END:])
        print(
            f"| {c:g} | {gain * k * scenario.dt:.3f} | {stability_limit(DELAY):g} | "
            f"{run.overshoot:.1f} | {oscillation:.2f} |"
        )


if __name__ == "__main__":
    main()
