"""What a recorded rollout shows: promises kept, joints that stand still.

Letters: n joints, T ticks.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from coopqp.assessment.thresholds import rests
from coopqp.base.spec import Array
from coopqp.solver import Budget, Status

EXCESS = 1e-9  # what a bound may be exceeded by, rounding [rad, rad/s]
STILL = 1e-6  # a joint below this share of its speed limit does not move
LATEST = 10  # ticks that tell how it ends
SHORTENED = (Status.STEP_SHORTENED, Status.LOOP_BUDGET)

Flags = NDArray[np.bool_]


@dataclass
class Record:
    """A rollout as it is driven.

    Attributes:
        lower, upper: position limits, shape (n,) [rad, m].
        speed: velocity limits as the problem has them, shape (n,) [rad/s, m/s].
        units: "rad" or "m" of each joint.
        rest: tick from which all references rest.
        longest: time in which what still moves is as good as at rest, in ticks.
        q: configurations before each tick and at last, shape (T + 1, n).
        v, causes: commands, shape (T, n), and what they say.
        plain: ticks that the kernel left to the plain law.
        loop_position, loop_orientation: largest loop error [m], [rad].
        forces: largest internal force of a hand after each tick and at first, where the plant has
            masses, T + 1 numbers [N].
        saturated: which motors were at their limits then, T + 1 of shape (n,).
    """

    lower: Array
    upper: Array
    speed: Array
    units: tuple[str, ...]
    dt: float
    rest: int
    longest: float
    q: Array
    v: Array
    causes: list[tuple[Status, ...]] = field(default_factory=list)
    plain: int = 0
    loop_position: float = 0.0
    loop_orientation: float = 0.0
    forces: list[float] = field(default_factory=list)
    saturated: list[Flags] = field(default_factory=list)

    @cached_property
    def scale(self) -> Array:
        """Speeds to compare with, shape (n,); without a limit it is the least of its own unit."""
        scale, units = self.speed.copy(), np.array(self.units)
        for unit in set(self.units):
            same = units == unit
            limits = self.speed[same & np.isfinite(self.speed)]
            scale[same & np.isinf(self.speed)] = limits.min(initial=np.inf)
        scale[np.isinf(scale)] = 1.0  # nothing to compare with
        return scale

    @property
    def inaccurate(self) -> int:
        """Ticks that were not optimal to the declared accuracy."""
        return sum(ticks for causes, ticks in self._spells() if Status.INACCURATE in causes)

    @property
    def given_up(self) -> int:
        """Ticks that gave something up or held still."""
        return sum(ticks for (c, *_), ticks in self._spells() if c.relaxed or not c.usable)

    def _spells(self) -> Iterator[tuple[tuple[Status, ...], int]]:
        """What was said, and for how many ticks on end; hashing all of it would take longer."""
        for causes, ticks in itertools.groupby(self.causes):
            yield causes, len(list(ticks))


def outside(record: Record) -> float:
    """How far the farthest joint is outside its limits at the end [rad, m]."""
    q = record.q[-1]
    return float(np.maximum(record.lower - q, q - record.upper).max())


def position_excess(record: Record) -> float:
    """Largest violation: what is inside stays inside, what is outside may only come nearer."""
    q = np.asfortranarray(record.q)  # along whose first axis numpy is faster
    lowest, highest = q.min(axis=0), q.max(axis=0)
    if (lowest >= record.lower).all() and (highest <= record.upper).all():
        return 0.0
    out = np.maximum(np.maximum(record.lower - record.q, record.q - record.upper), 0.0)
    nearest = np.minimum.accumulate(out, axis=0)
    return float((out[1:] - nearest[:-1]).max(initial=0.0))


def velocity_excess(record: Record) -> float:
    """Largest violation of a velocity limit [rad/s, m/s]."""
    return max(0.0, float((np.abs(record.v) - record.speed).max(initial=0.0)))


def slowest(record: Record) -> float:
    """Largest speed in the last ticks, as a share of the limit."""
    return float((np.abs(record.v[-LATEST:]) / record.scale).max(initial=0.0))


def at_rest(record: Record) -> bool:
    """Whether the joints were at rest in the last ticks."""
    return rests(record.v[-LATEST:])


def held_up(record: Record) -> bool:
    """Whether the loop budget has shortened every one of the last ticks."""
    last = record.causes[-LATEST:]
    return bool(last) and all(any(cause in SHORTENED for cause in causes) for causes in last)


def violations(
    record: Record, budget: Budget, excess: tuple[float, float] | None = None
) -> Iterator[str]:
    """Promises that no tick may break, in words; with the excesses, where they are known."""
    if not np.isfinite(record.v).all():
        yield "commanded NaN"
        return
    position, velocity = excess or (position_excess(record), velocity_excess(record))
    if position > EXCESS:
        yield f"left a position limit by {position:.2g} rad"
    if velocity > EXCESS:
        yield f"broke a velocity limit by {velocity:.2g} rad/s"
    if record.loop_position > budget.loop_position:
        yield f"opened a loop by {1e3 * record.loop_position:.4g} mm"
    if record.loop_orientation > budget.loop_orientation:
        yield f"opened a loop by {record.loop_orientation:.4g} rad"
