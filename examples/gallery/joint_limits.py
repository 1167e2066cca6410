"""
Joint limits: a QP and two pseudoinverses
=========================================

The pseudoinverse knows nothing of joint limits. With a term in the null space it leans away
from them. The QP has them as constraints: it stops at a limit, and goes on with the other
joints as far as that takes it. Here the goal is behind the limits, so that nobody can have
both.
"""

import matplotlib.pyplot as plt

import coopqp

scenario = coopqp.load("joint_limit_stress")
comparison = coopqp.compare(scenario)

# %%
# The joint that one of the laws drives farthest beyond its range, under all of them.

worst = comparison.traces["pseudoinverse"]
beyond = (worst.lower - worst.q).clip(0) + (worst.q - worst.upper).clip(0)
joint = int(beyond.max(axis=0).argmax())

figure, (angle, error) = plt.subplots(1, 2, figsize=(10, 4), layout="constrained")
for name, trace in comparison.traces.items():
    angle.plot(trace.t, trace.q[:, joint], label=name)
    error.plot(trace.t, 1e3 * trace.goal_error[:, 0])
angle.axhspan(worst.lower[joint], worst.upper[joint], color="tab:green", alpha=0.12)
angle.set(title=f"{worst.joints[joint]} (green: its range)", xlabel="t [s]", ylabel="[rad]")
error.set(title="distance to the goal", xlabel="t [s]", ylabel="[mm]", ylim=(0, None))
angle.legend()
plt.show()

for name, verdict in comparison.verdicts.items():
    print(f"{name:25} {verdict}")
