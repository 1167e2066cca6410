from coopqp.base.spec import spec
from coopqp.metric import Metric
from coopqp.trace import Trace


@spec
class InaccurateTicks(Metric):
    """Ticks that were feasible but not optimal to the declared accuracy."""

    def measure(self, trace: Trace) -> int:
        return int(trace.inaccurate.sum())
