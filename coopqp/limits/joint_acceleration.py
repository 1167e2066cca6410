"""Joints change their speed by at most a dt a tick, and can always stop before their bound.

A joint that brakes with a from v comes to rest after v^2/(2 a) + v dt/2, since v is held for a
tick before it falls. With room to the bound,

    v <= -a dt/2 + sqrt((a dt/2)^2 + 2 a room)

That is exact where v is a multiple of a dt. In between the last tick falls short of a full a dt,
so the law uses the chords of this curve between the multiples, with M - 1 full ticks of braking:

    v <= a dt/2 (s/M + M - 1),   s = 2 room/(a dt^2),   M = max(1, round(sqrt(s + 1/4)))

A joint on its chord brakes with exactly a until it rests at the bound. The joint alone could
always do that; loops can ask several joints at once for more, and then this limit is given up.
"""

from __future__ import annotations

from typing import ClassVar

import numpy as np
from pydantic import Field

from coopqp.checked import Array, NonNegative, Positive, spec
from coopqp.closed_chain import ClosedChain
from coopqp.errors import UnknownNameError
from coopqp.limit import Bounded, JointBounds, Limit, LimitRows, Tighten, joint_margins
from coopqp.row import Row
from coopqp.state import State

#: Room of a joint without bounds [rad or m]; infinity would end in inf - inf.
UNLIMITED = 1e9


@spec
class JointAcceleration(Limit):
    """Joint acceleration limits, and braking before the position limits."""

    sacrificed_first: ClassVar[bool] = True

    max: Positive
    """Of every joint, passive ones included [rad/s2, m/s2]."""
    joints: dict[str, Positive] = Field(default_factory=dict)
    """Of joints that have one of their own, by name [rad/s2, m/s2]."""
    margin: NonNegative = 0.0
    """Kept free at both position limits [rad or m]; joint_position's, if it has one."""

    def bind(self, chain: ClosedChain, dt: float) -> Tighten:
        """A window around the last velocity, state.v, cut to what can still be braked."""
        step = self._limits(chain) * dt
        ends = np.clip(self._ends(chain), -UNLIMITED, UNLIMITED)
        below, above = ends
        per_room, half_step = np.tile(2.0 / (step * dt), (2, 1)), np.tile(0.5 * step, (2, 1))
        window, room, ticks = np.zeros_like(ends), np.zeros_like(ends), np.zeros_like(ends)
        way = np.vstack([-step, step])
        low, high = room
        lb, ub = window

        def tighten(state: State, rows: LimitRows) -> None:
            np.subtract(state.q, below, low)
            np.subtract(above, state.q, high)
            np.multiply(room, per_room, room)
            _fastest(room, ticks)
            np.multiply(room, half_step, room)
            np.negative(low, low)
            np.add(state.v, way, window)
            # Braking comes before the acceleration limit, the other limits come before both.
            np.minimum(np.maximum(window, low, out=window), high, out=window)
            np.minimum(np.maximum(window, rows.lb, out=window), rows.ub, out=window)
            rows.lb[:], rows.ub[:] = lb, ub

        return tighten

    def program(self, chain: ClosedChain, dt: float) -> JointBounds:
        """The same window."""
        lower, upper = np.clip(self._ends(chain), -UNLIMITED, UNLIMITED)
        step = self._limits(chain) * dt
        return JointBounds(of=Bounded.BRAKING, lower=lower, upper=upper, step=step)

    def margins(self, chain: ClosedChain, q: Array, v: Array, dt: float) -> dict[Row, Array]:
        """Acceleration left, from rest at first, and room left after braking to rest."""
        a = self._limits(chain)
        change = np.diff(v, axis=0, prepend=np.zeros((1, chain.n))) / dt
        lower, upper = self._ends(chain)
        forth, back = _braking_distance(v, a, dt), _braking_distance(-v, a, dt)
        return {
            **joint_margins("acceleration", chain, a + change, a - change, per="/s2"),
            **joint_margins("braking", chain, q[:-1] - lower - back, upper - q[:-1] - forth),
        }

    def _limits(self, chain: ClosedChain) -> Array:
        for name in self.joints:
            if name not in chain.joint_names:
                where = "joint_acceleration.joints: "
                unknown = UnknownNameError("joint", name, chain.joint_names, where)
                raise unknown.at("joints", name)
        return np.array([self.joints.get(name, self.max) for name in chain.joint_names])

    def _ends(self, chain: ClosedChain) -> Array:
        return np.vstack([chain.lower + self.margin, chain.upper - self.margin])


def _fastest(s: Array, ticks: Array) -> None:
    """Replace s by s/M + M - 1, in place; a joint outside its range may not go further out."""
    np.maximum(s, 0.0, out=s)
    np.add(s, 0.25, ticks)
    np.rint(np.sqrt(ticks, ticks), ticks)
    np.maximum(ticks, 1.0, out=ticks)
    np.divide(s, ticks, s)
    np.add(s, ticks, s)
    np.subtract(s, 1.0, s)


def _braking_distance(v: Array, a: Array, dt: float) -> Array:
    """Way from v to rest in steps of dt, each at most a dt slower; 0 for v < 0."""
    step = a * dt
    full = np.floor(np.maximum(v, 0.0) / step)
    rest = np.maximum(v, 0.0) - full * step
    return np.asarray(dt * ((full + 1.0) * rest + 0.5 * full * (full + 1.0) * step), float)
