from coopqp.base.spec import spec
from coopqp.metric import Metric
from coopqp.trace import Trace


@spec
class Ticks(Metric):
    """Number of control periods."""

    def measure(self, trace: Trace) -> int:
        return trace.ticks
