"""What of a task's error counts as its end.

Of a place the last sample. Of a force those of a last stretch, because one sample of a swing says
nothing. Of an impedance that is pushed to the end how far it is from F / K: it was asked to give
way by that.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from coopqp.checked import Array

#: Units of what is asked of the hands' wrenches.
FORCES = ("N", "N m")
#: A force has to stay within its tolerance for so long at its end [s].
SETTLED = 0.2


@dataclass(frozen=True)
class TaskInfo:
    """A task, or a part of it with a unit of its own, as the trace needs it.

    Attributes:
        name, unit, tolerance: as the task says.
        end: when its reference arrives [s].
        rows: of the trace, during which it counts; its error is NaN in the others.
        springs: of an impedance, which of the task's rows each is, its axis of the push, and its
            stiffness [N/m, N m/rad].
    """

    name: str
    unit: str
    tolerance: float
    end: float
    rows: slice = field(default_factory=lambda: slice(None))
    springs: tuple[tuple[int, int, float], ...] = ()

    def columns(self, names: Sequence[str]) -> list[int]:
        """Which of all tasks' rows are those of an impedance's part.

        Args:
            names: of all rows.
        """
        task = self.name.rpartition(".")[0]
        own = [i for i, name in enumerate(names) if name.rpartition(".")[0] == task]
        return [own[row] for row, _, _ in self.springs]

    def beyond_springs(self, e: Array, push: Array) -> Array:
        """How far the rows of an impedance are from where a steady push holds them, shape (1,).

        Args:
            e: of each row, value minus reference.
            push: on the object, shape (6,) [N, N m].
        """
        asked = np.array([push[axis] / stiffness for _, axis, stiffness in self.springs])
        return np.array([np.linalg.norm(e - asked)])


def settled(error: Array, unit: str, dt: float) -> Array:
    """The errors that count as the end: the last; of a force the last ``SETTLED`` seconds.

    And of that no more than the last fifth of its time.

    Args:
        error: at the instants for which the task counts.
        unit: of the error.
        dt: control period [s].
    """
    if unit not in FORCES:
        return error[-1:]
    ticks = min(round(SETTLED / dt), (len(error) - 1) // 5)
    return error[-max(ticks, 1) :]
