"""The failed ticks, each with its cause."""

from typing import Any

from coopqp.base.spec import spec
from coopqp.metric import Metric
from coopqp.trace import Failure, Trace


@spec
class Failures(Metric):
    """The failed ticks, each with its cause."""

    def measure(self, trace: Trace) -> list[dict[str, Any]]:
        return [{"tick": failure.tick, "cause": _written(failure)} for failure in trace.failures]


def _written(failure: Failure) -> str:
    return f"{failure.cause}: {failure.note}" if failure.note else failure.cause
