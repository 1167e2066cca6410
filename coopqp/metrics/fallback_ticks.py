"""Ticks in which something was given up to have an answer, by what."""

from __future__ import annotations

from collections import Counter

from coopqp.checked import spec
from coopqp.metric import Metric
from coopqp.solver import Status
from coopqp.trace import Trace


@spec
class FallbackTicks(Metric):
    """Ticks in which something was given up to have an answer, by what."""

    def measure(self, trace: Trace) -> dict[str, int]:
        """By name of the status, such as DRIFT_GIVEN_UP; empty when nothing was."""
        given_up = (name for name in trace.status if Status[name].fallback)
        return dict(sorted(Counter(given_up).items()))
