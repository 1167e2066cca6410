"""What a metric is: one number, or a few, out of a trace; and what it is written with."""

from __future__ import annotations

import json
from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any, ClassVar

from coopqp.base.spec import Array as Array
from coopqp.base.spec import spec as spec
from coopqp.base.wording import plain, raised, written_in
from coopqp.trace import Trace as Trace
from coopqp.trace import read_only

#: Columns that every study has of its own; no metric is called so.
OF_STUDIES = frozenset(
    ("row", "variant", "controller", "state", "reason", "success", "blocked_by", "broken",
     "variant_seed")
)  # fmt: skip
#: Larger whole numbers are kept as others are.
MAX_WHOLE = 2**53


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


def measured(metrics: Mapping[str, Metric], trace: Trace) -> tuple[dict[str, Any], list[str]]:
    """What metrics, by name, say of a trace, which they cannot write to, as JSON holds it.

    None where one raises or gives what is no JSON; and what is wrong with these.
    """
    found, faults, kept = dict.fromkeys(metrics), list[str](), read_only(trace)
    for name, metric in metrics.items():
        try:
            text = json.dumps(metric.measure(kept), default=plain)
            found[name] = json.loads(text, parse_int=_whole)
        except KeyboardInterrupt:
            raise
        except BaseException as error:  # noqa: BLE001 - a metric may be the user's
            file = written_in(metric, "measure")
            faults.append(f"metric '{name}': {raised(error, file)}")
    return found, faults


def _whole(digits: str) -> float:
    number = int(digits)
    return number if abs(number) <= MAX_WHOLE else float(number)
