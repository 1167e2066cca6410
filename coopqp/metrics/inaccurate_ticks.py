from coopqp.metric import Metric, Trace, spec
from coopqp.solver import Status, causes_of


@spec
class InaccurateTicks(Metric):
    """Ticks that were feasible but not optimal to the declared accuracy."""

    def measure(self, trace: Trace) -> int:
        return sum(causes_of(word)[0] is Status.INACCURATE for word in trace.status)
