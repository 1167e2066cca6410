"""A watch on the time between ticks: which come late, and by how much."""

from __future__ import annotations

import math

#: A tick is late when it comes more than this share of a period after its time.
SHARE = 0.5


class Watch:
    """Counts late ticks.

    Args:
        dt: control period [s].

    Attributes:
        late: how many ticks were late.
        longest: the longest time between two ticks [s].
        longest_tick: the number of the tick before which it was; -1 before the second tick.
        elapsed: from the tick before to the last one [s]; NaN for a first one.
    """

    def __init__(self, dt: float) -> None:
        self._dt = dt
        self.late, self.longest, self.longest_tick = 0, 0.0, -1
        self.elapsed, self._last = math.nan, math.nan

    def forget(self) -> None:
        """Let the next tick be a first one, as after a pause."""
        self._last = math.nan

    def tick(self, k: int, now: float) -> bool:
        """A tick begins; whether it is late.

        Args:
            k: its number.
            now: by a clock that never goes back [s].
        """
        self.elapsed, self._last = now - self._last, now
        if self.elapsed > self.longest:
            self.longest, self.longest_tick = self.elapsed, k
        is_late = self.elapsed > (1.0 + SHARE) * self._dt
        self.late += is_late
        return is_late
