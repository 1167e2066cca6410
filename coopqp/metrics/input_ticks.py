"""Ticks in which inputs were not followed as sent: refused, or stale; and what was never followed.

An input was never followed if nothing that could be used has arrived at it, or if the run ends with
what arrives being refused.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from coopqp.checked import spec
from coopqp.metric import Metric
from coopqp.solver import Status, causes_of
from coopqp.trace import Trace


@spec
class InputTicks(Metric):
    """Ticks with refused and with stale inputs, and the inputs that were not followed at all."""

    def measure(self, trace: Trace) -> dict[str, Any] | None:
        """Over the whole run; none where nothing follows an input."""
        if not trace.inputs or not trace.ticks:
            return None
        return {
            "refused": len(_ticks_with(trace, Status.INPUT_REFUSED)),
            "stale": len(_ticks_with(trace, Status.INPUT_STALE)),
            "nothing_at": [
                name for name, kept in trace.inputs.items() if np.isnan(kept.sent).all()
            ],
            "refused_at_end": trace.ticks - 1 in _ticks_with(trace, Status.INPUT_REFUSED),
        }


def followed(trace: Trace) -> bool:
    """Whether goals that are inputs are what was sent."""
    found = InputTicks().measure(trace)
    return not found or not (found["nothing_at"] or found["refused_at_end"])


def _ticks_with(trace: Trace, cause: Status) -> list[int]:
    return [k for k, word in enumerate(trace.status) if cause in causes_of(word)]
