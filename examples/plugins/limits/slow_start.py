"""Joints set out slowly: |v| <= v_max min(1, (t + dt) / duration)."""

from __future__ import annotations

import numpy as np

from coopqp import ClosedChain, Limit, LimitRows, State, Tighten, spec


@spec
class SlowStart(Limit):
    """Joints get their full speed little by little."""

    duration: float = 1.0
    """When they have all of it [s]."""

    def bind(self, chain: ClosedChain, dt: float) -> Tighten:
        """Bounds on v that widen with time."""
        full = chain.velocity  # [rad/s, m/s]

        def tighten(state: State, rows: LimitRows) -> None:
            most = full * min(1.0, (state.t + dt) / self.duration)
            np.maximum(rows.lb, -most, out=rows.lb)
            np.minimum(rows.ub, most, out=rows.ub)

        return tighten
