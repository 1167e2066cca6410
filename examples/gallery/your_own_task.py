"""
A task of your own, in ten lines
================================

A task is an error and its Jacobian. This one keeps the box away from the robot's middle: its
distance from the vertical axis through the torso. Before the first tick its Jacobian is
compared with the derivative of its error, so that a mistake in it is found before anything
moves.
"""

import matplotlib.pyplot as plt
import numpy as np

from coopqp import Evaluate, HeldObject, Scenario, State, Task, TaskRows, run, spec
from coopqp.robots import NaoT14
from coopqp.tasks import JointCentering


@spec
class KeepAway(Task):
    """The object keeps a distance from the upright axis through the torso (1 row)."""

    distance: float

    def rows(self, chain: object) -> tuple[str, ...]:
        return ("away",)

    def bind(self, start: State) -> Evaluate:
        def evaluate(state: State, rows: TaskRows) -> None:
            out = state.p_WO * [1, 1, 0]
            rows.e[0] = np.linalg.norm(out) - self.distance  # [m]
            rows.J[0] = out / np.linalg.norm(out) @ state.J_task[:3]  # [m/rad]

        return evaluate


# %%
# It is used as the shipped ones are. In a file of its own, ``tasks/keep_away.py``, scenarios in
# YAML can name it, too.

scenario = Scenario(
    name="keep_away",
    robot=NaoT14(),
    start={"right": [0.7, -0.2, 1.2, 0.9, 0.1], "left": [0.7, 0.2, -1.2, -0.9, -0.1]},
    held=HeldObject(size=(0.08, 0.19, 0.08)),
    tasks=(KeepAway(distance=0.14, gain=4.0),),
    secondary=(JointCentering(gain=0.5),),
    duration=3.0,
)
trace = run(scenario, controller="qp")

figure, (above, error) = plt.subplots(1, 2, figsize=(10, 4), layout="constrained")
above.add_patch(plt.Circle((0, 0), 0.14, fill=False, ls="--"))
for points in trace.points.values():
    above.plot(points[0, :, 0], points[0, :, 1], "o-", color="0.7")
    above.plot(points[-1, :, 0], points[-1, :, 1], "o-")
above.plot(trace.position[:, 0], trace.position[:, 1], "k", lw=2)
above.set(title="from above: way of the box", xlabel="x [m]", ylabel="y [m]", aspect="equal")
error.plot(trace.t, 1e3 * trace.e[:, 0])
error.set(title="error", xlabel="t [s]", ylabel="[mm]")
plt.show()
