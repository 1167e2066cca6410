from typing import Any

import numpy as np

from coopqp.metric import Metric, Trace, spec


@spec
class TorqueMargin(Metric):
    """Least share of its torque that a motor had left, and which one."""

    def measure(self, trace: Trace) -> dict[str, Any] | None:
        """None where the plant has no motors, or all without limits."""
        tau = trace.signals.get("tau")
        limited = np.isfinite(trace.effort) & (trace.effort > 0.0)
        if tau is None or not trace.ticks or not limited.any():
            return None
        used = np.abs(tau[:, limited]).max(axis=0) / trace.effort[limited]
        worst = int(used.argmax())
        names = [name for name, on in zip(trace.joints, limited, strict=True) if on]
        return {"least": 1.0 - float(used[worst]), "joint": names[worst]}
