"""
A signal that is followed live
==============================

A goal need not be known before: what arrives from a camera or a joystick is an *input*. Between
what arrives and what the task follows is a limiter: speed, acceleration and jerk of the
reference are bounded, however wildly the values jump.
"""

import matplotlib.pyplot as plt
import numpy as np

from coopqp import HeldObject, InputSettings, OnlineLoop, Profile, Scenario
from coopqp.online.simulated import SimulatedRobot
from coopqp.robots import NaoT14
from coopqp.signals import Input
from coopqp.tasks import JointCentering, PointOnPoint

scenario = Scenario(
    name="live",
    robot=NaoT14(),
    start={"right": [0.7, -0.2, 1.2, 0.9, 0.1], "left": [0.7, 0.2, -1.2, -0.9, -0.1]},
    held=HeldObject(size=(0.08, 0.19, 0.08)),
    tasks=(PointOnPoint(goal=Input(name="target"), gain=10.0, profile=Profile(kind="step")),),
    secondary=(JointCentering(gain=0.5),),
    inputs={"target": InputSettings(velocity=0.1, acceleration=0.5, jerk=5.0)},
    duration=6.0,
)

# %%
# The loop is the one that runs on robots; here it counts ticks instead of looking at a clock, and
# the robot is the scenario's own plant. A camera says in every tick where the target is; it jumps
# every second and a half. (From an input that falls silent the reference comes to rest after 0.25
# s.)

JUMPS = [[0.15, 0.0, 0.06], [0.17, 0.02, 0.06], [0.15, 0.0, 0.09], [0.16, -0.02, 0.05]]
loop = OnlineLoop(scenario, "qp", clock=None, reference="measured")
robot = SimulatedRobot(loop)
arrived, followed, reached = [], [], []
for tick in range(600):
    arrived.append(JUMPS[tick // 150])
    command = loop.tick(robot.read(), inputs={"target": arrived[-1]})
    robot.write(loop.setpoint, command.v)
    followed.append(loop.state.inputs["target"].value.copy())
    reached.append(loop.state.p_WO.copy())
loop.end()

t = scenario.dt * np.arange(600)
figure, axes = plt.subplots(1, 3, figsize=(11, 3.6), layout="constrained")
for axis, name, k in zip(axes, "xyz", range(3), strict=True):
    axis.step(t, np.array(arrived)[:, k], color="0.6", where="post", label="arrived")
    axis.plot(t, np.array(followed)[:, k], "k--", label="reference")
    axis.plot(t, np.array(reached)[:, k], "tab:blue", label="the box")
    axis.set(title=name, xlabel="t [s]", ylabel="[m]")
axes[0].legend()
plt.show()
