"""coopqp: QP control of robots that hold one object with several arms.

    import coopqp

    scenario = coopqp.load("scenarios/point_on_point.yaml")
    comparison = coopqp.compare(scenario)

Names are imported when first used, so that ``coopqp --help`` need not wait for pinocchio. Which
names there are, and where they live, is written once, in ``__init__.pyi``, for type checkers and
for this file.
"""

from __future__ import annotations

import ast
import importlib
from pathlib import Path
from typing import Any

__version__ = "0.2.0"


def _homes() -> dict[str, str]:
    """Module of each public name, as the stub imports it."""
    stub = Path(__file__).with_suffix(".pyi").read_text(encoding="utf-8")
    imports = (node for node in ast.parse(stub).body if isinstance(node, ast.ImportFrom))
    return {alias.name: str(node.module) for node in imports for alias in node.names}


_HOMES = _homes()

__all__ = ["__version__", *sorted(_HOMES)]


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'coopqp' has no attribute '{name}'")
    value = getattr(importlib.import_module(_HOMES[name]), name)
    # A module of the same name (coopqp.trace) is set by the import system; ours is set after it.
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return [*__all__, "__doc__"]
