"""Arrows of what hands do to the object, and of its weight; and the squeeze as a number.

An arrow of a hand ends where the hand touches the object, so that what presses comes from outside.
The longest of all is a little longer than the object; the weight has the same scale, from the
centre of mass on.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from coopqp.base.spec import Array
from coopqp.report.scene.markers import short
from coopqp.scenario.scenario import Scenario
from coopqp.trace import Trace

Json = dict[str, Any]

GRAVITY = 9.81  # [m/s2]
#: Length of the longest arrow, in the object's longest edge.
LONGEST = 1.3
#: Share of frames whose forces are drawn to scale; shocks beyond are cut off.
ORDINARY = 0.95
#: Forces below are drawn as those [N].
LEAST_FORCE = 1.0


def weight(scenario: Scenario) -> float:
    """Of the real object [N]."""
    return GRAVITY * scenario.held.mass * scenario.disturbance.object_mass


def squeeze_words(found: list[float]) -> str:
    """Such as "squeeze 60.0 N"; empty where there is none."""
    numbers = ", ".join(f"{newtons:.3g}" for newtons in found)
    return f"squeeze {numbers} N" if found else ""


def told(trace: Trace, k: int) -> tuple[Array, Array] | None:
    """Points and wrenches of the hands at an instant; None at the first, or if nobody tells."""
    signals = trace.signals
    if k == 0 or "hand_wrench" not in signals:
        return None
    return signals["hand_point"][k - 1].reshape(-1, 3), signals["hand_wrench"][k - 1].reshape(-1, 6)


def arrows(trace: Trace, scenario: Scenario, frames: NDArray[np.int64]) -> Json | None:
    """Start and way of each arrow in each frame, for ``playback.js``; None without forces."""
    if "hand_wrench" not in trace.signals or not trace.ticks:
        return None
    points = trace.signals["hand_point"].reshape(trace.ticks, -1, 3)
    forces = trace.signals["hand_wrench"].reshape(trace.ticks, -1, 6)[:, :, :3]
    down = weight(scenario)
    sizes = np.nan_to_num(np.linalg.norm(forces, axis=2).max(axis=1))
    longest = max(float(np.quantile(sizes, ORDINARY)), down, LEAST_FORCE)
    scale = LONGEST * max(scenario.held.size) / longest
    before = frames[frames > 0] - 1
    ways = scale * _cut(np.nan_to_num(forces[before]), longest)
    starts = np.where((ways != 0.0).any(axis=2, keepdims=True), points[before] - ways, 0.0)
    hands = np.zeros((len(frames), points.shape[1], 6))
    hands[frames > 0] = np.concatenate([starts, ways], axis=2)
    own = np.array(scenario.held.com) + scenario.disturbance.object_com  # of the real object [m]
    com = trace.position[frames] + trace.rotation[frames] @ own
    falls = np.tile([0.0, 0.0, -scale * down], (len(frames), 1))
    return {"hands": short(hands), "weight": short(np.concatenate([com, falls], axis=1))}


def _cut(forces: Array, longest: float) -> Array:
    """Forces no longer than the longest."""
    sizes = np.linalg.norm(forces, axis=2, keepdims=True)
    return np.asarray(forces * np.minimum(1.0, longest / np.maximum(sizes, 1e-9)), float)
