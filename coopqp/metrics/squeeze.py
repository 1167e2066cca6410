import numpy as np

from coopqp.closed_loop.forces import squeezes
from coopqp.metric import Metric, Trace, spec
from coopqp.metrics._hands import by_hand


@spec
class Squeeze(Metric):
    """How hard the hands press on the object: least, mean and worst, where the plant tells it."""

    unit = "N"

    def measure(self, trace: Trace) -> dict[str, float] | None:
        """Normal forces of hands that press; the squeeze between two or three fastened ones.

        The mean is over hands and ticks. Hands that let go, or lost the object, do not count.
        """
        normal, points = by_hand(trace, "normal_force"), by_hand(trace, "hand_point", 3)
        wrenches = by_hand(trace, "hand_wrench", 6)
        if points is None or wrenches is None:
            return None
        holds = (points != 0.0).any(axis=2)  # hands that hold nothing have no point
        if normal is not None:
            forces = normal[:, :, 0][holds & (wrenches != 0.0).any(axis=2)]
        else:
            ticks = zip(points, wrenches, strict=True)
            forces = np.array([newtons for p, h in ticks for newtons in squeezes(p, h)])
        if not forces.size:
            return None
        least, mean, worst = float(forces.min()), float(forces.mean()), float(forces.max())
        return {"least": least, "mean": mean, "worst": worst}
