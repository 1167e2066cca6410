"""A scenario that follows a plan: its path first, then the tasks where they are met.

The path is the reference of joints and object, with its rates as feed-forward; all limits stay in
force. Where the plan ends begins the phase of the scenario's own tasks.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from coopqp.base.errors import InvalidValueError, under
from coopqp.base.reading import FilePath
from coopqp.base.spec import spec
from coopqp.base.table import read_table
from coopqp.scenario.scenario import Phase, Scenario
from coopqp.signal import POSE
from coopqp.signals import Waypoints
from coopqp.task import Task
from coopqp.tasks import Pose, Posture

#: How fast what is left of an error goes to zero along the path [1/s].
GAIN = 10.0
WAY, GOAL = "way", "goal"
#: How long the reference stays where the plan ends [s].
SETTLES = 0.5
#: How far a plan may begin from the start [rad, m].
NEAR = 1e-3


@spec
class Followed:
    """A plan that is followed."""

    plan: FilePath
    """The file that coopqp plan has written."""


def refuse_phases(scenario: Scenario) -> None:
    """InvalidValueError where a scenario has phases, and no plan can come before its tasks."""
    if scenario.phases:
        raise InvalidValueError(
            "a plan comes before tasks, and this scenario has phases, or a plan, already; "
            "plan for a scenario without"
        )


def following(scenario: Scenario, path: Path) -> Scenario:
    """The scenario with the plan of a file before its tasks.

    Raises:
        CoopqpError: the file is none that 'coopqp plan' writes for such a robot and start, or the
            scenario has phases of its own.
    """
    refuse_phases(scenario)
    with under("plan"):
        table = read_table(path)
        q = table.take(scenario.chain.joint_names)
        table.take(POSE.columns)
        end = float(table.times()[-1])
        off = np.abs(q[0] - scenario.chain.q_start)
        if off.max() > NEAR:
            joint = scenario.chain.joint_names[int(off.argmax())]
            words = f"begins {off.max():.3g} from the start of {joint}; plan the way anew from here"
            raise InvalidValueError(f"{path}: {words}")
    first = Phase(name=WAY, duration=end + SETTLES, tasks=tasks_along(path, scenario.dt))
    then = Phase(name=GOAL, duration=scenario.duration, tasks=scenario.tasks)
    return replace(scenario, tasks=(), duration=0.0, phases=(first, then))


def tasks_along(path: Path, dt: float) -> tuple[Task, ...]:
    """Joints and object follow the plan of a file, with ticks of dt [s]."""
    way, gain = Waypoints(file=path, between="linear"), min(GAIN, 1.0 / dt)
    return (
        Posture(name="planned joints", goal=way, gain=gain),
        Pose(name="planned object", goal=way, gain=gain),
    )
