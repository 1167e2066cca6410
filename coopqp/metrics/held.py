from coopqp.assessment import assess
from coopqp.metric import Metric, Trace, spec


@spec
class Held(Metric):
    """Whether hands that press held the object to the end, and when they lost it."""

    def measure(self, trace: Trace) -> dict[str, float | bool | None] | None:
        """None where no hand presses; a held object need not be where it should be."""
        found = assess(trace)
        if "held" not in trace.signals or not trace.ticks:
            return None
        k = found.lost_tick
        return {"held": k is None, "lost_at": None if k is None else float(trace.t[1 + k])}
