"""The clock of a loop, which may be a user's own and fail in the midst of a session.

A tick needs a time that goes on. Where the clock says none, a period has gone by, as with a loop
that counts ticks; where it was set back, time goes on from where it was.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from coopqp.base.wording import raised
from coopqp.online.arrivals import as_time

Clock = Callable[[], float]
"""Seconds, by a clock that never goes back."""

#: In so many calls of a tick a clock may say the same time: an early call comes at any time.
STANDS = 2
#: A clock must tell this share of a period from none.
FINE = 0.01


class LoopTime:
    """Time that goes on, by a clock that may not.

    Args:
        clock: of a user's.
        dt: period [s].

    Attributes:
        now: of this tick; what the clock says until it has gone back [s].
        ahead: by how much that is ahead of the clock [s].
        wrong: what is wrong with the clock in this tick, a sentence; empty if nothing is.
    """

    def __init__(self, clock: Clock, dt: float) -> None:
        self._clock, self._dt = clock, dt
        self.forget()

    def forget(self) -> None:
        """Begin anew with whatever the clock says next."""
        self.now = self._seen = -math.inf
        self.ahead, self._stood, self.wrong, self._fault = 0.0, 0, "", ""

    def read(self) -> float:
        """What the clock says [s], or would if it was right."""
        said = self._ask()
        return said if said == said else self._begun(self.now) - self.ahead

    def tick(self) -> float:
        """The time at a call of the loop's tick [s]."""
        said, before, self.wrong = self._ask(), self.now, ""
        if said > self._seen:
            self._stood, self._seen, self.now = 0, said, said + self.ahead
            if self.now <= before:  # more periods were counted than have gone by
                self._set_back(said, before)
            return self.now
        if said == self._seen:
            self._stood += 1
            if self._stood < STANDS:
                return before
            self.wrong = f"the clock stands at {said:.6g} s"
        elif said < self._seen:
            self.wrong = f"the clock went back by {self._seen - said:.3g} s"
            self._stood, self._seen = 0, said
            self._set_back(said, before)
            return self.now
        else:
            self.wrong = self._fault
        self.now = self._begun(before) + self._dt
        return self.now

    def _set_back(self, said: float, before: float) -> None:
        """Go on from where the time was: a period has gone by, for all that is known."""
        self.now = before + self._dt
        self.ahead = self.now - said

    @staticmethod
    def _begun(now: float) -> float:
        return max(now, 0.0) if now == -math.inf else now

    def _ask(self) -> float:
        """A usable time; NaN where there is none, with the reason."""
        try:
            said: Any = self._clock()
        except Exception as error:  # noqa: BLE001 - it is a user's
            self._fault = f"the clock {raised(error)}"
            return math.nan
        found = said if type(said) is float else as_time(said)
        if found is not None and found + FINE * self._dt > found:
            return float(found)
        self._fault = f"the clock says {_shown(said)}, needs seconds"
        return math.nan


def _shown(said: Any) -> str:
    try:
        return f"{said!r:.60}"
    except Exception:  # noqa: BLE001 - an object may not say what it is
        return f"a {type(said).__name__}"
