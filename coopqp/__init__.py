"""coopqp: QP control of robots that hold one object with several arms.

    import coopqp

    scenario = coopqp.load("scenarios/point_on_point.yaml")
    comparison = coopqp.compare(scenario)

Names are imported when first used, so that ``coopqp --help`` need not wait for pinocchio.
"""

from __future__ import annotations

import importlib
from typing import Any

__version__ = "0.1.0"

_HOME = {
    "load": "scenario_loader",
    "Scenario": "scenario",
    "run": "comparison",
    "compare": "comparison",
    "Comparison": "comparison",
    "mobility": "mobility_analysis",
    "ClosedChain": "closed_chain",
    "HeldObject": "held_object",
    "State": "state",
    "ControlProblem": "controller",
    "Profile": "profile",
    "Trace": "trace",
    "CoopqpError": "errors",
}

__all__ = ["__version__", *_HOME]


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'coopqp' has no attribute '{name}'")
    return getattr(importlib.import_module(f"coopqp.{_HOME[name]}"), name)
