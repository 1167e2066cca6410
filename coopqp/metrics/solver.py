from coopqp.base.spec import spec
from coopqp.metric import Metric
from coopqp.trace import Trace


@spec
class Solver(Metric):
    """Name of the QP solver; null for laws without one."""

    def measure(self, trace: Trace) -> str | None:
        return trace.solver
