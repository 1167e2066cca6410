"""A point goes round on a circle, in closed form.

With c the center, u the unit vector to where it begins, w = n x u and a the angle gone,

    x = c + r (cos a u + sin a w),   x_dot = r a_dot (-sin a u + cos a w)

The angle's speed grows from zero to 2 pi / period within the ramp, as 3 x^2 - 2 x^3 of its share x.
"""

import math

import numpy as np

from coopqp.base.errors import InvalidValueError
from coopqp.base.spec import Array, Direction, NonNegative, Positive, Vector3, spec
from coopqp.signal import Instant, Kind, Signal, Trajectory, axes_along, check_places, check_speed


@spec
class Circle(Signal):
    """A point goes round on a circle, for places, velocities and other triples of numbers."""

    center: Vector3
    """[m]"""
    radius: Positive
    """[m]"""
    normal: Direction = (0.0, 0.0, 1.0)
    """About which it goes round, counter-clockwise seen from its tip; any length."""
    period: Positive
    """Time of one round [s]."""
    begin: Direction | None = None
    """From the center to where it begins; the world's x axis, or y where that is normal to it."""
    ramp: NonNegative = 1.0
    """Time in which it comes up to speed [s]."""

    def __post_init__(self) -> None:
        if self.begin is not None and np.linalg.norm(np.cross(self.begin, self.normal)) < 1e-9:
            raise ValueError("begin is along the normal; needs a direction within the plane")

    def bind(self, kind: Kind, start: Instant, here: Array | None) -> Trajectory:
        if kind.values != 3:
            raise InvalidValueError(
                f"circle: is 3 numbers, but a {kind.name} is needed here; use waypoints or input"
            )
        check_places("circle", np.append(self.center, self.radius))
        check_speed("circle.period", 2.0 * math.pi * self.radius / self.period)
        return _Round(kind, self)


class _Round(Trajectory):
    moves = True

    def __init__(self, kind: Kind, circle: Circle) -> None:
        self._center = np.array(circle.center)
        u, _, n = axes_along(circle.normal)
        if circle.begin is not None:
            u = np.array(circle.begin) - (n @ np.array(circle.begin)) * n
            u /= np.linalg.norm(u)
        self._axes = circle.radius * np.array([u, np.cross(n, u)])
        self._speed, self._ramp = 2.0 * math.pi / circle.period, circle.ramp
        super().__init__(kind, self._center + self._axes[0])

    def update(self, at: Instant) -> None:
        angle, speed = self._angle(at.t)
        c, s = math.cos(angle), math.sin(angle)
        np.add(np.array([c, s]).dot(self._axes), self._center, self.value)
        np.array([-s * speed, c * speed]).dot(self._axes, self.rate)

    def _angle(self, t: float) -> tuple[float, float]:
        """Gone so far, and its rate [rad, rad/s]."""
        if t <= 0.0:
            return 0.0, 0.0
        if t >= self._ramp:
            return self._speed * (t - 0.5 * self._ramp), self._speed
        x = t / self._ramp
        return (
            self._speed * self._ramp * x * x * x * (1.0 - 0.5 * x),
            self._speed * x * x * (3.0 - 2.0 * x),
        )
