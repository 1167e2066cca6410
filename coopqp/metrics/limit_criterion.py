"""How near the joints are to their limits: what a null-space term minimises, eq. (33).

With x_j = (q_j - mid_j) / (range_j / 2), which is -1 and 1 at the limits of joint j,

    nearest   max_j |x_j|           1 where the first joint is at its limit, more beyond it
    quadratic sum_j (x_j / 2)^2     the criterion of joint_centering

Joints without a range, and those that it does not let move, do not count. Both follow from q alone,
so they are shown for every law, with the term and without.
"""

import numpy as np

from coopqp.metric import Array, Metric, Trace, spec


@spec
class LimitCriterion(Metric):
    """How near the joints are to their limits: 1 at a limit; the worst, and at the end."""

    unit = "1"

    def measure(self, trace: Trace) -> dict[str, float]:
        found = limit_criterion(trace)
        return {
            "nearest_max": float(found["nearest"].max()),
            "nearest_end": float(found["nearest"][-1]),
            "quadratic_end": float(found["quadratic"][-1]),
        }


def limit_criterion(trace: Trace) -> dict[str, Array]:
    """Both over time, by name, each of shape (T + 1,) and beside ``trace.t``."""
    span = trace.upper - trace.lower
    limited = np.isfinite(span) & (span > 0.0)
    lower, upper = trace.lower[limited], trace.upper[limited]
    x = (2.0 * trace.q[:, limited] - lower - upper) / (upper - lower)
    return {
        "nearest": np.abs(x).max(axis=1, initial=0.0),
        "quadratic": 0.25 * np.sum(x * x, axis=1),
    }
