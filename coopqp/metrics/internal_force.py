"""How hard the hands squeeze the object, where the plant tells it."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from coopqp.checked import spec
from coopqp.metric import Metric
from coopqp.trace import Trace

#: What counts as the end of a run [s].
END = 0.5


@spec
class InternalForce(Metric):
    """How hard the hands squeeze the object, where the plant tells it."""

    unit: ClassVar[str] = "N"

    def measure(self, trace: Trace) -> dict[str, float] | None:
        """The largest force of a hand that others cancel: at worst, and in the mean at the end."""
        signal = trace.signals.get("internal_wrench")
        if signal is None or not trace.ticks:
            return None
        force = signal.reshape(trace.ticks, -1, 6)[:, :, :3]
        largest = np.linalg.norm(force, axis=2).max(axis=1)
        last = largest[-max(1, round(END / trace.dt)) :]
        return {"worst": float(largest.max()), "end": float(last.mean())}
