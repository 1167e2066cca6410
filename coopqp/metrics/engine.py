from typing import Any

import numpy as np

from coopqp.metric import Metric, Trace, spec


@spec
class Engine(Metric):
    """What solved the QPs, and what the kernel left to Python: ticks, rows of tasks and limits.

    ``rows_us`` is the median time that these rows take of a tick. Null without a QP.
    """

    def measure(self, trace: Trace) -> dict[str, Any] | None:
        if trace.engine is None:
            return None
        left = trace.ticks - int(np.count_nonzero(trace.compiled))
        rows = list(trace.rows_in_python)
        found = {"name": trace.engine, "ticks_in_python": left, "rows_in_python": rows}
        timed = rows and len(trace.rows_us) and np.isfinite(trace.rows_us).all()
        return found | {"rows_us": float(np.median(trace.rows_us)) if timed else None}
