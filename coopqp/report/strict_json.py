"""JSON that every reader takes: null for NaN and infinities, for which it has no word."""

import json
import math
from typing import Any


def text(value: Any) -> str:
    """As JSON for people and machines."""
    return json.dumps(finite(value), allow_nan=False, indent=2)


def finite(value: Any) -> Any:
    """The same, with None for NaN and infinities."""
    if isinstance(value, dict):
        return {key: finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [finite(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
