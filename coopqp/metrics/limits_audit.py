from coopqp.assessment.thresholds import AT_LIMIT
from coopqp.metric import Metric, Trace, spec


@spec
class LimitsAudit(Metric):
    """What every limit had left: least margin, ticks at the bound, share of time."""

    def measure(self, trace: Trace) -> dict[str, dict[str, float]]:
        """By limit and joint or row, such as limit.position[RElbowRoll].upper."""
        return {
            row.name: {
                "margin_min": float(margin.min(initial=float("inf"))),
                "ticks_at_bound": int((margin <= AT_LIMIT).sum()),
                "saturated_share": float((margin <= AT_LIMIT).mean()) if margin.size else 0.0,
            }
            for row, margin in trace.margins.items()
        }
