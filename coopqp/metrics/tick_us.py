import numpy as np

from coopqp.metric import Metric, Trace, spec


@spec
class TickUs(Metric):
    """Time from reading the joints to the verified command."""

    unit = "us"
    timed = True

    def measure(self, trace: Trace) -> dict[str, float] | None:
        """None where many ticks were done at once."""
        us = trace.tick_us
        if np.isnan(us).any():
            return None
        return {
            "median": float(np.median(us)),
            "p99": float(np.percentile(us, 99)),
            "max": float(us.max()),
        }
