"""
A plane that tilts
==================

A point of the box stays on a tray that tilts by 30 degrees and rises. That is one row, the
height of the point above the tray, eq. (35) to (37) of the paper; five directions are left
free.
"""

import matplotlib.pyplot as plt
import numpy as np

import coopqp

scenario = coopqp.load("tilting_plane")
trace = coopqp.run(scenario, controller="qp")
(tray,) = scenario.tasks
point = trace.position + trace.rotation @ np.array(tray.point)  # of the box, in the world [m]

figure, (side, height) = plt.subplots(1, 2, figsize=(10, 4), layout="constrained")
for k, shade in zip(
    np.linspace(0, len(trace.t) - 1, 6, dtype=int), np.linspace(0.8, 0.0, 6), strict=True
):
    wide, high = 0.04, 0.04  # half the box [m]
    corners = np.array([[-wide, -high], [wide, -high], [wide, high], [-wide, high], [-wide, -high]])
    placed = trace.position[k, [0, 2]] + corners @ trace.rotation[k][np.ix_([0, 2], [0, 2])].T
    side.plot(*placed.T, color=str(shade))
side.plot(point[:, 0], point[:, 2], "tab:blue", lw=2, label="the point on the tray")
side.set(
    title="the box from the side, light to dark", xlabel="x [m]", ylabel="z [m]", aspect="equal"
)
side.legend()
height.semilogy(trace.t, 1e3 * np.abs(trace.goal_error[:, 0]) + 1e-9)
height.set(title="point above the tray", xlabel="t [s]", ylabel="[mm]")
plt.show()

print(f"at the end {1e3 * trace.goal_error[-1, 0]:.2g} mm from the tray")
