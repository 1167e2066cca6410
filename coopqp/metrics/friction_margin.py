from coopqp.metric import Metric, Trace, spec
from coopqp.metrics._hands import by_hand, margin


@spec
class FrictionMargin(Metric):
    """Least share of the real friction that no hand used while it held; at 0 it slips."""

    def measure(self, trace: Trace) -> float | None:
        """None where no hand presses."""
        return margin(by_hand(trace, "friction_use"))
