"""Describe a motion in Python and run the loop for robots by hand, here with joints that obey.

python examples/own_loop.py
"""

from __future__ import annotations

import numpy as np

from coopqp import HeldObject, OnlineLoop, Profile, Scenario
from coopqp.base.spec import Array
from coopqp.robots import NaoT14
from coopqp.tasks import JointCentering, PointOnPoint

START = {"right": [0.7, -0.2, 1.2, 0.9, 0.1], "left": [0.7, 0.2, -1.2, -0.9, -0.1]}  # [rad]


class Joints:
    """A robot that is at once where it is told to be; yours talks to motors."""

    def __init__(self, q: Array) -> None:
        self.q = q.copy()

    def read(self) -> Array:
        """Where the joints are [rad]."""
        return self.q.copy()

    def write(self, q: Array, v: Array) -> None:
        """Go there, with this speed."""
        self.q[:] = q


def main() -> None:
    """Move a box to a point, close to the body."""
    scenario = Scenario(
        name="own_loop",
        robot=NaoT14(),
        start=START,
        held=HeldObject(size=(0.08, 0.19, 0.08)),
        tasks=(PointOnPoint(name="reach", goal=(0.13, 0.05, 0.03), profile=Profile(duration=2.0)),),
        secondary=(JointCentering(gain=0.5),),
        duration=3.0,
    )
    loop = OnlineLoop(scenario, "qp", clock=None)  # counts ticks: there is nothing to wait for
    robot = Joints(scenario.chain.q_start)
    while loop.running:
        command = loop.tick(robot.read())
        if not command.status.usable:
            print(command.status.value, command.note)
        robot.write(loop.setpoint, command.v)
        if loop.ticks == round(scenario.duration / scenario.dt):
            loop.end()
    state = loop.state
    print("object at", np.round(state.p_WO, 4), "m; loop error", state.loop_position_error, "m")


if __name__ == "__main__":
    main()
