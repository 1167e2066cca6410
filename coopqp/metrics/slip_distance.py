from coopqp.metric import Metric, Trace, spec
from coopqp.metrics._hands import by_hand


@spec
class SlipDistance(Metric):
    """How far the object slipped along a hand that presses, at most, while it was held."""

    unit = "m"

    def measure(self, trace: Trace) -> float | None:
        """None where no hand presses."""
        slip = by_hand(trace, "slip")
        return None if slip is None or not slip.size else float(slip.max())
