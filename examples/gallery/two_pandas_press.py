"""
Two Pandas press on a box
=========================

Nothing but friction holds a box of 2 kg between two pads. A QP on forces decides in every tick
how hard the hands press, so that the box is carried and no pad slips. The box is lifted, and
then pushed down by 10 N of which the law is not told. Needs ``coopqp[robots]``.
"""

from dataclasses import replace

import matplotlib.pyplot as plt
import numpy as np

from coopqp import Disturbance, Pose, load, run
from coopqp.plant import Push
from coopqp.plants import RigidBody
from coopqp.signals import Waypoints
from coopqp.tasks import Pose as PoseTask

shipped = load("press_and_lift")  # two Pandas, the box, the pads and a start
up = Waypoints(
    times=[0.0, 0.2, 1.2],
    values=[Pose(position=(0.6, 0.0, z)) for z in (0.45, 0.45, 0.53)],
    between="minimum_jerk",
)
scenario = replace(
    shipped,
    tasks=(PoseTask(name="carry", goal=up, gain=10.0),),
    plant=RigidBody(),
    disturbance=Disturbance(push=Push(force=(0.0, 0.0, -10.0), start=1.4, duration=0.5)),
    dt=0.005,
    duration=2.8,
)
trace = run(scenario, controller="torque_qp")

# %%
# Each pad can bear a share of the normal force sideways, its friction. The figure on the right is
# how much of that is used: at 1 the pad would slip.

t = trace.t[1:]
figure, (height, forces, use) = plt.subplots(1, 3, figsize=(12, 3.6), layout="constrained")
height.plot(trace.t, trace.position[:, 2])
height.set(title="height of the box", xlabel="t [s]", ylabel="[m]")
for i, (arm, line) in enumerate(zip(trace.points, ("-", "--"), strict=True)):
    forces.plot(t, trace.signals["normal_force"][:, i], line, label=arm)
    use.plot(t, trace.signals["friction_use"][:, i], line)
forces.set(title="normal force of each pad", xlabel="t [s]", ylabel="[N]", ylim=(0, None))
forces.legend()
use.axhline(1.0, color="k", lw=1, ls=":")
use.set(title="share of the friction used", xlabel="t [s]", ylim=(0, 1.1))
for axis in (height, forces, use):
    axis.axvspan(1.4, 1.9, color="tab:orange", alpha=0.15)
plt.show()

print("held all the time:", bool(np.all(trace.signals["held"])))
