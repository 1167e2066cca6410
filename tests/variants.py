"""Variants of the kernel along the same motion."""

from __future__ import annotations

import importlib
from typing import Any
from unittest.mock import patch

import numpy as np
from side_by_side import DAMPING, ERROR_DAMPING

from coopqp.controller import ControlProblem
from coopqp.kernel import native
from coopqp.kernel.law import KernelLaw


def variants() -> list[Any]:
    """The modules that were compiled from these sources and run on this processor."""
    best = native.module()
    if best is None:
        return []
    baseline = importlib.import_module("coopqp.kernel._baseline")
    return [baseline] if best is baseline else [baseline, best]


def apart(problem: ControlProblem, ticks: int) -> tuple[float, int]:
    """How far they are apart along a motion: zero for equal bits, and who decided each tick.

    Returns:
        The largest difference of joints, velocities and what is remembered, or the least number
        above zero where only a sign or a status differs; and how many ticks are the kernel's.
    """
    first, *others = (_driven(variant, problem, ticks) for variant in variants())
    most = 0.0
    for other in others:
        for a, b in zip(first, other, strict=True):
            if a.tobytes() != b.tobytes():
                most = max(most, float(np.abs(a - b).max()), float(np.finfo(float).tiny))
    return most, int(first[-1].sum())


def _driven(variant: Any, problem: ControlProblem, ticks: int) -> list[Any]:
    with patch.object(native, "module", lambda: variant):
        law = KernelLaw(problem, DAMPING, ERROR_DAMPING)
        state = law.start()
        made = law.run(state, ticks)
    said = np.array([hash(causes) for causes in made.causes], float)
    return [made.q, made.v, state.memory.numbers, said, made.compiled.astype(float)]
