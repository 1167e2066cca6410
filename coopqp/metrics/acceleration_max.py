from typing import Any

from coopqp.assessment import assess
from coopqp.metric import Metric, Trace, spec


@spec
class AccelerationMax(Metric):
    """The joint whose speed changes most from tick to tick, for what robots are allowed."""

    unit = "rad/s2 or m/s2"

    def measure(self, trace: Trace) -> dict[str, Any] | None:
        worst = assess(trace).acceleration
        keys = ("value", "joint", "at", "allowed")
        return None if worst is None else {name: getattr(worst, name) for name in keys}
