import numpy as np

from coopqp.metric import Metric, Trace, spec


@spec
class VelocityViolationMax(Metric):
    """How far the worst joint's speed went beyond its limit."""

    unit = "rad/s or m/s"

    def measure(self, trace: Trace) -> float:
        return max(0.0, float((np.abs(trace.v) - trace.velocity).max(initial=0.0)))
