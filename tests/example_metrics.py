"""Every metric as it is without settings."""

from __future__ import annotations

from example_settings import examples

from coopqp.metric import Metric

EXAMPLES: dict[str, Metric] = examples("metrics")
