from collections import Counter

from coopqp.metric import Metric, Trace, spec
from coopqp.solver import causes_of


@spec
class RelaxedTicks(Metric):
    """Ticks in which constraints were relaxed to have a solution, by cause."""

    def measure(self, trace: Trace) -> dict[str, int]:
        """By cause, such as DRIFT_SLOWED; a tick counts for each of its own."""
        relaxed = (
            cause.name for status in trace.status for cause in causes_of(status) if cause.relaxed
        )
        return dict(sorted(Counter(relaxed).items()))
