"""A phase: a part of a scenario in which the same arms hold the object and the same tasks count.

Between two phases arms let go of the object or take hold of it (:meth:`ClosedChain.handed_over`).
Time, and with it every reference, begins anew in each phase.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from coopqp.task import Task


@dataclass(frozen=True, kw_only=True)
class Phase:
    """A part of a scenario.

    Attributes:
        name: of the phase; empty where the scenario has one phase only.
        tasks: what shall happen; their references set out when the phase begins.
        duration: [s].
        released: names of the arms that do not hold the object.
    """

    name: str = ""
    tasks: Sequence[Task]
    duration: float
    released: tuple[str, ...] = ()

    def ticks(self, dt: float) -> int:
        """Number of control periods of dt [s]."""
        return max(1, round(self.duration / dt))
