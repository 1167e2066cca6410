"""How much of the friction was never used."""

from __future__ import annotations

from coopqp.checked import spec
from coopqp.metric import Metric
from coopqp.metrics._hands import by_hand
from coopqp.trace import Trace


@spec
class FrictionMargin(Metric):
    """Least share of the real friction that no hand used while it held; below 0 it slipped."""

    def measure(self, trace: Trace) -> float | None:
        """One less the largest use of any hand; none where no hand presses."""
        use = by_hand(trace, "friction_use")
        return None if use is None or not use.size else 1.0 - float(use.max())
