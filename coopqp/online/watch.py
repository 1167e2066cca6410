"""The time between ticks: which come late, and by how much; which before their time, and wait."""

from __future__ import annotations

import math
from collections.abc import Mapping
from contextlib import suppress
from typing import Any

#: A tick is late when it comes more than this share of a period after its time, and early when it
#: comes more than this before it.
SHARE = 0.5
#: Who ticks may have a clock that is so much faster.
FASTER = 0.02


class Watch:
    """Counts late and early ticks.

    Early ones are none: each command is for a whole period, so two in one ask for twice the speed.
    The time before which no tick can be goes on by a period with each of them, so that ticks which
    come a little early again and again do not sum up.

    Attributes:
        longest: the longest time between two ticks [s].
        longest_tick: the number of the tick before which it was; -1 before the second tick.
        elapsed: from the tick before to the last one [s]; NaN for a first one.
        began: when the last tick did that was not early [s].
        stands: whether the clock has not gone on since it was last looked at.
    """

    def __init__(self, dt: float) -> None:
        self._dt = dt
        self.late, self.early, self.longest, self.longest_tick = 0, 0, 0.0, -1
        self.elapsed, self._last = math.nan, math.nan
        self.began = self._since = self._seen = -math.inf
        self.stands = self._held = False

    def __repr__(self) -> str:
        """What was counted."""
        slow = f"longest={self.longest:.6f}, longest_tick={self.longest_tick}"
        return f"Watch(late={self.late}, early={self.early}, {slow})"

    def forget(self) -> None:
        """Let the next tick be a first one, as after a pause."""
        self._last = math.nan

    def left(self, now: float) -> float:
        """How long the period still is [s]; zero if a tick may come."""
        self.stands, self._seen = now <= self._seen, now
        if not now < self._since:
            return 0.0
        self.early += 1
        self._held = True
        return self.began + self._dt - now

    def tick(self, k: int, now: float) -> bool:
        """A tick begins; whether it is late."""
        self.elapsed, self._last, self.began = now - self._last, now, now
        # The earliest time of the next one.
        behind = now - (SHARE - FASTER) * self._dt
        self._since = max(self._since, behind) + (1.0 - FASTER) * self._dt
        if self.elapsed > self.longest:
            self.longest, self.longest_tick = self.elapsed, k
        # After an early one, which is none, the next is due a period later.
        is_late = self.elapsed > (1.0 + SHARE + self._held) * self._dt
        self._held = False
        self.late += is_late
        return is_late


class Waiting:
    """A reading and inputs that wait; of several the last counts."""

    def __init__(self) -> None:
        self.forget()

    def forget(self) -> None:
        """Begin anew."""
        self._q: Any = None
        self._inputs: dict[Any, Any] = {}

    def keep(self, q: Any, inputs: Any) -> None:
        """Let them wait."""
        if q is not None:
            self._q = q
        if isinstance(inputs, Mapping):
            with suppress(Exception):  # a class of a user's may fail
                self._inputs.update(inputs)

    def take(self, q: Any, inputs: Any) -> tuple[Any, Any]:
        """What a tick is given, with what has waited for it."""
        waited, values = self._q, self._inputs
        if waited is None and not values:
            return q, inputs
        self.forget()
        if inputs is None or isinstance(inputs, Mapping):
            inputs = {**values, **(inputs or {})}
        return waited if q is None else q, inputs
