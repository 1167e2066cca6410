"""Whether every task's error ended within its tolerance, the object in all hands.

A force has to stay within it for the last 0.2 s: one sample of a swing says nothing.
A goal that is an input, and was never followed, is not reached, however small the error.
"""

from __future__ import annotations

from coopqp.assessment import assess
from coopqp.base.spec import spec
from coopqp.metric import Metric
from coopqp.trace import Trace


@spec
class Reached(Metric):
    """Whether every task's error ended within its tolerance, the object in all hands."""

    def measure(self, trace: Trace) -> bool:
        """At the end of the time for which each counts."""
        return assess(trace).reached
