"""Build everything by hand and call the controller from a loop of your own.

python examples/own_loop.py
"""

from __future__ import annotations

import numpy as np

from coopqp import ClosedChain, ControlProblem, HeldObject, Profile
from coopqp.controllers import QPController
from coopqp.grasps import Rigid
from coopqp.limits import JointPosition, JointVelocity
from coopqp.robots import NaoT14
from coopqp.solvers import Daqp
from coopqp.tasks import JointCentering, PointOnPoint

DT = 0.01  # [s]


def main() -> None:
    """Move a box to a point, close to the body."""
    nao = NaoT14().build()
    start = {"right": [0.7, -0.2, 1.2, 0.9, 0.1], "left": [0.7, 0.2, -1.2, -0.9, -0.1]}
    chain = ClosedChain.take_hold(
        nao, nao.configuration(start), Rigid(), HeldObject(size=(0.08, 0.19, 0.08))
    )
    reach = PointOnPoint(name="reach", goal=(0.13, 0.05, 0.03), profile=Profile(duration=2.0))
    problem = ControlProblem(
        chain=chain,
        tasks=[reach],
        secondary=[JointCentering(gain=0.5)],
        limits=[JointPosition(), JointVelocity()],
        solver=Daqp(),
        dt=DT,
        kappa=1.0 / DT,
    )
    law = QPController().build(problem)
    state = law.start(q_measured=chain.q_start)  # robot.read()
    for _ in range(300):
        command = law.tick(state)
        if not command.status.usable:
            print(command.status.value)
        # your robot.send(command.v) goes here
        state.advance(command.v, DT)  # state.q is what was commanded ...
        state.q_measured = state.q.copy()  # ... and this what robot.read() says
    state.update()
    print("object at", np.round(state.p_WO, 4), "m; loop error", state.loop_position_error, "m")


if __name__ == "__main__":
    main()
