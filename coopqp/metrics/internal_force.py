import numpy as np

from coopqp.metric import Metric, Trace, spec

#: What counts as the end of a run [s].
END = 0.5


@spec
class InternalForce(Metric):
    """How hard the hands squeeze and twist the object against each other, if the plant tells it."""

    unit = "N, N m"

    def measure(self, trace: Trace) -> dict[str, float] | None:
        """Largest force and moment of a hand that others cancel: worst, and mean at the end."""
        signal = trace.signals.get("internal_wrench")
        if signal is None or not trace.ticks:
            return None
        parts = signal.reshape(trace.ticks, -1, 2, 3)
        force, moment = np.linalg.norm(parts, axis=3).max(axis=1).T
        last = slice(-max(1, round(END / trace.dt)), None)
        return {
            "worst": float(force.max()),
            "end": float(force[last].mean()),
            "moment_worst": float(moment.max()),
            "moment_end": float(moment[last].mean()),
        }
