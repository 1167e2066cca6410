"""The compiled module for this processor, and what it cannot do; Python works without it."""

from __future__ import annotations

import hashlib
import importlib
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from coopqp.base.spec import Array
from coopqp.controller import ControlProblem
from coopqp.kernel.flat import flat_model, kept_rows
from coopqp.limit import movers
from coopqp.model.closed_chain import ClosedChain

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


#: What the compiled arrays hold: joints of two arms, joints that move several arms, loops.
MOST_LANES, MOST_SHARED, MOST_LOOPS = 64, 6, 16


def why_not(problem: ControlProblem) -> str:
    """Why the kernel cannot do a problem; empty where it can."""
    chain = problem.chain
    if module() is None:
        return MISSING
    if not problem.solver.kernel_instead:
        return "the scenario asks for another solver"
    return unfit(chain)


def unfit(chain: ClosedChain) -> str:
    """What of a chain the kernel cannot do; empty where it can do all."""
    if chain.loops.varying:
        return "which loop rows depend on others changes with the pose"
    return chain.once(_unfit)


def _unfit(chain: ClosedChain) -> str:
    if chain.once(flat_model) is None:
        return "a joint is neither a hinge nor a slide"
    if chain.n <= len(chain.loops.kept):
        return "the loops leave no motion"
    moved = movers(chain, [chain.model.frames[frame].parentJoint for frame in chain.frames])
    shared = moved.sum(axis=0) > 1.0
    first = np.count_nonzero(shared | (moved[0] > 0.0))
    others = (moved[1 : chain.holding] * ~shared).sum(axis=1)
    widest = max(first, 6 + np.count_nonzero(shared)) + others.max(initial=0.0)
    if widest > MOST_LANES and chain.holding > 1:
        return f"two arms have more than {MOST_LANES} joints together"
    if np.count_nonzero(shared) > MOST_SHARED:
        return f"more than {MOST_SHARED} joints move several arms"
    carry, kept = int(first), kept_rows(chain).reshape(-1, 6).sum(axis=1)
    for own, rows in zip(others, kept, strict=True):
        left = int(carry + own - rows)
        if left < 0:
            return "a loop has fewer joints than rows"
        carry = min(left, 6 + int(np.count_nonzero(shared)))
    if chain.holding - 1 > MOST_LOOPS:
        return f"there are more than {MOST_LOOPS} loops"
    return ""


#: slide(q, direction, length, steps) moves q in place along the projection of a direction on the
#: motions that keep the loops closed, and closes them by Newton steps; returns the largest loop
#: error [m, rad], below zero where rows that are independent in general are not so.
Slide = Callable[[Array, Array, float, int], float]


def slide(chain: ClosedChain) -> Slide | None:
    """The function that moves a chain along its loops; None where the kernel cannot."""
    return chain.once(_slide)


def _slide(chain: ClosedChain) -> Slide | None:
    engine: Any = module()
    model = chain.once(flat_model)
    if engine is None or model is None or unfit(chain):
        return None
    step: Slide = engine.Slide({"model": model, "kept": kept_rows(chain)}).step
    return step
