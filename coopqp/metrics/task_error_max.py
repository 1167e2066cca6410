import numpy as np

from coopqp.metric import Metric, Trace, spec


@spec
class TaskErrorMax(Metric):
    """How far each row of the tasks was from its reference at most, such as "springs.y"."""

    unit = "the task's own"

    def measure(self, trace: Trace) -> dict[str, float | None]:
        """By row, without a sign; None where it has no number in any tick."""
        found: dict[str, float | None] = {}
        for name, errors in zip(trace.task_rows, np.abs(trace.e).T, strict=True):
            finite = errors[np.isfinite(errors)]
            found[name] = float(finite.max()) if finite.size else None
        return found
