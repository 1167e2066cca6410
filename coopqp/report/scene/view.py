"""Which part of space the playback shows, and what must fit into a picture of it.

Letters: m points, r rims.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from coopqp.checked import Array
from coopqp.comparison import Comparison
from coopqp.report.scene.bodies import Body, body_places
from coopqp.report.scene.triangles import joined, moved
from coopqp.robot import RobotModel
from coopqp.trace import Trace

WIDEST = 0.5  # times the size at the start; further out the view does not follow
SLICES = 8  # of what is shown, to find the largest scale at which it fits
DECIMALS = 4  # tenths of a millimetre


def view(comparison: Comparison, bodies: Sequence[Body], goals: Array) -> dict[str, Any]:
    """Lowest and highest corner of what is shown, and its rims.

    Shown is all there is, but nothing that flies away or stands far from what moves.
    """
    traces, half = comparison.traces.values(), 0.5 * max(comparison.scenario.held.size)
    moving = [points for trace in traces for points in trace.points.values()]
    for trace in traces:
        moving += [trace.position[:, None] - half, trace.position[:, None] + half]
    starts = np.concatenate([points[0] for points in moving])
    reach = WIDEST * np.ptp(starts, axis=0).max()
    surfaces = [_vertices(comparison.scenario.chain.robot, bodies, trace) for trace in traces]
    everything = np.concatenate([*(points.reshape(-1, 3) for points in moving), *surfaces])
    everything = everything[np.isfinite(everything).all(axis=1)]
    near = np.clip(everything, starts.min(axis=0) - reach, starts.max(axis=0) + reach)
    shown = np.concatenate([near, goals])
    low, high = shown.min(axis=0), shown.max(axis=0)
    found = {"low": low, "high": high, "rims": _rims(shown, 0.5 * (low + high))}
    return {name: values.round(DECIMALS).tolist() for name, values in found.items()}


def _rims(points: Array, middle: Array) -> Array:
    """What the points reach when turned about z: heights and radii, shape (r, 2)."""
    x, y, z = (points - middle).T
    radius, half = np.hypot(x, y), np.ptp(z) / (2 * SLICES)
    rims = []
    for height in np.linspace(z.min(), z.max(), SLICES + 1):
        near = np.abs(z - height) <= half
        if near.any():
            rims += [(end, radius[near].max()) for end in (z[near].min(), z[near].max())]
    return np.array(rims)


def _vertices(robot: RobotModel, bodies: Sequence[Body], trace: Trace) -> Array:
    """Of all bodies at the start and at the end, shape (m, 3) [m]."""
    ends = np.array([0, len(trace.t) - 1])
    surfaces = [
        moved(body.surface, X)
        for places in body_places(robot, bodies, trace, ends)
        for body, X in zip(bodies, places, strict=True)
    ]
    return joined(surfaces).vertices
