"""A point goes round on a figure of eight that stands upright, across x."""

from __future__ import annotations

import math

from coopqp import Array, Instant, Kind, Signal, Trajectory, spec
from coopqp.base.errors import InvalidValueError
from coopqp.base.spec import Positive, Vector3


@spec
class FigureEight(Signal):
    """A point goes round on an upright figure of eight."""

    center: Vector3
    """Where the ways cross [m]."""
    size: Positive
    """From the center to where it is widest [m]."""
    period: Positive
    """Time of one round [s]."""

    def bind(self, kind: Kind, start: Instant, here: Array | None) -> Trajectory:
        """Any three numbers."""
        if kind.values != 3:
            raise InvalidValueError(f"figure_eight: is 3 numbers, but a {kind.name} is needed here")
        return _Eight(kind, self)


class _Eight(Trajectory):
    """Going round."""

    moves = True

    def __init__(self, kind: Kind, eight: FigureEight) -> None:
        super().__init__(kind, eight.center)
        self._eight = eight

    def update(self, at: Instant) -> None:
        """Go to where it is then: value [m] and rate [m/s]."""
        eight, omega = self._eight, 2.0 * math.pi / self._eight.period
        angle, (x, y, z) = omega * at.t, eight.center
        self.value[:] = x, y + eight.size * math.sin(angle), z + eight.size * math.sin(2 * angle)
        self.rate[1] = eight.size * omega * math.cos(angle)
        self.rate[2] = 2.0 * eight.size * omega * math.cos(2.0 * angle)
