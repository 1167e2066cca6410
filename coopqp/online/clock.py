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
from coopqp.solver import EPSILON

Clock = Callable[[], float]
"""Seconds, by a clock that never goes back."""

#: In so many calls of a tick a clock may say the same time: an early call comes at any time.
STANDS = 2
#: A clock's last digit must be less than this share of a period.
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
        self._most = FINE * dt / EPSILON
        self.forget()

    def forget(self) -> None:
        """Begin anew with whatever the clock says next."""
        self.now = self._seen = -math.inf
        self.ahead, self._stood, self.wrong, self._fault = 0.0, 0, "", ""

    def read(self) -> float:
        """What the clock says [s], or would if it was right."""
        said = self._usable(self._ask())
        return self._begun(self.now) - self.ahead if said is None else said

    def tick(self) -> float:
        """The time at a call of the loop's tick [s]."""
        said = self._ask()
        if type(said) is float and self._seen < said < self._most and said + self.ahead > self.now:
            self._stood, self._seen, self.now, self.wrong = 0, said, said + self.ahead, ""
            return self.now
        return self._judge(self._usable(said))

    def _judge(self, said: float | None) -> float:
        before, self.wrong = self.now, self._fault if said is None else ""
        if said is None:
            self.now = self._begun(before) + self._dt
        elif said > self._seen:
            self._stood, self._seen, self.now = 0, said, said + self.ahead
            if self.now <= before:  # more periods were counted than have gone by
                self._set_back(said, before)
        elif said < self._seen:
            self.wrong = f"the clock went back by {self._seen - said:.3g} s"
            self._stood, self._seen = 0, said
            self._set_back(said, before)
        else:
            self._stood += 1
            if self._stood >= STANDS:
                self.wrong = f"the clock stands at {said:.6g} s"
                self.now = before + self._dt
        return self.now

    def _set_back(self, said: float, before: float) -> None:
        """Go on from where the time was: a period has gone by, for all that is known."""
        self.now = before + self._dt
        self.ahead = self.now - said

    @staticmethod
    def _begun(now: float) -> float:
        return 0.0 if now == -math.inf else now

    def _ask(self) -> Any:
        self._fault = ""
        try:
            return self._clock()
        except Exception as error:  # noqa: BLE001 - it is a user's
            self._fault = f"the clock {raised(error)}"
            return None

    def _usable(self, said: Any) -> float | None:
        """A time that tells a period from none; None where there is none, with the reason."""
        found = as_time(said)
        if found is not None and abs(found) < self._most:
            return found
        self._fault = self._fault or f"the clock says {_shown(said)}, needs seconds"
        return None


def _shown(said: Any) -> str:
    try:
        return f"{said!r:.60}"
    except Exception:  # noqa: BLE001 - an object may not say what it is
        return f"a {type(said).__name__}"
