"""Columns of ``trace.csv`` beside the run itself: references, margins, and what hands do.

No tick needs them to be done again. A limit has two columns a unit, what was left where it was
nearest and where that was: with one for each joint and side the file would be twice as long.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from coopqp.trace import Trace

#: What plants tell of each hand, and the parts of it.
HANDS = {
    "hand_wrench": (".fx", ".fy", ".fz", ".tx", ".ty", ".tz"),
    "hand_point": (".x", ".y", ".z"),
    "normal_force": ("",),
    "tangential_force": ("",),
    "friction_use": ("",),
    "edge_use": ("",),
    "slip": ("",),
}


class Beside:
    """The columns of a comparison's traces.

    Args:
        traces: of all controllers.
        arms: names, in the robot's order.

    Attributes:
        of_instants: names of the columns with a row an instant.
        of_ticks: names of those with a row a tick.
    """

    def __init__(self, traces: Sequence[Trace], arms: Sequence[str]) -> None:
        self._task_rows = tuple(dict.fromkeys(row for trace in traces for row in trace.task_rows))
        self._limits = tuple(dict.fromkeys(key for trace in traces for key in _limits(trace)))
        self.of_instants = [f"{key}[{row}]" for key in ("e", "rate") for row in self._task_rows]
        self.of_ticks = [
            f"{key}[{owner}].{unit}"
            for owner, unit in self._limits
            for key in ("margin", "nearest")
        ]
        told = [name for name in HANDS if any(name in trace.signals for trace in traces)]
        self._hands = {
            name: [f"{name}[{arm}]{part}" for arm in arms for part in HANDS[name]] for name in told
        }
        if any("held" in trace.signals for trace in traces):
            self._hands["held"] = ["held"]
        self.of_ticks += [column for columns in self._hands.values() for column in columns]

    def instants(self, trace: Trace) -> list[list[Any]]:
        """Each task's rows; empty in the phases that do not have the task, and where it raised."""
        columns = []
        for values in (trace.e, trace.rate):
            known = dict(zip(trace.task_rows, values.T.tolist(), strict=True))
            nothing = [np.nan] * len(trace.t)
            columns += [_told(known.get(row, nothing)) for row in self._task_rows]
        return _turned(columns, len(trace.t))

    def ticks(self, trace: Trace) -> list[list[Any]]:
        """The least margin of each limit and where it is, and what the plant tells of the hands.

        Empty in phases without the limit, and where a hand presses on nothing.
        """
        columns: list[list[Any]] = []
        for key in self._limits:
            rows = [row for row in trace.margins if (row.owner, row.unit) == key]
            left = np.array([trace.margins[row] for row in rows]).reshape(-1, trace.ticks)
            if not len(left):
                columns += [[""] * trace.ticks] * 2
                continue
            where = [rows[i].words for i in left.argmin(axis=0)]
            least = _told(left.min(axis=0).tolist())
            named = [w if m != "" else "" for w, m in zip(where, least, strict=True)]
            columns += [least, named]
        for name, names in self._hands.items():
            nothing = np.full((trace.ticks, len(names)), np.nan)
            columns += [_told(column) for column in trace.signals.get(name, nothing).T.tolist()]
        return _turned(columns, trace.ticks)


def _limits(trace: Trace) -> list[tuple[str, str]]:
    """Name and unit of all limits that a trace has margins of."""
    return [(row.owner, row.unit) for row in trace.margins]


def _told(values: list[float]) -> list[Any]:
    return [value if np.isfinite(value) else "" for value in values]


def _turned(columns: list[list[Any]], rows: int) -> list[list[Any]]:
    return [list(row) for row in zip(*columns, strict=True)] or [[] for _ in range(rows)]
