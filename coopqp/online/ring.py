"""Ticks in memory that is there before the first of them: one side fills it, the other empties it.

A row is copied in one step when it is whole, and counted after that, so the two sides need no lock.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from coopqp.checked import Array
from coopqp.closed_chain import AXES
from coopqp.controller import Command, Law
from coopqp.signal import Kind
from coopqp.solver import Status
from coopqp.state import State

POSE = ("x", "y", "z", *(f"R{row}{column}" for row in (1, 2, 3) for column in (1, 2, 3)))
LAST = ("loop_position", "loop_orientation", "scale", "tick_us")


class TickRing:
    """The last ticks of a loop that have not been written yet.

    Args:
        law: whose ticks.
        start: the state before the first tick.
        also: names of further columns.
        capacity: how many ticks it holds.
        memory: room for what is remembered, where a law to come remembers more than this one.
        inputs: what is followed in any phase, by name.

    Attributes:
        names: of the columns that are numbers, C of them.
        gaps: of those in which NaN is nothing.
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
        followed = inputs or {}
        parts = _parts(law, start, also, max(memory, len(start.memory.numbers)), followed)
        self.names = tuple(name for names in parts.values() for name in names)
        self.capacity = capacity
        self.numbers = np.zeros((len(self.names), capacity))
        self.numbered = np.zeros(capacity, np.int64)
        self.causes: list[tuple[Status, ...]] = [()] * capacity
        self.filled = self.emptied = self.dropped = self._ticks = 0
        self._row = np.zeros(len(self.names))
        at, views = 0, {}
        for part, names in parts.items():
            views[part] = self._row[at : at + len(names)]
            at += len(names)
        self._t, self._q, self._v, self._gap = (views[key] for key in ("t", "q", "v", "gap"))
        self._memory, self._measured, self._tau = (
            views[key] for key in ("memory", "measured", "tau")
        )
        self._p, self._R = views["pose"][:3], views["pose"][3:].reshape(3, 3)
        self._last, self._also = views["last"], views["also"]
        self._followed = [
            (name, views[f"followed[{name}]"], views[f"followed_rate[{name}]"]) for name in followed
        ]
        self.gaps = tuple(x for key in views if key.startswith("followed") for x in parts[key])
        self.begin(start)

    def begin(self, state: State, since: float = 0.0) -> None:
        """Take down from what a law decides its first tick.

        A tick is done again from the velocity of the one before. Where that is not the state's, as
        after a stop, a number is left out between them.

        Args:
            state: with which the loop goes on.
            since: when the state's own time began, as in a later phase [s].
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
        self._t[0], self._q[:] = self._since + state.t, state.q
        self._v[:], self._gap[:] = command.v, state.gap
        if len(self._measured):
            self._measured[:] = np.nan if state.q_measured is None else state.q_measured
        if len(self._tau):
            self._tau[:] = command.tau
        self._p[:], self._R[:] = state.p_WO, state.R_WO
        last = self._last
        last[0], last[1] = state.loop_position_error, state.loop_orientation_error
        last[2], last[3] = command.scale, us
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


def _parts(
    law: Law, start: State, also: Sequence[str], memory: int, inputs: Mapping[str, Kind]
) -> dict[str, tuple[str, ...]]:
    """The columns, part by part."""
    joints, loops = law.problem.chain.joint_names, range(len(start.gap) // 6)
    sensed, torques = start.q_measured is not None, law.command.tau is not None
    return {
        "t": ("t",),
        "q": tuple(f"q[{joint}]" for joint in joints),
        "v": tuple(f"v[{joint}]" for joint in joints),
        "measured": tuple(f"measured[{joint}]" for joint in joints if sensed),
        "gap": tuple(f"gap[{loop + 1}].{axis}" for loop in loops for axis in AXES),
        "memory": tuple(f"memory[{i}]" for i in range(memory)),
        "tau": tuple(f"tau[{joint}]" for joint in joints if torques),
        "pose": POSE,
        "last": LAST,
        **{
            f"followed[{name}]": tuple(f"followed[{name}].{x}" for x in kind.value_columns)
            for name, kind in inputs.items()
        },
        **{
            f"followed_rate[{name}]": tuple(f"followed_rate[{name}].{x}" for x in kind.rate_columns)
            for name, kind in inputs.items()
        },
        "also": tuple(also),
    }
