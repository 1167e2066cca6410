"""Motions along the loops that leave them closed, compiled: for those who look for poses."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from coopqp.base.spec import Array
from coopqp.kernel import native
from coopqp.kernel.fit import unfit
from coopqp.kernel.flat import flat_model, kept_rows
from coopqp.model.closed_chain import ClosedChain

#: Moves q, which is written, along what the loops leave of a direction, by a length, and closes the
#: loops by so many Newton steps; returns the largest gap of a loop [m, rad]. Below zero where rows
#: that are independent in general are not so.
Slide = Callable[[Array, Array, float, int], float]


def slide(chain: ClosedChain) -> Slide | None:
    """What moves a chain along its loops; None where the kernel cannot do the chain."""
    return chain.once(_slide)


def _slide(chain: ClosedChain) -> Slide | None:
    found: Any = native.module()
    model = flat_model(chain)
    if found is None or model is None or unfit(chain):
        return None
    step: Slide = found.Slide({"model": model, "kept": kept_rows(chain)}).step
    return step
