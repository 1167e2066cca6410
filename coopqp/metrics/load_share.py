import numpy as np

from coopqp.metric import Metric, Trace, spec
from coopqp.metrics._hands import by_hand

#: Smaller total lifting forces carry nothing [N].
MIN_LIFT = 1e-3


@spec
class LoadShare(Metric):
    """Mean share of the force upwards that each arm brings, in the robot's order of arms."""

    def measure(self, trace: Trace) -> list[float] | None:
        """None where the plant tells no forces."""
        wrenches = by_hand(trace, "hand_wrench", 6)
        if wrenches is None or not wrenches.size:
            return None
        lift = wrenches[:, :, 2].mean(axis=0)
        total = float(lift.sum())
        return (lift / total).tolist() if np.abs(total) > MIN_LIFT else None
