"""What solved the QPs: the compiled kernel or Python; null for laws without a QP."""

import numpy as np

from coopqp.base.spec import spec
from coopqp.metric import Metric
from coopqp.trace import Trace


@spec
class Engine(Metric):
    """What solved the QPs, and how many ticks the kernel left to Python; null without a QP."""

    def measure(self, trace: Trace) -> dict[str, str | int] | None:
        if trace.engine is None:
            return None
        left = trace.ticks - int(np.count_nonzero(trace.compiled))
        return {"name": trace.engine, "ticks_in_python": left}
