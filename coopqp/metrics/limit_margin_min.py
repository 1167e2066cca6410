"""Least distance of a joint to its position limit; negative beyond it."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from coopqp.checked import spec
from coopqp.metric import Metric
from coopqp.trace import Trace


@spec
class LimitMarginMin(Metric):
    """Least distance of a joint to its position limit; negative beyond it."""

    unit: ClassVar[str] = "rad or m"

    def measure(self, trace: Trace) -> float:
        """Over the whole run."""
        return float(np.minimum(trace.q - trace.lower, trace.upper - trace.q).min())
