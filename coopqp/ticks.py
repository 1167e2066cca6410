"""Many ticks of a law at once."""

from __future__ import annotations

from dataclasses import dataclass, field

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
        scale: least share of its rate at which a hard or scaled task ran, else 1, shape (T,).
        memory: what the law remembered when each began, shape (T, .).
        notes: what else is to be said of a tick that stood still, by tick.
    """

    q: Array
    v: Array
    causes: list[tuple[Status, ...]]
    compiled: NDArray[np.bool_]
    scale: Array
    memory: Array
    notes: dict[int, str] = field(default_factory=dict)

    @staticmethod
    def room(ticks: int, n: int, remembered: int) -> Ticks:
        """Arrays for so many ticks, every one optimal.

        Args:
            ticks: T.
            n: joints.
            remembered: how many numbers the law remembers.
        """
        return Ticks(
            np.zeros((ticks + 1, n)),
            np.zeros((ticks, n)),
            [(Status.OPTIMAL,)] * ticks,
            np.zeros(ticks, bool),
            np.ones(ticks),
            np.zeros((ticks, remembered)),
        )
