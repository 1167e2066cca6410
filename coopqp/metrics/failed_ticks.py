from coopqp.assessment import assess
from coopqp.metric import Metric, Trace, spec


@spec
class FailedTicks(Metric):
    """Ticks whose answer failed the check, so that the joints held still."""

    def measure(self, trace: Trace) -> int:
        return assess(trace).failed[0]
