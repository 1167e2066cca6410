from coopqp.base.spec import spec
from coopqp.metric import Metric
from coopqp.metrics._hands import by_hand, margin
from coopqp.trace import Trace


@spec
class EdgeMargin(Metric):
    """Least share of a pad between the pressure and the edge while it held; at 0 it tips."""

    def measure(self, trace: Trace) -> float | None:
        """None where no pad presses."""
        return margin(by_hand(trace, "edge_use"))
