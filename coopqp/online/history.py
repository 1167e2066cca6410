"""The last ticks of a loop, in arrays that are there before the first of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from coopqp.base.spec import Array
from coopqp.controller import Command
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.state import State
from coopqp.solver import Status

_STATUSES = tuple(Status)
_NUMBER = {status: i for i, status in enumerate(_STATUSES)}


@dataclass(frozen=True)
class TickBatch:
    """Some ticks, oldest first; T of them.

    Attributes:
        number: of the tick since the loop was made, shape (T,).
        clock: when it began, by the loop's clock, shape (T,) [s].
        t: the time of its references, shape (T,) [s].
        q, v: from where it decided, and what it commanded, shape (T, n).
        measured: what the robot said; NaN where it said nothing of use, shape (T, n).
        position, rotation: of the object at q, shapes (T, 3) [m] and (T, 3, 3).
        loop_position, loop_orientation: largest loop error, shape (T,) [m], [rad].
        us: how long it took, shape (T,) [us].
        causes: one bit for each status, in their order, shape (T,).
    """

    number: NDArray[np.int64]
    clock: Array
    t: Array
    q: Array
    v: Array
    measured: Array
    position: Array
    rotation: Array
    loop_position: Array
    loop_orientation: Array
    us: Array
    causes: NDArray[np.int64]

    def causes_at(self, k: int) -> tuple[Status, ...]:
        """What became of a tick; in the order of the statuses, not of their gravity."""
        bits = int(self.causes[k])
        return tuple(status for i, status in enumerate(_STATUSES) if bits >> i & 1)

    def share(self, status: Status) -> float:
        """In which share of the ticks something was so."""
        bit = 1 << _NUMBER[status]
        return float(np.mean((self.causes & bit) != 0)) if len(self.causes) else 0.0


class History:
    """A bounded ring of ticks."""

    def __init__(self, chain: ClosedChain, capacity: int) -> None:
        self.capacity, self.count = capacity, 0
        rows, joints = (capacity,), (capacity, chain.n)
        self._all = TickBatch(
            number=np.zeros(rows, np.int64),
            **{name: np.zeros(rows) for name in ("clock", "t", "us")},
            **{name: np.zeros(joints) for name in ("q", "v", "measured")},
            position=np.zeros((capacity, 3)),
            rotation=np.zeros((capacity, 3, 3)),
            **{name: np.zeros(rows) for name in ("loop_position", "loop_orientation")},
            causes=np.zeros(rows, np.int64),
        )

    def add(self, clock: float, state: State, measured: Array, command: Command, us: float) -> None:
        """Take down a tick."""
        kept, i = self._all, self.count % self.capacity
        kept.number[i], kept.clock[i], kept.t[i], kept.us[i] = self.count, clock, state.t, us
        kept.q[i], kept.v[i], kept.measured[i] = state.q, command.v, measured
        kept.position[i], kept.rotation[i] = state.p_WO, state.R_WO
        kept.loop_position[i] = state.loop_position_error
        kept.loop_orientation[i] = state.loop_orientation_error
        bits = 0
        for cause in command.causes:
            bits |= 1 << _NUMBER[cause]
        kept.causes[i] = bits
        self.count += 1

    def last(self, ticks: int | None = None) -> TickBatch:
        """A copy of the last ticks that are still there, all of them when omitted."""
        kept = min(self.count, self.capacity)
        count = kept if ticks is None else max(0, min(ticks, kept))
        rows = np.arange(self.count - count, self.count) % self.capacity
        return TickBatch(
            *(getattr(self._all, name)[rows] for name in TickBatch.__dataclass_fields__)
        )
