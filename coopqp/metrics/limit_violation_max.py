from coopqp.assessment.limits import beyond
from coopqp.metric import Metric, Trace, spec


@spec
class LimitViolationMax(Metric):
    """How far the worst joint went beyond its position limit."""

    unit = "rad or m"

    def measure(self, trace: Trace) -> float:
        return max(0.0, float(beyond(trace).max()))
