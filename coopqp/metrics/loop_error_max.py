from coopqp.assessment import assess
from coopqp.metric import Metric, Trace, spec


@spec
class LoopErrorMax(Metric):
    """Largest distance and angle between where two arms carry the object."""

    unit = "m, rad"

    def measure(self, trace: Trace) -> dict[str, float]:
        position, orientation = assess(trace).loop
        return {"position": position, "orientation": orientation}
