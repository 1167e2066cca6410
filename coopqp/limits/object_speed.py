"""The object keeps its speed: every component of its velocity within a bound, in world axes.

J_task v <= bound and -J_task v <= bound. The object's velocity is that of its origin.
"""

import numpy as np

from coopqp.base.qp import Row, Side
from coopqp.base.spec import Array, Positive, spec
from coopqp.limit import Limit, LimitRows, Tighten, TwistBounds, states_along
from coopqp.model.closed_chain import AXES, AXIS_UNITS, ClosedChain
from coopqp.model.state import State


@spec
class ObjectSpeed(Limit):
    """Bounds on the object's linear and angular velocity, axis by axis."""

    linear: Positive | None = None
    """Of the object's origin along x, y and z [m/s]; none if omitted."""
    angular: Positive | None = None
    """About x, y and z [rad/s]; none if omitted."""

    def __post_init__(self) -> None:
        if self.linear is None and self.angular is None:
            raise ValueError("needs linear (m/s), angular (rad/s) or both")

    def rows(self, chain: ClosedChain) -> tuple[Row, ...]:
        axes = list(zip(AXES, AXIS_UNITS, strict=True))[self._part]
        sides: tuple[Side, ...] = ("upper", "lower")
        return tuple(
            Row(
                name=f"limit.object_speed.{axis}.{side}",
                kind="limit",
                owner="object_speed",
                unit=f"{unit}/s",
                label=f"object speed along {axis} ({side})",
                side=side,
            )
            for side in sides
            for axis, unit in axes
        )

    def bind(self, chain: ClosedChain, dt: float) -> Tighten:
        part, bounds = self._part, np.tile(self._bounds, 2)
        k = len(self._bounds)

        def tighten(state: State, rows: LimitRows) -> None:
            J = state.J_task[part]
            rows.G[:k] = J
            np.negative(J, rows.G[k:])
            rows.h[:] = bounds

        return tighten

    def program(self, chain: ClosedChain, dt: float) -> TwistBounds:
        return TwistBounds(components=range(6)[self._part], bounds=self._bounds.tolist())

    def margins(self, chain: ClosedChain, q: Array, v: Array, dt: float) -> dict[Row, Array]:
        """Speed left in each tick, with the Jacobian at its beginning."""
        states = zip(states_along(chain, q[:-1]), v, strict=True)
        speed = np.array([state.J_task[self._part] @ v_k for state, v_k in states])
        left = np.hstack([self._bounds - speed, self._bounds + speed])
        return {row: left[:, i] for i, row in enumerate(self.rows(chain))}

    @property
    def _part(self) -> slice:
        return slice(0 if self.linear else 3, 6 if self.angular else 3)

    @property
    def _bounds(self) -> Array:
        return np.array([bound for bound in (self.linear, self.angular) if bound]).repeat(3)
