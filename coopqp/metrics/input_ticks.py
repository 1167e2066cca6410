from dataclasses import asdict
from typing import Any

from coopqp.assessment import assess
from coopqp.metric import Metric, Trace, spec


@spec
class InputTicks(Metric):
    """Ticks with refused and with stale inputs, and the inputs that were not followed at all.

    An input was never followed if nothing that could be used has arrived at it, or if the run ends
    with what arrives being refused.
    """

    def measure(self, trace: Trace) -> dict[str, Any] | None:
        """None where nothing follows an input."""
        if not trace.inputs or not trace.ticks:
            return None
        return asdict(assess(trace).inputs)
