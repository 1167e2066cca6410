from coopqp.metric import Metric, Trace, spec


@spec
class InaccurateTicks(Metric):
    """Ticks that were feasible but not optimal to the declared accuracy."""

    def measure(self, trace: Trace) -> int:
        return int(trace.inaccurate.sum())
