"""The clock of a loop, which may be a user's own and fail in the midst of a session.

A tick needs a time that goes on. Where the clock says none, a period has gone by, as with a loop
that counts ticks; where it was set back, time goes on from where it was.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import suppress

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
        said = self._ask()
        return self._begun - self.ahead if said is None else said

    def tick(self) -> float:
        """The time at a call of the loop's tick [s]."""
        before, seen, said = self.now, self._seen, self._ask()
        self.wrong = self._fault
        if said is None:
            self.now = self._begun + self._dt
            return self.now
        self._seen, self._stood = said, self._stood + 1 if said == seen else 0
        if self._stood >= STANDS:
            self.wrong, self.now = f"the clock stands at {said:.6g} s", before + self._dt
        if self._stood:
            return self.now
        self.now = said + self.ahead
        if said < seen:
            self.wrong = f"the clock went back by {seen - said:.3g} s"
        if said < seen or self.now <= before:  # or more periods were counted than have gone by
            self.now = before + self._dt
            self.ahead = self.now - said
        return self.now

    @property
    def _begun(self) -> float:
        return 0.0 if self.now == -math.inf else self.now

    def _ask(self) -> float | None:
        """A time that tells a period from none; None where there is none, with the reason."""
        self._fault = ""
        try:
            said = self._clock()
        except Exception as error:  # noqa: BLE001 - it is a user's
            self._fault = f"the clock {raised(error)}"
            return None
        found = as_time(said)
        if found is not None and abs(found) < self._most:
            return found
        words = f"a {type(said).__name__}"
        with suppress(Exception):  # an object may not say what it is
            words = f"{said!r:.60}"
        self._fault = f"the clock says {words}, needs seconds"
        return None
