"""Loops for robots in tests: scenarios with inputs, a clock that is told the time, robots."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

import coopqp
from coopqp.base.spec import Array
from coopqp.online.loop import OnlineLoop
from coopqp.online.simulated import SimulatedRobot
from coopqp.scenario.scenario import Scenario

#: NAO follows a point that arrives from outside, a hundred times a second.
FOLLOWS = """
robot: nao_t14
start:
  right: [0.7, -0.2, 1.2, 0.9, 0.1]
  left: [0.7, 0.2, -1.2, -0.9, -0.1]
tasks:
  - point_on_point: {name: follow, goal: {input: target}, gain: 10.0, profile: {kind: step}}
secondary:
  - joint_centering: {gain: 0.5}
inputs:
  target: {velocity: 0.1, acceleration: 0.5, jerk: 5.0}
controllers: [qp, pseudoinverse]
plant: PLANT
dt: 0.01
duration: 3.0
"""


@cache
def follows(plant: str = "kinematic", more: str = "") -> Scenario:
    """NAO follows a point."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "follows.yaml"
        path.write_text(FOLLOWS.replace("PLANT", plant) + more, encoding="utf-8")
        return coopqp.load(path)


class Told:
    """A clock that says what it was told."""

    def __init__(self) -> None:
        self.t = 100.0

    def __call__(self) -> float:
        return self.t


def simulated(scenario: Scenario, **settings: Any) -> tuple[OnlineLoop, SimulatedRobot]:
    """A loop that counts ticks, and its scenario's plant; joints that do as told."""
    given = {"clock": None, "reference": "measured", **settings}
    loop = OnlineLoop(scenario, **given)
    return loop, SimulatedRobot(loop)


def go(
    loop: OnlineLoop, robot: SimulatedRobot, ticks: int, inputs: Any = None
) -> tuple[Array, Array]:
    """Some periods; from where each tick decided and what it commanded, shapes (ticks, n)."""
    q, v = [], []
    for _ in range(ticks):
        command = loop.tick(robot.read(), inputs)
        q.append(loop.state.q.copy())
        v.append(command.v.copy())
        robot.write(loop.setpoint, command.v)
    return np.array(q), np.array(v)


class Scripted:
    """A robot that does exactly as told, and says what a script wants.

    Args:
        q: where it is.
        says: by tick, what it says instead; an exception is raised.
    """

    def __init__(self, q: Array, says: dict[int, Any] | None = None) -> None:
        self.q, self.says, self.reads = q.copy(), says or {}, 0
        self.written: list[Array] = []

    def read(self) -> ArrayLike | None:
        """What the script wants, or the truth."""
        tick, self.reads = self.reads, self.reads + 1
        found = self.says.get(tick, self.q.copy())
        if isinstance(found, BaseException):
            raise found
        return found() if callable(found) else found

    def write(self, q: Array, v: Array) -> None:
        """Be there."""
        self.q[:] = q
        self.written.append(v.copy())


class Machine:
    """The machine's time, of which each look takes 10 us; in the place of the module ``time``."""

    def __init__(self, began: float) -> None:
        self.now = began

    def monotonic(self) -> float:
        self.now += 1e-5
        return self.now

    def sleep(self, seconds: float) -> None:
        self.now += seconds
