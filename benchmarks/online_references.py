"""What the loop's options for the reference and the grasp do to the object, on wrong models.

python benchmarks/online_references.py

Runs calibration_error (2 mm and 5 mrad off, noise, a delay of two ticks) on rigid bodies. Prints
the internal force between the hands, and how often motors were at their limits.
"""

from __future__ import annotations

import itertools

import numpy as np

import coopqp
from coopqp import OnlineLoop
from coopqp.online.simulated import SimulatedRobot

TICKS, END = 300, 50


def main() -> None:
    """Print the table."""
    scenario = coopqp.load("calibration_error")
    print(f"{'reference':12s}{'grasp':12s}{'most [N]':>10s}{'end [N]':>10s}{'at limits':>11s}")
    for reference, grasp in itertools.product(("commanded", "measured"), ("as_held", "as_written")):
        loop = OnlineLoop(scenario, clock=None, reference=reference, grasp=grasp)
        robot = SimulatedRobot(loop)
        forces, limits = np.zeros(TICKS), np.zeros(TICKS)
        for k in range(TICKS):
            command = loop.tick(robot.read())
            robot.write(loop.setpoint, command.v)
            wrenches = robot.plant.signals["internal_wrench"].reshape(-1, 6)
            forces[k] = np.linalg.norm(wrenches[:, :3], axis=1).max()
            limits[k] = robot.plant.signals["saturated"].mean()
        print(
            f"{reference:12s}{grasp:12s}{forces.max():10.3f}{forces[-END:].mean():10.3f}"
            f"{100 * limits.mean():10.1f}%"
        )


if __name__ == "__main__":
    main()
