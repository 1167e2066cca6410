"""
A singular pose
===============

The goal is exactly as far forward as the arms reach. There the Jacobian loses a direction, and
a pseudoinverse asks for joint speeds that no motor has. Damping keeps the speeds small and
stops short. The QP has the speeds' limits as constraints.
"""

import matplotlib.pyplot as plt
import numpy as np

import coopqp

comparison = coopqp.compare(coopqp.load("near_singular"))

figure, (speed, error) = plt.subplots(1, 2, figsize=(10, 4), layout="constrained")
for name, trace in comparison.traces.items():
    speed.semilogy(trace.t[1:], np.abs(trace.v / trace.velocity).max(axis=1).clip(1e-4), label=name)
    error.semilogy(trace.t, 1e3 * trace.goal_error[:, 0])
speed.axhline(1.0, color="k", lw=1, ls=":")
speed.set(title="fastest joint (dotted: its limit)", xlabel="t [s]", ylabel="share of its limit")
error.set(title="distance to the goal", xlabel="t [s]", ylabel="[mm]")
speed.legend()
plt.show()

for name, verdict in comparison.verdicts.items():
    print(f"{name:25} {verdict}")
