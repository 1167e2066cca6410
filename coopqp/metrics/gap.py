"""How far the hands end apart from what the model says: its calibration error."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from coopqp.checked import spec
from coopqp.metric import Metric
from coopqp.trace import Trace


@spec
class Gap(Metric):
    """How far the hands end apart from what the model says: its calibration error."""

    unit: ClassVar[str] = "m, rad"

    def measure(self, trace: Trace) -> dict[str, float]:
        """The largest of the loops in the last tick, as the controller observed it."""
        last = trace.gap[-1] if trace.ticks else np.zeros(0)
        sizes = np.linalg.norm(last.reshape(-1, 2, 3), axis=2)
        position, orientation = sizes.max(axis=0, initial=0.0).tolist()
        return {"position": position, "orientation": orientation}
