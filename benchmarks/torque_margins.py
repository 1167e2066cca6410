"""Steps, pushes, weights, delays and rates that the torque PID and the torque QP stand: tables.

    python benchmarks/torque_margins.py

prints what docs/dynamics.md says of the margins, in about two minutes. All runs are the scenario
passive_grasp_pose on the plant rigid_body with gain 25 1/s, but the box shall jump 3 cm at once.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from coopqp.base.spec import Pose
from coopqp.controller import Controller
from coopqp.controllers import PassiveGraspPid, TorqueQp
from coopqp.controllers.passive_grasp_pid import TorquePid
from coopqp.execution.controller_run import run
from coopqp.model.profile import Profile
from coopqp.plant import Disturbance, Push
from coopqp.plants import RigidBody
from coopqp.scenario.loader import load
from coopqp.scenario.scenario import Scenario
from coopqp.tasks import Pose as PoseTask
from coopqp.torque_law.margins import TorqueLoop, damped, largest, row_loop

GAIN = 25.0  # 1/s
DTS = (0.001, 0.002, 0.005, 0.01)  # s
DELAYS = (0, 1, 2, 3, 5, 10)  # ticks
SETTLED = 0.02  # of the step
CONTROLLERS: dict[str, Controller] = {"PID": PassiveGraspPid(), "torque QP": TorqueQp()}


@dataclass(frozen=True)
class Step:
    """What became of a step.

    Attributes:
        overshoot: beyond the goal, along the way, over the step [-].
        settled: from when on the error stays within 2 % of the step [s]; infinite if it does not.
        error: largest distance from the goal in the last fifth of the run [m].
    """

    overshoot: float
    settled: float
    error: float

    @property
    def holds(self) -> bool:
        """Whether it came to rest at the goal."""
        return self.settled < np.inf


def step_scenario(
    controller: Controller,
    *,
    dt: float = 0.002,
    duration: float = 1.5,
    disturbance: Disturbance | None = None,
) -> Scenario:
    """The scenario passive_grasp_pose, three centimetres without a turn."""
    scenario = load("passive_grasp_pose")
    (task,) = scenario.tasks
    assert isinstance(task, PoseTask)
    goal = Pose(position=task.goal.position)
    return replace(
        scenario,
        tasks=(replace(task, goal=goal, gain=GAIN, profile=Profile(kind="step")),),
        controllers={"c": controller},
        plant=RigidBody(),
        dt=dt,
        kappa=min(100.0, 1.0 / dt),
        duration=duration,
        disturbance=disturbance or Disturbance(),
    )


def step(scenario: Scenario) -> Step:
    """Run a scenario and measure; one that diverges has not settled."""
    (task,) = scenario.tasks
    assert isinstance(task, PoseTask)
    goal = np.array(task.goal.position)
    try:
        with np.errstate(all="ignore"):
            trace = run(scenario, controller="c")
    except np.linalg.LinAlgError:  # the joints have gone to infinity
        return Step(np.inf, np.inf, np.inf)
    e = trace.position - goal
    way = np.linalg.norm(e[0])
    distance = np.linalg.norm(e, axis=1)
    outside = np.flatnonzero(distance > SETTLED * way)
    last = int(outside[-1]) + 1 if len(outside) else 0
    return Step(
        overshoot=max(0.0, float(-(e @ e[0]).min() / way**2)),
        settled=float(trace.t[last]) if last < len(trace.t) else np.inf,
        error=float(distance[-len(distance) // 5 :].max()),
    )


def linear_loop(controller: Controller, dt: float) -> TorqueLoop:
    """The loop that the margins are computed from."""
    if isinstance(controller, TorqueQp):
        return row_loop(GAIN, controller.integral, dt)
    law = controller.build(step_scenario(controller, dt=dt).problem())
    assert isinstance(law, TorquePid)
    return law.loop


def delay_margin(loop: TorqueLoop) -> int:
    """Largest number of ticks that commands may be late, with the loop stable, up to 40."""
    return next(d - 1 for d in range(41) if d == 40 or loop.damping(d) <= 0.0)


def rates_and_delays() -> Iterator[Sequence[str]]:
    """A row for each controller and rate."""
    for name, controller in CONTROLLERS.items():
        for dt in DTS:
            cells = [name, f"{1e3 * dt:g}"]
            for delay in DELAYS:
                found = step(step_scenario(controller, dt=dt, disturbance=Disturbance(delay=delay)))
                cells.append(f"{100 * found.overshoot:.1f}" if found.holds else "-")
            yield [*cells, str(delay_margin(linear_loop(controller, dt)))]


def disturbances() -> Iterator[Sequence[str]]:
    """A row for each disturbance: steps, pushes and weights."""
    cases = {"none": Disturbance()}
    for force in (1.0, 5.0):
        push = Push(force=(0.0, force, 0.0), start=0.5, duration=0.2)
        cases[f"push of {force:g} N for 0.2 s"] = Disturbance(push=push)
    for mass in (0.5, 2.0):
        cases[f"{mass:g} times the mass"] = Disturbance(object_mass=mass)
    for name, controller in CONTROLLERS.items():
        for dt in (0.002, 0.01):
            for words, disturbance in cases.items():
                found = step(
                    step_scenario(controller, dt=dt, duration=3.0, disturbance=disturbance)
                )
                yield (
                    name,
                    f"{1e3 * dt:g}",
                    words,
                    f"{100 * found.overshoot:.1f}",
                    f"{found.settled:.2f}" if found.holds else "-",
                    f"{1e3 * found.error:.2f}",
                )


def integrals() -> Iterator[Sequence[str]]:
    """A row for each gain dt: the largest integral, and what it makes of the step."""
    for rate in (0.01, 0.05, 0.1, 0.15, 0.2, 0.25, 0.3):
        dt = rate / GAIN
        most = largest(lambda i, dt=dt: damped(row_loop(GAIN, i, dt)), 2.0)  # type: ignore[misc]
        stable = largest(lambda i, dt=dt: row_loop(GAIN, i, dt).damping() > 0.0, 2.5)  # type: ignore[misc]
        yield (f"{rate:g}", f"{most:g}", f"{stable:g}", str(delay_margin(row_loop(GAIN, 0.3, dt))))


def table(head: Sequence[str], rows: Iterator[Sequence[str]]) -> None:
    """Print one in Markdown."""
    print("\n| " + " | ".join(head) + " |\n" + "|---" * len(head) + "|")
    for row in rows:
        print("| " + " | ".join(row) + " |", flush=True)


def main() -> None:
    """Print all tables."""
    late = [f"{delay} late" for delay in DELAYS]
    print("Overshoot of a 3 cm step [%] by ticks that commands are late; - does not come to rest.")
    table(["controller", "dt [ms]", *late, "stable to [ticks]"], rates_and_delays())
    print("\nThe same step, with a push after 0.5 s or another mass of the box.")
    head = ["controller", "dt [ms]", "disturbance", "overshoot [%]", "within 2 % [s]"]
    table([*head, "left at the end [mm]"], disturbances())
    print("\nTorque QP, computed; commands one tick late but in the last column.")
    head = ["gain dt", "integral, at most", "stable below", "integral 0.3 stable to [ticks]"]
    table(head, integrals())


if __name__ == "__main__":
    main()
