"""Every plant as it is without settings."""

from __future__ import annotations

from example_settings import examples

from coopqp.plant import Plant

EXAMPLES: dict[str, Plant] = examples("plants")
