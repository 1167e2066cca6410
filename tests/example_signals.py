"""Every signal with settings of an example."""

from __future__ import annotations

import numpy as np

from coopqp.base.spec import Array, Pose
from coopqp.signal import POSE, Kind, Signal
from coopqp.signals import Circle, Input, Line, Waypoints

TIMES = [0.2, 0.9, 1.7, 3.1]


def near(kind: Kind, value: Array, rng: np.random.Generator) -> list[list[float]]:
    """Values near one, first and last the same."""
    found = []
    for _ in TIMES[1:]:
        there = value + 0.1 * rng.standard_normal(kind.values)
        if kind.turns:
            there[kind.numbers :] /= np.linalg.norm(there[kind.numbers :])
        found.append((there[:3] if kind.axis else there).tolist())
    return [*found, found[0]]


#: At least one of every class, for places; a new signal needs a line here.
EXAMPLES: dict[str, Signal] = {
    "circle": Circle(center=(0.15, 0.0, 0.06), radius=0.02, normal=(1, -1, 3), period=2.0),
    "line": Line(start=[0.15, 0.0, 0.06], end=[0.17, 0.03, 0.05], period=2.5),
    "input": Input(name="target"),
    "waypoints": Waypoints(times=[0.0, 1.0, 2.0], values=[[0.15, 0, 0.06], [0.16, 0.02, 0.06],
                                                         [0.15, 0, 0.07]]),
    "poses": Waypoints(
        times=[0.0, 1.0],
        values=[Pose(position=(0.15, 0, 0.06)), Pose(position=(0.16, 0, 0.06), rpy_deg=(0, 0, 9))],
    ),
}  # fmt: skip
assert POSE.values == 7
