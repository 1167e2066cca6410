from coopqp.metric import Metric, Trace, spec


@spec
class Solver(Metric):
    """Name of the QP solver; null for laws without one."""

    def measure(self, trace: Trace) -> str | None:
        return trace.solver
