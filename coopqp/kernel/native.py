"""The compiled module that suits this processor; pure Python works without one."""

from __future__ import annotations

import importlib
from functools import cache
from typing import Any

MISSING = (
    "the kernel is not built, so ticks run in Python: install a C++17 compiler and then coopqp "
    "again"
)


@cache
def module() -> Any | None:
    """The module with the class ``Engine``; None where nothing was compiled."""
    baseline = _imported("_baseline")
    if baseline is None or not baseline.has_avx2():
        return baseline
    return _imported("_avx2") or baseline


def _imported(name: str) -> Any | None:
    try:
        return importlib.import_module(f"coopqp.kernel.{name}")
    except ImportError:
        return None
