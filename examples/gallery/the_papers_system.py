"""
The paper's system, from start to figures
=========================================

NAO holds a box between its hands: two arms of five joints each, and one object that both carry.
That is the system of "Control of a Lower Mobility Dual Arm System" (Long, Khalil and Caro, 2012).
A shipped scenario is loaded, looked at, run under three laws, drawn, and written as a page.
"""

# %%
# A scenario has everything in it: robot, grasp, start, tasks, limits. What is possible at all is
# known before anything moves. Ten joints and six independent loop rows leave four degrees of
# freedom.

from pathlib import Path
from tempfile import TemporaryDirectory

import matplotlib.pyplot as plt
import numpy as np

import coopqp
from coopqp.report import files

scenario = coopqp.load("joint_limit_avoidance")
free = coopqp.mobility(scenario.chain)
print(f"{len(free.joints)} joints, loop rows of rank {free.rank}: mobility {free.freedom}")

# %%
# Three laws do the same task, and say in a sentence each what became of it.

comparison = coopqp.compare(scenario)
for name, verdict in comparison.verdicts.items():
    print(f"{name:25} {verdict}")

# %%
# What the arms did, and the two figures that matter: does the box arrive, and does every joint
# stay inside its range? Figs. 4 to 8 of the paper show the same motion.

figure = plt.figure(figsize=(11, 4.2), layout="constrained")
space = figure.add_subplot(131, projection="3d")
trace = comparison.traces["qp"]
for arm, points in trace.points.items():
    space.plot(*points[0].T, "o-", color="0.7")
    space.plot(*points[-1].T, "o-", label=arm)
space.plot(*trace.position.T, "k", lw=2, label="way of the box")
space.set(title="first (grey) and last pose", xlabel="x [m]", ylabel="y [m]", zlabel="z [m]")
space.set_aspect("equal")
space.legend(loc="upper left", fontsize="small")

error, margin = figure.add_subplot(132), figure.add_subplot(133)
for name, trace in comparison.traces.items():
    error.semilogy(trace.t, 1e3 * trace.goal_error[:, 0], label=name)
    left = np.minimum(trace.q - trace.lower, trace.upper - trace.q).min(axis=1)
    margin.plot(trace.t, left)
error.set(title="distance to the goal", xlabel="t [s]", ylabel="[mm]")
margin.axhspan(margin.get_ylim()[0], 0.0, color="tab:red", alpha=0.1)
margin.set(title="nearest joint limit (red: beyond it)", xlabel="t [s]", ylabel="[rad]")
figure.legend(*error.get_legend_handles_labels(), loc="outside lower center", ncols=3)
plt.show()

# %%
# The page has these figures and many more, and a playback; ``coopqp compare NAME --out FOLDER``
# writes the same.

with TemporaryDirectory() as folder:
    for path in files.write(comparison, Path(folder)):
        print(path.name)
