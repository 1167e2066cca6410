"""Joints change their speed by at most a dt a tick, and can always stop before their bound.

A joint that brakes with a from v comes to rest after v^2/(2 a) + v dt/2, since v is held for a tick
before it falls. With a margin to the bound,

    v <= -a dt/2 + sqrt((a dt/2)^2 + 2 a margin)

That is exact where v is a multiple of a dt. In between the last tick falls short of a full a dt, so
the law uses the chords of this curve between the multiples, with M - 1 full ticks of braking:

    v <= a dt/2 (s/M + M - 1),   s = 2 margin/(a dt^2),   M = max(1, round(sqrt(s + 1/4)))

A joint on its chord brakes with exactly a until it rests at the bound. Loops can ask several joints
at once for more; then this limit is relaxed.
"""

from typing import ClassVar

import numpy as np
from pydantic import Field

from coopqp.base.errors import require_known
from coopqp.base.qp import Row
from coopqp.base.spec import Array, NonNegative, Positive, spec
from coopqp.limit import Bounded, JointBounds, Limit, LimitRows, Tighten, joint_margins
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.state import State

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
        lower, upper = np.clip(self._ends(chain), -UNLIMITED, UNLIMITED)

        def tighten(state: State, rows: LimitRows) -> None:
            low = -_fastest(state.q - lower, step, dt)
            high = _fastest(upper - state.q, step, dt)
            window = state.v + np.vstack([-step, step])
            # Braking comes before the acceleration limit, the other limits come before both.
            window = np.minimum(np.maximum(window, low), high)
            rows.lb[:], rows.ub[:] = np.minimum(np.maximum(window, rows.lb), rows.ub)

        return tighten

    def program(self, chain: ClosedChain, dt: float) -> JointBounds:
        lower, upper = np.clip(self._ends(chain), -UNLIMITED, UNLIMITED)
        step = self._limits(chain) * dt
        return JointBounds(of=Bounded.BRAKING, lower=lower, upper=upper, step=step)

    def margins(self, chain: ClosedChain, q: Array, v: Array, dt: float) -> dict[Row, Array]:
        """Acceleration left, from rest at first, and margin left after braking to rest."""
        a = self._limits(chain)
        change = np.diff(v, axis=0, prepend=np.zeros((1, chain.n))) / dt
        lower, upper = self._ends(chain)
        forth, back = _braking_distance(v, a, dt), _braking_distance(-v, a, dt)
        return {
            **joint_margins("acceleration", chain, a + change, a - change, per="/s2"),
            **joint_margins("braking", chain, q[:-1] - lower - back, upper - q[:-1] - forth),
        }

    def _limits(self, chain: ClosedChain) -> Array:
        names, where = chain.joint_names, "joint_acceleration.joints: "
        require_known("joint", self.joints, names, where, ("joints",))
        return np.array([self.joints.get(name, self.max) for name in names])

    def _ends(self, chain: ClosedChain) -> Array:
        return np.vstack([chain.lower + self.margin, chain.upper - self.margin])


def _fastest(margin: Array, step: Array, dt: float) -> Array:
    """Speed with a margin to the bound; a joint outside its range may not go further out."""
    s = np.maximum(margin * (2.0 / (step * dt)), 0.0)
    M = np.maximum(np.rint(np.sqrt(s + 0.25)), 1.0)
    return np.asarray((s / M + M - 1.0) * (0.5 * step))


def _braking_distance(v: Array, a: Array, dt: float) -> Array:
    """Way from v to rest in steps of dt, each at most a dt slower; 0 for v < 0."""
    step = a * dt
    full = np.floor(np.maximum(v, 0.0) / step)
    rest = np.maximum(v, 0.0) - full * step
    return np.asarray(dt * ((full + 1.0) * rest + 0.5 * full * (full + 1.0) * step), float)
