from coopqp.metric import Metric, Trace, spec


@spec
class Ticks(Metric):
    """Number of control periods."""

    def measure(self, trace: Trace) -> int:
        return trace.ticks
