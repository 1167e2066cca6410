from coopqp.assessment.limits import beyond
from coopqp.metric import Metric, Trace, spec


@spec
class LimitMarginMin(Metric):
    """Least distance of a joint to its position limit; negative beyond it."""

    unit = "rad or m"

    def measure(self, trace: Trace) -> float:
        return 0.0 - float(beyond(trace).max())  # no negative zero
