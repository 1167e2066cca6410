"""There and back between two places, in closed form: x = a + (b - a) (1 - cos(2 pi t / T)) / 2."""

import math
from typing import Annotated

import numpy as np
from pydantic import Field

from coopqp.base.errors import InvalidValueError
from coopqp.base.spec import Array, Positive, spec
from coopqp.signal import Instant, Kind, Signal, Trajectory, check_places, check_speed


@spec
class Line(Signal):
    """There and back on a straight line, at rest at both ends, for anything without a rotation."""

    start: Annotated[list[float], Field(min_length=1)]
    """Where it begins, as many numbers as are needed [m; rad, m for joints; m/s, rad/s]."""
    end: Annotated[list[float], Field(min_length=1)]
    """Where it turns round."""
    period: Positive
    """Time there and back [s]."""

    def __post_init__(self) -> None:
        if len(self.start) != len(self.end):
            raise ValueError(f"start has {len(self.start)} numbers, end {len(self.end)}")

    def bind(self, kind: Kind, start: Instant, here: Array | None) -> Trajectory:
        if kind.turns:
            words = f"line: does not turn, but a {kind.name} is needed here; use waypoints or input"
            raise InvalidValueError(words)
        check_places("line", np.array([*self.start, *self.end]))
        fastest = max(abs(b - a) for a, b in zip(self.start, self.end, strict=True))
        check_speed("line.period", math.pi * fastest / self.period)
        try:
            return _ThereAndBack(kind, kind.read(self.start), kind.read(self.end), self.period)
        except InvalidValueError as error:
            raise InvalidValueError(f"line.start: {error}") from None


class _ThereAndBack(Trajectory):
    moves = True

    def __init__(self, kind: Kind, start: Array, end: Array, period: float) -> None:
        super().__init__(kind, start)
        self._start, self._way, self._omega = start, end - start, 2.0 * math.pi / period

    def update(self, at: Instant) -> None:
        angle = self._omega * max(at.t, 0.0)
        np.multiply(self._way, 0.5 - 0.5 * math.cos(angle), self.value)
        np.add(self.value, self._start, self.value)
        np.multiply(self._way, 0.5 * self._omega * math.sin(angle), self.rate)
