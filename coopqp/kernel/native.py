"""The compiled module for this processor; Python works without it.

The installation runs this file, so that it needs nothing but Python.
"""

import hashlib
import importlib
from functools import cache
from pathlib import Path
from typing import Any

MISSING = (
    "the kernel is not built, or not from these sources, so ticks run in Python: install a C++17 "
    "compiler and then coopqp again"
)


@cache
def module() -> Any | None:
    """The module with the class ``Engine``; None where none was compiled from these sources."""
    baseline = _imported("_baseline")
    if baseline is None or not baseline.has_avx2():
        return baseline
    return _imported("_avx2") or baseline


def _imported(name: str) -> Any | None:
    try:
        found = importlib.import_module(f"coopqp.kernel.{name}")
    except ImportError:
        return None
    return found if getattr(found, "sources", "") == digest() else None


def digest() -> str:
    """Hash of the sources here; in a checkout they may be newer than the compiled module."""
    here, found = Path(__file__).parent, hashlib.sha256()
    for path in sorted([*here.glob("*.[ch]pp"), *here.glob("core/*.hpp")]):
        found.update(path.read_bytes())
    return found.hexdigest()
