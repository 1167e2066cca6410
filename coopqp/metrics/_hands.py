"""What metrics of the hands have in common: their signals, from when the hands have taken hold."""

import numpy as np

from coopqp.assessment import assess
from coopqp.base.spec import Array
from coopqp.trace import Trace

#: Hands that begin without pressing have taken hold after this [s].
TAKEN = 0.05


def by_hand(trace: Trace, signal: str, width: int = 1) -> Array | None:
    """A signal of hands that press, shape (T', N, width); None where the plant has none."""
    values = trace.signals.get(signal)
    first = min(round(TAKEN / trace.dt), trace.ticks - 1)
    if values is None or not trace.ticks:
        return None
    return np.asarray(
        values[first : end_of_hold(trace)].reshape(-1, values.shape[1] // width, width)
    )


def margin(use: Array | None) -> float | None:
    """One less the largest use of any hand, NaN where there is none; None where there is no use."""
    if use is None or np.isnan(use).all():
        return None
    return 1.0 - float(np.nanmax(use))


def end_of_hold(trace: Trace) -> int:
    """The tick in which the object was lost; the number of ticks where it was not."""
    lost = assess(trace).lost_tick
    if lost is None:
        return trace.ticks
    return max(lost, min(round(TAKEN / trace.dt), trace.ticks - 1) + 1)
