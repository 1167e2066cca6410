from typing import Any

from coopqp.metric import Metric, Trace, spec


@spec
class Failures(Metric):
    """The failed ticks, each with its cause."""

    def measure(self, trace: Trace) -> list[dict[str, Any]]:
        causes = [(f.tick, f"{f.cause}: {f.note}" if f.note else f.cause) for f in trace.failures]
        return [{"tick": tick, "cause": cause} for tick, cause in causes]
