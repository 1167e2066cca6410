from coopqp.assessment import assess
from coopqp.metric import Metric, Trace, spec


@spec
class Reached(Metric):
    """Whether every task's error ended within its tolerance, the object in all hands.

    A force has to stay within it for the last 0.2 s: one sample of an oscillation proves nothing.
    A goal that is an input, and was never followed, is not reached, however small the error.
    """

    def measure(self, trace: Trace) -> bool:
        return assess(trace).reached
