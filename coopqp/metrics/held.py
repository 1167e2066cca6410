"""Whether hands that press held the object to the end."""

from __future__ import annotations

import numpy as np

from coopqp.checked import spec
from coopqp.metric import Metric
from coopqp.trace import Trace


@spec
class Held(Metric):
    """Whether hands that press held the object to the end, and when they lost it."""

    def measure(self, trace: Trace) -> dict[str, float | bool | None] | None:
        """None where no hand presses; a held object need not be where it should be."""
        held = trace.signals.get("held")
        if held is None or not trace.ticks:
            return None
        kept = bool(held[:, 0].all())
        lost = None if kept else float(trace.t[1 + int(np.argmin(held[:, 0]))])
        return {"held": kept, "lost_at": lost}
