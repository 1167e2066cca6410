"""Whether joints go to and fro for ever, at any frequency, while the references rest.

A joint oscillates where its path is much longer than its range, and the range does not fade:

    sum |q_k+1 - q_k| > RATIO (max q - min q),   range > MIN_RANGE,   range now > KEPT range before

over blocks of W ticks, W = 8, 16, 32, ... and a third of the resting time. A ramp and an approach
have a ratio of 1, a single way there and back has 2, a sine has 2 a period. The first third of the
resting time is left to what settles; "before" is the second third, "now" the last. In each the
median block counts.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from coopqp.assessment.thresholds import OSCILLATES
from coopqp.base.spec import Array

RATIO = 2.5  # path over range of an oscillation: more than once there and back
KEPT = 0.7  # one whose range becomes less than this from one third to the next fades
#: Ranges that nobody sees: what half a metre makes of 0.2 mrad is 0.1 mm.
MIN_RANGE = {"rad": 2.0 * OSCILLATES, "m": float(OSCILLATES)}
NOISY = 5.0  # deviations of the encoders' noise that the range of commands may be wider
SHORTEST = 8  # ticks of the shortest block


@dataclass(frozen=True)
class Oscillation:
    """A joint, by its index, that oscillates: its range [rad, m] and frequency [Hz]."""

    joint: int
    size: float
    frequency: float


def oscillation(
    q: Array, units: Sequence[str], dt: float, *, longest: float = math.inf, noise: float = 0.0
) -> Oscillation | None:
    """The widest oscillation of joints; None where nothing oscillates.

    q is since all references rest, shape (T + 1, n) [rad, m]. What still moves after ``longest``
    ticks is as good as at rest; the encoders' noise has this standard deviation [rad].
    """
    third = (len(q) - 1) // 3
    if third < SHORTEST or not np.isfinite(q).all():
        return None
    narrowest, now = smallest_ranges(units) + NOISY * noise, q[-1 - third :]
    steps = np.diff(np.asfortranarray(now), axis=0)
    turns = (steps.max(axis=0) > 0.0) & (steps.min(axis=0) < 0.0)
    joints = np.flatnonzero(turns & (reach(now) > narrowest))  # what others have no block has
    if not len(joints):
        return None
    narrowest, before, now = narrowest[joints], q[-1 - 2 * third : -third, joints], now[:, joints]
    widest: Oscillation | None = None
    doubled = [SHORTEST << k for k in range((third // SHORTEST).bit_length())]
    for ticks in (ticks for ticks in (*doubled, third) if ticks <= longest):
        (was, was_ratio), (size, ratio) = _blocks(before, ticks), _blocks(now, ticks)
        found = (np.minimum(ratio, was_ratio) > RATIO) & (size > KEPT * was) & (size > narrowest)
        over = np.where(found, size / narrowest, 0.0)
        i = int(over.argmax())
        if found[i] and (widest is None or size[i] > widest.size):
            # A range is crossed twice a period.
            frequency = float(ratio[i]) / (2.0 * ticks * dt)
            widest = Oscillation(int(joints[i]), float(size[i]), frequency)
    return widest


def smallest_ranges(units: Sequence[str]) -> Array:
    """Smallest range of joints that is an oscillation, shape (n,)."""
    return np.array([MIN_RANGE[unit] for unit in units])


def _blocks(q: Array, ticks: int) -> tuple[Array, Array]:
    """Range and path over range of the median block, of all blocks of so many ticks."""
    count = (len(q) - 1) // ticks
    first = len(q) - 1 - count * ticks
    inside = first + ticks * np.arange(count)[:, None] + np.arange(ticks + 1)
    blocks = q[inside].swapaxes(0, 1)
    size, path = reach(blocks), np.abs(np.diff(blocks, axis=0)).sum(axis=0)
    ratio = np.divide(path, size, out=np.zeros_like(size), where=size > 0.0)
    return _median(size), _median(ratio)


def _median(values: Array) -> Array:
    """Along the first axis; numpy's own takes five times as long for so few numbers."""
    values, k = np.sort(values, axis=0), len(values)
    return np.asarray(0.5 * (values[(k - 1) // 2] + values[k // 2]))


def reach(q: Array) -> Array:
    """Range along the first axis; numpy takes a fifth of the time where that is contiguous."""
    q = np.asfortranarray(q)
    return np.asarray(q.max(axis=0) - q.min(axis=0))
