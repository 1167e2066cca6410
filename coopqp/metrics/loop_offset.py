import numpy as np

from coopqp.metric import Array, Metric, Trace, spec


@spec
class LoopOffset(Metric):
    """How far the hands end from where the model has them: its calibration error."""

    unit = "m, rad"

    def measure(self, trace: Trace) -> dict[str, float]:
        """The largest of the loops in the last tick, as the controller observed it.

        Along the line between hands that squeeze by admittance the loop offset is the commanded
        displacement, and no calibration error.
        """
        last = trace.loop_offset[-1].copy() if trace.ticks else np.zeros(0)
        e = _squeezed_along(trace)
        if e is not None:
            last[:3] -= e.dot(last[:3]) * e
        sizes = np.linalg.norm(last.reshape(-1, 2, 3), axis=2)
        position, orientation = sizes.max(axis=0, initial=0.0).tolist()
        return {"position": position, "orientation": orientation}


def _squeezed_along(trace: Trace) -> Array | None:
    """Direction between two hands of which a squeeze is asked; None where it is not."""
    points = trace.signals.get("hand_point")
    squeezes = "forces" in trace.supports and any(task.unit == "N" for task in trace.tasks)
    if points is None or not squeezes or not trace.ticks or not len(trace.loop_offset[-1]):
        return None
    last = points[-1].reshape(-1, 3)
    held = last[(last != 0.0).any(axis=1)]
    if len(held) != 2:
        return None
    way = held[1] - held[0]
    return np.asarray(way / np.linalg.norm(way), float)
