"""What lies between way-points: polynomials for numbers, ways on the sphere for rotations.

linear         x_i + s (x_i+1 - x_i),  R: exp(s phi_i) R_i        s the share of the segment
minimum_jerk   the same with 10 s^3 - 15 s^4 + 6 s^5: at rest at each way-point
cubic          the cubic spline, at rest at both ends or going round; for rotations the spline
of the quaternions, normalised
"""

from __future__ import annotations

from bisect import bisect_right
from typing import Literal

import numpy as np
import pinocchio as pin

from coopqp.base.spec import Array
from coopqp.signal import matrix, quaternion_of

Between = Literal["linear", "minimum_jerk", "cubic"]


class Pieces:
    """A polynomial in each segment between times, coefficients (powers, s, k), highest first."""

    def __init__(self, t: Array, coefficients: Array) -> None:
        self._t, self._c = t.tolist(), np.ascontiguousarray(coefficients.swapaxes(0, 1))

    def at(self, t: float, value: Array, rate: Array) -> None:
        """Write value and rate at a time within the segments, shapes (k,)."""
        i = min(max(bisect_right(self._t, t) - 1, 0), len(self._c) - 1)
        x = t - self._t[i]
        value[:] = 0.0
        rate[:] = 0.0
        for c in self._c[i]:
            np.multiply(rate, x, rate)
            np.add(rate, value, rate)
            np.multiply(value, x, value)
            np.add(value, c, value)


def pieces(t: Array, values: Array, between: Between, *, round_trip: bool) -> Pieces:
    """Polynomials through values, shape (m, k), at rising times; round trips end as they begin."""
    if between == "cubic":
        from scipy.interpolate import CubicSpline  # nobody else waits for it

        ends = "periodic" if round_trip else "clamped"
        return Pieces(t, CubicSpline(t, values, bc_type=ends).c)
    h, way = np.diff(t)[:, None], np.diff(values, axis=0)
    if between == "linear":
        return Pieces(t, np.array([way / h, values[:-1]]))
    nothing = np.zeros_like(way)
    powers = [6.0 * way / h**5, -15.0 * way / h**4, 10.0 * way / h**3, nothing, nothing]
    return Pieces(t, np.array([*powers, values[:-1]]))


class Turns:
    """A way through quaternions x, y, z, w, neighbours on the same side, at rising times."""

    def __init__(self, t: Array, quaternions: Array, between: Between, *, round_trip: bool) -> None:
        self._spline: Pieces | None = None
        self._q, self._q_dot = np.zeros(4), np.zeros(4)
        if between == "cubic":
            self._spline = pieces(t, quaternions, between, round_trip=round_trip)
            return
        self._t, self._R = t.tolist(), [matrix(q) for q in quaternions]
        self._phi = [pin.log3(b @ a.T) for a, b in zip(self._R, self._R[1:], strict=False)]
        shares = np.arange(len(t), dtype=float)[:, None]
        self._share = pieces(t, shares, between, round_trip=False)
        self._s, self._s_dot = np.zeros(1), np.zeros(1)

    def at(self, t: float, value: Array, rate: Array) -> None:
        """Write quaternion and angular velocity, shapes (4,) and (3,) [rad/s]."""
        if self._spline is not None:
            self._spline.at(t, self._q, self._q_dot)
            _normalised(self._q, self._q_dot, value, rate)
            return
        i = min(max(bisect_right(self._t, t) - 1, 0), len(self._phi) - 1)
        self._share.at(t, self._s, self._s_dot)
        value[:] = quaternion_of(pin.exp3(self._phi[i] * (self._s[0] - i)).dot(self._R[i]))
        np.multiply(self._phi[i], self._s_dot[0], rate)


def _normalised(q: Array, q_dot: Array, value: Array, rate: Array) -> None:
    """The rotation along q / |q|: omega = 2 vec(q_dot q*) / |q|^2."""
    x, y, z, w = q.tolist()
    a, b, c, d = q_dot.tolist()
    square = x * x + y * y + z * z + w * w
    np.multiply(q, square**-0.5, value)
    twice = 2.0 / square
    rate[0] = twice * (a * w - d * x - b * z + c * y)
    rate[1] = twice * (b * w - d * y - c * x + a * z)
    rate[2] = twice * (c * w - d * z - a * y + b * x)


def same_side(quaternions: Array) -> Array:
    """Signs so that each quaternion is on the side of the one before, shape (m, 4)."""
    turned = np.sum(quaternions[1:] * quaternions[:-1], axis=1) < 0.0
    signs = np.cumprod(np.concatenate([[1.0], np.where(turned, -1.0, 1.0)]))
    found: Array = quaternions * signs[:, None]
    return found
