"""How long the object's way was."""

from __future__ import annotations

import numpy as np

from coopqp import Metric, Trace, spec


@spec
class PathLength(Metric):
    """Length of the path of the object's origin."""

    unit = "m"

    def measure(self, trace: Trace) -> float:
        """Sum of the distances between the instants."""
        return float(np.linalg.norm(np.diff(trace.position, axis=0), axis=1).sum())
