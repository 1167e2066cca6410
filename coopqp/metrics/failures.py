"""The failed ticks, each with its cause."""

from __future__ import annotations

from typing import Any

from coopqp.checked import spec
from coopqp.metric import Metric
from coopqp.trace import Trace


@spec
class Failures(Metric):
    """The failed ticks, each with its cause."""

    def measure(self, trace: Trace) -> list[dict[str, Any]]:
        """Over the whole run."""
        return [{"tick": failure.tick, "cause": failure.cause} for failure in trace.failures]
