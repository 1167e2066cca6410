"""Ticks whose answer failed the check, so that the joints held still."""

from __future__ import annotations

from coopqp.assessment import assess
from coopqp.base.spec import spec
from coopqp.metric import Metric
from coopqp.trace import Trace


@spec
class FailedTicks(Metric):
    """Ticks whose answer failed the check, so that the joints held still."""

    def measure(self, trace: Trace) -> int:
        """Over the whole run."""
        return assess(trace).failed[0]
