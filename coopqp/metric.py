"""What a metric is: one number, or a few, out of a trace."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any, ClassVar

from coopqp.base.spec import spec
from coopqp.trace import Trace


@spec
class Metric(ABC):
    """A plug-in in ``metrics/``: a pure function of a trace; its name is its key in the JSON."""

    unit: ClassVar[str] = ""
    """Unit of its numbers."""
    timed: ClassVar[bool] = False
    """Whether it reads how long ticks took; studies that have it do one tick after the other."""

    @abstractmethod
    def measure(self, trace: Trace) -> Any:
        """The value, made of numbers, strings, lists and dicts, so that JSON can hold it."""
