from coopqp.metric import Metric, Trace, spec
from coopqp.metrics._hands import by_hand, margin


@spec
class EdgeMargin(Metric):
    """Least share of a pad between the pressure and the edge while it held; at 0 it tips."""

    def measure(self, trace: Trace) -> float | None:
        """None where no pad presses."""
        return margin(by_hand(trace, "edge_use"))
