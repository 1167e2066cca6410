"""A way through given values at given times, from the scenario or from a file.

Before the first time it is at the first value. Directions go from one to the next on the shortest
way. Between values at x_i, with s the share of the segment,

    linear         x_i + s (x_i+1 - x_i),  R: exp(s phi_i) R_i
    minimum_jerk   the same with 10 s^3 - 15 s^4 + 6 s^5: at rest at each way-point
    cubic          the cubic spline, at rest at both ends or going round; for rotations the spline
                   of the quaternions, normalised
"""

from __future__ import annotations

from bisect import bisect_right
from functools import cached_property
from typing import Annotated, Any, Literal

import numpy as np
import pinocchio as pin
from pydantic import BeforeValidator, Field

from coopqp.base.errors import InvalidValueError
from coopqp.base.reading import FilePath
from coopqp.base.spec import Array, Pose, spec
from coopqp.base.table import read_table
from coopqp.grasp import pose_matrix
from coopqp.signal import (
    Instant,
    Kind,
    Signal,
    Trajectory,
    axes_along,
    check_places,
    check_speed,
    matrix,
    quaternion_of,
    shortest_way,
)

#: How far apart first and last value may be where they have to be the same [unit].
SAME = 1e-6
#: Directions that add up to less are opposite, and have no shortest way between them.
OPPOSITE = 1e-9


def _rows(values: Any) -> Any:
    """Numbers where lists of numbers belong get one message, and not two each."""
    if isinstance(values, list | tuple) and any(isinstance(x, int | float) for x in values):
        raise ValueError("needs a list of numbers, or a pose, for each time")
    return values


Between = Literal["linear", "minimum_jerk", "cubic"]

Values = Annotated[list[list[float] | Pose], Field(min_length=2), BeforeValidator(_rows)]


@spec
class Waypoints(Signal):
    """A way through given values at given times, once, there and back, or round and round."""

    times: Annotated[list[float], Field(min_length=2)] | None = None
    """When it is at each value, rising [s]."""
    values: Values | None = None
    """One for each time: as many numbers as are needed, a rotation as the quaternion x, y, z, w,
    a pose as position and quaternion or as {position, rpy_deg}."""
    file: FilePath | None = None
    """Instead of both: a CSV or Parquet file with columns t and x, y, z, or x, y, z, qx, qy, qz,
    qw, or names of joints."""
    column: str = ""
    """Of a file for a single number, such as a force; its name is ``value`` if omitted."""
    between: Between = "cubic"
    """linear; minimum_jerk, at rest at each; or cubic, smoothly through them."""
    repeat: Literal["once", "back_and_forth", "round"] = "once"
    """What comes after the last: nothing, the same way back, or the first again."""
    clock: str = ""
    """Name of a clock that waits where joints are far behind their way, for all ways that name it;
    without one the time goes on."""

    def __post_init__(self) -> None:
        inside = self.times is not None and self.values is not None
        if self.column and self.file is None:
            raise ValueError("column: is one of a file; give file")
        if inside == (self.file is not None) or (self.times is None) != (self.values is None):
            raise ValueError("give times and values, or file, and not both")
        if self.times is None or self.values is None:
            return
        if len(self.times) != len(self.values):
            raise ValueError(f"found {len(self.times)} times and {len(self.values)} values")
        for before, t in zip(self.times, self.times[1:], strict=False):
            if t <= before:
                raise ValueError(f"times: found {t:g} s after {before:g} s; they need to rise")

    def bind(self, kind: Kind, start: Instant, here: Array | None) -> Trajectory:
        if kind not in self._tracks:
            t, values = self._table(kind)
            if self.repeat == "round" and not _same(kind, values):
                words = "repeat: round needs the last value to be the first"
                raise InvalidValueError(f"waypoints: {words}")
            self._tracks[kind] = _Track(kind, t, values, self)
        way = _Way(kind, self._tracks[kind])
        if self.clock:
            start.inputs.ways[self.clock, kind.columns if kind.each else ()] = way
        return way

    @cached_property
    def _tracks(self) -> dict[Kind, _Track]:
        """As bound before, by kind: pages bind a reference at each instant that they show."""
        return {}

    @property
    def rest(self) -> float:
        """The last time; never where it repeats."""
        return float(self._times[-1] if self.repeat == "once" else np.inf)

    @property
    def _times(self) -> Array:
        return read_table(self.file).times() if self.file else np.array(self.times, float)

    def _table(self, kind: Kind) -> tuple[Array, Array]:
        """Times and values as they are kept, shapes (m,) and (m, values)."""
        if self.file is not None:
            table = read_table(self.file)
            columns = (self.column,) if self.column else kind.columns
            rows, places = list(table.take(columns)), table.place
        else:
            rows, places = list(self.values or ()), "waypoints.values[{}]".format
        t = self._times
        if len(t) < 2:
            raise InvalidValueError(f"{self.file}: needs at least 2 rows, found {len(t)}")
        values = []
        for i, row in enumerate(rows):
            try:
                values.append(_value(kind, row))
            except InvalidValueError as error:
                raise InvalidValueError(f"{places(i)}: {error}") from None
        found = np.array(values)
        for i, row in enumerate(found):
            check_places(places(i), row[: kind.numbers])
        ways = np.abs(np.diff(found, axis=0)).max(axis=1, initial=0.0) / np.diff(t)
        if not self.column and kind.columns != ("value",):  # forces may step
            check_speed(places(int(ways.argmax()) + 1), float(ways.max()))
        if kind.axis:
            _carry_over(found, round_trip=self.repeat == "round")
        return t, found


def _value(kind: Kind, row: object) -> Array:
    if not isinstance(row, Pose):
        return kind.read(row)
    if not kind.turns or kind.axis:
        raise InvalidValueError(f"found a pose, needs {kind.values} numbers")
    return kind.read(row if kind.numbers else pose_matrix(row).rotation)


def _same(kind: Kind, values: Array) -> bool:
    first, last = values[0], values[-1]
    k = kind.numbers
    near = np.abs(last[:k] - first[:k]).max(initial=0.0) < SAME
    return bool(near and (not kind.turns or abs(first[k:] @ last[k:]) > 1.0 - SAME))


def _carry_over(quaternions: Array, *, round_trip: bool) -> None:
    """Turn each direction's axes on the shortest way; a round trip shares out what is left."""
    axes = [axes_along(matrix(quaternions[0])[:, 2]).T]
    for i, q in enumerate(quaternions[1:], start=1):
        before, there = axes[-1], matrix(q)[:, 2]
        if np.linalg.norm(before[:, 2] + there) < OPPOSITE:
            words = "is the opposite of the direction before; put one between them"
            raise InvalidValueError(f"waypoints.values[{i}]: {words}")
        axes.append(pin.exp3(shortest_way(before[:, 2], there)) @ before)
    spin = 0.0
    if round_trip and np.linalg.norm(axes[0][:, 2] - axes[-1][:, 2]) < SAME:
        back = axes[0].T @ axes[-1]
        spin = float(np.arctan2(back[1, 0], back[0, 0])) / (len(axes) - 1)
    for i, (q, R) in enumerate(zip(quaternions, axes, strict=True)):
        q[:] = quaternion_of(R @ pin.exp3(np.array([0.0, 0.0, -i * spin])))


class _Track:
    """Way-points with what is between them; it does not change."""

    def __init__(self, kind: Kind, t: Array, values: Array, waypoints: Waypoints) -> None:
        k, between = kind.numbers, waypoints.between
        self.first, self.clock, self.begin = values[0].copy(), waypoints.clock, t[0]
        self._repeat, self._length = waypoints.repeat, float(t[-1] - t[0])
        round_trip = self._repeat == "round"
        if kind.turns:
            values[:, k:] = same_side(values[:, k:])
        if kind.turns and round_trip and values[0, k:] @ values[-1, k:] < 0.0:
            # Once round is half of the quaternion's own way.
            t = np.concatenate([t, t[1:] + self._length])
            values = np.concatenate([values, values[1:] * ([1.0] * k + [-1.0] * 4)])
            self._length *= 2.0
        if round_trip:
            values[-1] = values[0]  # but for rounding
        self.pieces = pieces(t, values[:, :k], between, round_trip=round_trip) if k else None
        self.turns = Turns(t, values[:, k:], between, round_trip=round_trip) if kind.turns else None

    def gone(self, t: float) -> tuple[float, float]:
        """Time along the way, and its rate: 1, 0 at rest, -1 on the way back."""
        length = self._length
        if t <= 0.0:
            return 0.0, 0.0
        if self._repeat == "once":
            return (t, 1.0) if t < length else (length, 0.0)
        if self._repeat == "round":
            return t % length, 1.0
        back, gone = divmod(t, length)
        return (length - gone, -1.0) if back % 2.0 else (gone, 1.0)


class _Way(Trajectory):
    moves = True

    def __init__(self, kind: Kind, track: _Track) -> None:
        super().__init__(kind, track.first)
        self._track, k = track, kind.numbers
        self._parts = self.value[:k], self.value[k:], self.rate[:k], self.rate[k:]

    def update(self, at: Instant) -> None:
        track = self._track
        clock = at.inputs.get(track.clock)
        t, pace = (at.t, 1.0) if clock is None else (float(clock.value[0]), float(clock.rate[0]))
        gone, direction = track.gone(t - track.begin)
        numbers, quaternion, rate, omega = self._parts
        if track.pieces is not None:
            track.pieces.at(track.begin + gone, numbers, rate)
        if track.turns is not None:
            track.turns.at(track.begin + gone, quaternion, omega)
        np.multiply(self.rate, direction * pace, self.rate)


class Pieces:
    """A polynomial in each segment between times, coefficients (powers, s, k), highest first."""

    def __init__(self, t: Array, coefficients: Array) -> None:
        self._t, self._c = t.tolist(), np.ascontiguousarray(coefficients.swapaxes(0, 1))
        self._exponents = np.arange(len(coefficients) - 1.0, -1.0, -1.0)
        self._c_dot = self._c[:, :-1] * self._exponents[:-1, None]

    def at(self, t: float, value: Array, rate: Array) -> None:
        """Write value and rate at a time within the segments, shapes (k,)."""
        i = min(max(bisect_right(self._t, t) - 1, 0), len(self._c) - 1)
        powers = (t - self._t[i]) ** self._exponents
        powers.dot(self._c[i], value)
        powers[1:].dot(self._c_dot[i], rate)


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
        if between == "cubic":
            self._spline = pieces(t, quaternions, between, round_trip=round_trip)
            return
        self._t, self._R = t.tolist(), [matrix(q) for q in quaternions]
        self._phi = [pin.log3(b @ a.T) for a, b in zip(self._R, self._R[1:], strict=False)]
        shares = np.arange(len(t), dtype=float)[:, None]
        self._share = pieces(t, shares, between, round_trip=False)

    def at(self, t: float, value: Array, rate: Array) -> None:
        """Write quaternion and angular velocity, shapes (4,) and (3,) [rad/s]."""
        if self._spline is not None:
            q, q_dot = np.empty(4), np.empty(4)
            self._spline.at(t, q, q_dot)
            _normalised(q, q_dot, value, rate)
            return
        i = min(max(bisect_right(self._t, t) - 1, 0), len(self._phi) - 1)
        share, share_dot = np.empty(1), np.empty(1)
        self._share.at(t, share, share_dot)
        value[:] = quaternion_of(pin.exp3(self._phi[i] * (share[0] - i)).dot(self._R[i]))
        np.multiply(self._phi[i], share_dot[0], rate)


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
    return quaternions * signs[:, None]
