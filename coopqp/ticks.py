"""Many ticks of a law at once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from coopqp.checked import Array
from coopqp.solver import Status


@dataclass(frozen=True)
class Ticks:
    """Many ticks at once, T of them.

    Attributes:
        q: before each and at the end, shape (T + 1, n) [rad, m].
        v: of each command, shape (T, n) [rad/s, m/s].
        causes: what became of each.
        compiled: whether the kernel decided it, shape (T,).
    """

    q: Array
    v: Array
    causes: list[tuple[Status, ...]]
    compiled: NDArray[np.bool_]

    @staticmethod
    def room(ticks: int, n: int) -> Ticks:
        """Arrays for so many ticks, every one optimal."""
        return Ticks(
            np.zeros((ticks + 1, n)),
            np.zeros((ticks, n)),
            [(Status.OPTIMAL,)] * ticks,
            np.zeros(ticks, bool),
        )
