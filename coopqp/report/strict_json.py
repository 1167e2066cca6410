"""JSON that every reader takes: null for NaN and infinities, for which it has no word."""

import json
from typing import Any

from pydantic_core import to_jsonable_python


def text(value: Any) -> str:
    """As JSON for people and machines."""
    return json.dumps(finite(value), allow_nan=False, indent=2)


def finite(value: Any) -> Any:
    """As mappings and lists, arrays and dataclasses too, with None for NaN and infinities."""
    return to_jsonable_python(value, inf_nan_mode="null", fallback=lambda array: array.tolist())
