"""Ticks in memory that is there before the first of them: one side fills it, the other empties it.

A row is copied in one step when it is whole, and counted after that, so the two sides need no lock.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from coopqp.checked import Array
from coopqp.controller import Command, Law
from coopqp.recordings.column import Layout, names, of_field
from coopqp.signal import Kind
from coopqp.solver import Status
from coopqp.state import State

#: Where a live loop measures fields of the table, those beside time, memory and inputs.
MEASURED: dict[str, Callable[[State, Command], Any]] = {
    "q": lambda state, command: state.q,
    "v": lambda state, command: command.v,
    "measured": lambda state, command: np.nan if state.q_measured is None else state.q_measured,
    "gap": lambda state, command: state.gap,
    "tau": lambda state, command: command.tau,
    "position": lambda state, command: state.p_WO,
    "rotation": lambda state, command: state.R_WO.ravel(),
    "loop_position": lambda state, command: state.loop_position_error,
    "loop_orientation": lambda state, command: state.loop_orientation_error,
    "scale": lambda state, command: command.scale,
}


class TickRing:
    """The last ticks of a loop that have not been written yet.

    Attributes:
        names: of the columns that are numbers, C of them; NaN is an empty cell.
        numbers: shape (C, capacity).
        numbered: which tick a row is of, shape (capacity,).
        causes: what became of it, by row.
        filled, emptied: how many rows have gone in and out.
        dropped: how many ticks found no room.
        capacity: as given.
    """

    def __init__(
        self,
        law: Law,
        start: State,
        also: Sequence[str],
        capacity: int,
        memory: int = 0,
        inputs: Mapping[str, Kind] | None = None,
    ) -> None:
        layout = Layout(
            joints=law.problem.chain.joint_names,
            loops=len(start.gap) // 6,
            memory=max(memory, len(start.memory.numbers)),
            inputs=inputs or {},
        )
        without = {"measured"} if start.q_measured is None else set()
        without |= {"tau"} if law.command.tau is None else set()
        told = {name: of for name, of in MEASURED.items() if name not in without}
        others = ("t", "memory", "followed", "followed_rate", "tick_us")
        self.names = (*names(layout, {*told, *others}), *also)
        self.capacity = capacity
        self.numbers = np.full((len(self.names), capacity), np.nan)
        self.numbered = np.zeros(capacity, np.int64)
        self.causes: list[tuple[Status, ...]] = [()] * capacity
        self.filled = self.emptied = self.dropped = self._ticks = 0
        self._row = np.zeros(len(self.names))
        self._told = [(self._view(name, layout), of) for name, of in told.items()]
        self._t, self._us = self._view("t", layout), self._view("tick_us", layout)
        self._v, self._memory = self._view("v", layout), self._view("memory", layout)
        self._also = self._row[len(self.names) - len(also) :]
        self._followed = []
        for name, kind in layout.inputs.items():
            own = Layout(joints=(), inputs={name: kind})
            values, rates = self._view("followed", own), self._view("followed_rate", own)
            self._followed.append((name, values, rates))
        self.begin(start)

    def _view(self, name: str, layout: Layout) -> Array:
        """A field's part of the row; its columns stand beside each other."""
        columns = of_field(name, layout)
        first = self.names.index(columns[0]) if columns else 0
        return self._row[first : first + len(columns)]

    def begin(self, state: State, since: float = 0.0) -> None:
        """Take down from what a law decides its first tick.

        A tick is done again from the velocity of the one before. Where that is not the state's, as
        after a stop, a number is left out between them.
        """
        self._remember(state)
        self._since = since
        if self._ticks and not np.array_equal(self._v, state.v):
            self._ticks += 1

    def add(self, state: State, command: Command, us: float, also: Array | Sequence[float]) -> None:
        """Copy a tick; count it as dropped where there is no room."""
        tick, i = self._ticks, self.filled % self.capacity
        self._ticks = tick + 1
        if self.filled - self.emptied < self.capacity:
            self._fill(state, command, us)
            if len(self._also):
                self._also[:] = also
            self.numbers[:, i] = self._row
            self.numbered[i], self.causes[i] = tick, command.causes
            self.filled += 1
        else:
            self.dropped += 1
        self._remember(state)

    def _remember(self, state: State) -> None:
        kept = state.memory.numbers
        self._memory[: len(kept)], self._memory[len(kept) :] = kept, 0.0

    def _fill(self, state: State, command: Command, us: float) -> None:
        self._t[0], self._us[0] = self._since + state.t, us
        for part, of in self._told:
            part[:] = of(state, command)
        for name, value, rate in self._followed:
            followed = state.inputs.get(name)
            value[:] = np.nan if followed is None else followed.value
            rate[:] = np.nan if followed is None else followed.rate

    def waiting(self) -> list[slice]:
        """Rows that have gone in and not out, in their order: one piece, or two around the end."""
        first, count = self.emptied % self.capacity, self.filled - self.emptied
        before = min(count, self.capacity - first)
        pieces = slice(first, first + before), slice(0, count - before)
        return [piece for piece in pieces if piece.stop > piece.start]
