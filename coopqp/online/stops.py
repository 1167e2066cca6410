"""The time of a tick, whether it is late or early, and whether the loop goes on.

A tick needs a time that goes on, and the clock may be a user's own and fail in the midst of a
session. Where it says none, a period has gone by, as with a loop that counts ticks; where it was
set back, time goes on from where it was.

Signal handlers and other threads may stop, end and resume it in the midst of a tick. Each of them
writes one reference, which is atomic in Python and needs no lock; a tick reads once, at its
beginning. The first Ctrl-C or SIGTERM ends it at rest, the second at once.
"""

import math
import signal
import threading
from collections.abc import Callable, Mapping
from contextlib import suppress
from types import FrameType
from typing import Any

from coopqp.base.wording import raised
from coopqp.online.arrivals import as_time
from coopqp.solver import EPSILON, Status

#: A tick is late, or early, by more than this share of a period.
SHARE = 0.5
#: The caller's clock may be faster by this share.
CLOCK_FASTER = 0.02

Clock = Callable[[], float]
"""Seconds, by a clock that never goes back."""

#: In so many calls of a tick a clock may say the same time: an early call comes at any time.
STANDS = 2
#: A clock's last digit must be less than this share of a period.
FINE = 0.01
#: So much of the patience is all of it: what is waited for is a sum of periods, which is rounded.
ALL = 0.999


class LoopTime:
    """Time that goes on, by a clock that may not.

    Attributes:
        now: of this tick; what the clock says until it has gone back [s].
        ahead: by how much that is ahead of the clock [s].
        wrong: what is wrong with the clock in this tick, a sentence; empty if nothing is.
    """

    def __init__(self, clock: Clock, dt: float) -> None:
        self._clock, self._dt = clock, dt
        self._latest = FINE * dt / EPSILON  # beyond it a period is too small a part of the time
        self.forget()

    def forget(self) -> None:
        self.now = self._before = -math.inf  # of this tick, and by the clock at the last one
        self.ahead, self._stood, self.wrong, self._fault = 0.0, 0, "", ""

    def read(self) -> float:
        time = self._read_clock()
        return self._begun - self.ahead if time is None else time

    def tick(self) -> float:
        now, before, time = self.now, self._before, self._read_clock()
        self.wrong = self._fault
        if time is None:
            self.now = self._begun + self._dt
            return self.now
        self._before, self._stood = time, self._stood + 1 if time == before else 0
        if self._stood >= STANDS:
            self.wrong, self.now = f"the clock stands at {time:.6g} s", now + self._dt
        if self._stood:
            return self.now
        self.now = time + self.ahead
        if time < before:
            self.wrong = f"the clock went back by {before - time:.3g} s"
        if time < before or self.now <= now:  # or more periods were counted than have gone by
            self.now = now + self._dt
            self.ahead = self.now - time
        return self.now

    @property
    def _begun(self) -> float:
        return 0.0 if self.now == -math.inf else self.now

    def _read_clock(self) -> float | None:
        """A time that tells a period from none; None where there is none, with the reason."""
        self._fault = ""
        try:
            reading = self._clock()
        except Exception as error:  # noqa: BLE001 - it is a user's
            self._fault = f"the clock {raised(error)}"
            return None
        time = reading if type(reading) is float else as_time(reading)
        if time is not None and abs(time) < self._latest:
            return time
        shown = f"a {type(reading).__name__}"
        with suppress(Exception):  # an object may not say what it is
            shown = f"{reading!r:.60}"
        self._fault = f"the clock says {shown}, needs seconds"
        return None


class Watch:
    """Counts late and early ticks.

    Early calls are no ticks: each command is for a whole period, so two in one ask for twice the
    speed. The earliest time of a tick advances by a period with each, so that ticks which come a
    little early again and again do not add up.

    Attributes:
        longest: the longest time between two ticks [s].
        longest_tick: the number of the tick after it; -1 before the second tick.
        elapsed: from the tick before to the last one [s]; NaN for a first one.
        began: start of the last tick that was not early [s].
    """

    def __init__(self, dt: float) -> None:
        self._dt = dt
        self.late, self.early, self.longest, self.longest_tick = 0, 0, 0.0, -1
        self.elapsed, self._last = math.nan, math.nan
        self.began = self._since = -math.inf
        self._held = False

    def __repr__(self) -> str:
        slow = f"longest={self.longest:.6f}, longest_tick={self.longest_tick}"
        return f"Watch(late={self.late}, early={self.early}, {slow})"

    def forget(self) -> None:
        self._last = math.nan

    def left(self, now: float) -> float:
        """The rest of the period [s]; zero if a tick may come."""
        if not now < self._since:
            return 0.0
        self.early += 1
        self._held = True
        return self.began + self._dt - now

    def tick(self, k: int, now: float) -> bool:
        """A tick begins; whether it is late."""
        self.elapsed, self._last, self.began = now - self._last, now, now
        behind = now - (SHARE - CLOCK_FASTER) * self._dt
        self._since = max(self._since, behind) + (1.0 - CLOCK_FASTER) * self._dt  # earliest next
        if self.elapsed > self.longest:
            self.longest, self.longest_tick = self.elapsed, k
        # After an early call the next tick is due a period later.
        is_late = self.elapsed > (1.0 + SHARE + self._held) * self._dt
        self._held = False
        self.late += is_late
        return is_late


class Waiting:
    """A reading and inputs of early calls, for the next tick; of several the last counts."""

    def __init__(self) -> None:
        self.forget()

    def forget(self) -> None:
        self._q: Any = None
        self._inputs: dict[Any, Any] = {}

    def keep(self, q: Any, inputs: Any) -> None:
        if q is not None:
            self._q = q
        if isinstance(inputs, Mapping):
            with suppress(Exception):  # a class of a user's may fail
                self._inputs.update(inputs)

    def take(self, q: Any, inputs: Any) -> tuple[Any, Any]:
        """What a tick is given, completed by what was kept."""
        waited, values = self._q, self._inputs
        if waited is None and not values:
            return q, inputs
        self.forget()
        if inputs is None or isinstance(inputs, Mapping):
            inputs = {**values, **(inputs or {})}
        return waited if q is None else q, inputs


class Stops:
    """Stops and their reasons.

    Attributes:
        why: for this tick, why it stands still until :meth:`resume`; empty while it goes on.
        goes_on_again: whether it was resumed and has not gone on yet.
        by_itself: whether it stopped without a request.
    """

    def __init__(self, patience: float) -> None:
        self._patience = patience
        self.forget()

    def forget(self) -> None:
        self.why, self.goes_on_again, self.by_itself = "", False, False
        self._stopped = self.ended = ""
        self._resumed = False
        self._wrong_since: float | None = None

    @property
    def requested(self) -> str:
        """The reason of the last request to stop or end; empty where it shall go on."""
        return self.ended or self._stopped

    def stop(self, why: Any) -> None:
        """Stop; the first reason counts."""
        self._stopped = self._stopped or reason(why, "it was told to stop")

    def end(self, why: Any) -> None:
        """Stop for good; the first reason counts."""
        self.ended = self.ended or reason(why, "it was told to end")

    def resume(self) -> None:
        if self._stopped and not self.ended:
            self._resumed, self._stopped = True, ""

    def look(self) -> bool:
        """A tick begins; whether :meth:`resume` was called since the last."""
        self.why, resumed = self.requested, self._resumed
        if resumed:
            self._resumed, self._wrong_since = False, None
            self.goes_on_again, self.by_itself = True, False
        return resumed

    def halt(self, why: str) -> None:
        """Stop in this tick, without a request; the first reason counts."""
        self.by_itself = self.by_itself or not self.requested
        self.stop(why)
        self.why = self.requested

    def wait(self, wrong: Status | None, now: float, elapsed: float) -> None:
        """Stop after too long a time without a tick, or without a measurement."""
        if elapsed > self._patience:
            self.halt(f"no tick came for {elapsed:.3g} s")
        if wrong is None:
            self._wrong_since = None
        elif self._wrong_since is None:
            self._wrong_since = now
        elif now - self._wrong_since >= ALL * self._patience:
            self.halt(f"for {now - self._wrong_since:.3g} s {_MISSING[wrong]}")


_MISSING = {
    Status.ROBOT_SILENT: "the robot has not said where it is",
    Status.NOT_MEASURED: "the measured joints were no numbers",
    Status.MEASURED_JUMPED: "the measured joints were elsewhere",
    Status.CLOCK_WRONG: "the clock did not say the time",
}


def reason(why: Any, otherwise: str) -> str:
    """A reason in words, whatever was given: a robot must stop for any object."""
    try:
        return ("" if why is None else str(why).strip()) or otherwise
    except Exception:  # noqa: BLE001 - an object of a user's may not say what it is
        return otherwise


#: Signals that end a loop, and their names in messages.
NAMES = {signal.SIGINT: "Ctrl-C", signal.SIGTERM: "SIGTERM"}


class Interrupts:
    """Handlers of the signals that end a loop while it runs in the main thread."""

    def __init__(self, end: Callable[[str], None]) -> None:
        self._end, self._depth, self._caught = end, 0, False
        self._before: dict[signal.Signals, Any] = {}

    def take(self) -> None:
        self._depth += 1
        if self._depth == 1 and threading.current_thread() is threading.main_thread():
            self._caught = False
            self._before = {number: signal.signal(number, self._catch) for number in NAMES}

    def give_back(self) -> None:
        self._depth -= 1
        if self._depth == 0:
            for number, before in self._before.items():
                signal.signal(number, signal.SIG_DFL if before is None else before)
            self._before = {}

    def _catch(self, number: int, frame: FrameType | None) -> None:
        if self._caught:  # is raised in the tick, so that the caller can stop the robot
            raise KeyboardInterrupt if number == signal.SIGINT else SystemExit(128 + number)
        self._caught = True
        self._end(NAMES[signal.Signals(number)])
