"""How a reference moves from its start to its goal: a share s(t) from 0 to 1 and its rate."""

from __future__ import annotations

import itertools
from dataclasses import field
from typing import Literal

from coopqp.base.spec import NonNegative, Positive, spec

#: Share of a trapezoid's duration spent speeding up, and again slowing down.
RAMP = 0.25
#: Share of an interval of a table by which times are rounded.
ROUNDING = 1e-6
#: The kinds, in the order in which the kernel numbers them.
KINDS = ("step", "constant_velocity", "trapezoid", "quintic")
FASTEST, TABLE = "fastest", "table"


@spec
class Profile:
    """A motion law for references.

    ``step`` jumps at once; ``constant_velocity`` starts and stops with a jerk; ``trapezoid`` has
    a quarter of its time to speed up and to slow down; ``quintic`` has no jump in acceleration;
    ``fastest`` takes the least time that limits on speeds and accelerations allow along the way of
    the first law, found when the scenario is read; ``table`` has shares of its own.
    """

    kind: Literal["step", "constant_velocity", "trapezoid", "quintic", "fastest", "table"] = (
        "quintic"
    )
    """step, constant_velocity, trapezoid, quintic, fastest or table."""
    duration: Positive = 1.0
    """Time from start to goal [s]; step and fastest ignore it."""
    delay: NonNegative = 0.0
    """Time before the motion begins [s]."""

    shares: list[float] = field(default_factory=list)
    """Of a table: shares of the way at equal times of the duration, from 0 to 1."""

    def __post_init__(self) -> None:
        rising = all(a <= b for a, b in itertools.pairwise(self.shares))
        ends = self.shares[:1] + self.shares[-1:]
        if (ends != [0.0, 1.0] * (self.kind == TABLE)) or not rising:
            words = "needs shares that rise from 0 to 1 where its kind is table, and only there"
            raise ValueError(words)

    @property
    def compiles(self) -> bool:
        """Whether the kernel has it."""
        return self.kind in KINDS

    @property
    def numbers(self) -> tuple[float, float, float]:
        """Kind, duration and delay, for the kernel."""
        return float(KINDS.index(self.kind)), self.duration, self.delay

    @property
    def end(self) -> float:
        """When the goal is reached [s]."""
        at_once = self.kind in ("step", FASTEST)
        return self.delay if at_once else self.delay + self.duration

    def at(self, t: float) -> tuple[float, float]:
        """Share of the way and its rate [1, 1/s] at time t [s]."""
        if t >= self.end:
            return 1.0, 0.0
        x = (t - self.delay) / self.duration
        if x < 0.0:
            return 0.0, 0.0
        if self.kind == "quintic":
            return (
                x * x * x * (10.0 + x * (6.0 * x - 15.0)),
                30.0 * x * x * (1.0 - x) * (1.0 - x) / self.duration,
            )
        if self.kind == "constant_velocity":
            return x, 1.0 / self.duration
        if self.kind == TABLE:
            count = len(self.shares) - 1
            k = min(int(x * count + ROUNDING), count - 1)
            way = self.shares[k + 1] - self.shares[k]
            return self.shares[k] + way * (x * count - k), way * count / self.duration
        return self._trapezoid(x)

    def _trapezoid(self, x: float) -> tuple[float, float]:
        top = 1.0 / (1.0 - RAMP)
        if x < RAMP:
            return 0.5 * top * x * x / RAMP, top * x / RAMP / self.duration
        if x <= 1.0 - RAMP:
            return top * (x - 0.5 * RAMP), top / self.duration
        left = 1.0 - x
        return 1.0 - 0.5 * top * left * left / RAMP, top * left / RAMP / self.duration
