"""Whether the loop goes on: who has stopped it, and what it has waited for in vain.

Signal handlers and other threads may tell it to stop, to end and to go on, in the midst of a tick.
Each of them writes one reference, which Python does in one step, and needs no lock; a tick looks
once, at its beginning. The first Ctrl-C or SIGTERM ends it at rest, the second at once.
"""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable
from types import FrameType
from typing import Any

from coopqp.solver import Status


class Stops:
    """Stops and their reasons.

    Attributes:
        why: for this tick, why it stands still until :meth:`resume`; empty while it goes on.
        goes_on_again: whether it was stopped and has not gone on yet.
        by_itself: whether nobody has told it to stop.
    """

    def __init__(self, patience: float) -> None:
        self._patience = patience
        self.forget()

    def forget(self) -> None:
        """Begin anew."""
        self.why, self.goes_on_again, self.by_itself = "", False, False
        self._stopped = self._ended = ""
        self._resumed = False
        self._wrong_since: float | None = None

    @property
    def ends(self) -> bool:
        """Whether it stands still for good."""
        return bool(self._ended)

    @property
    def told(self) -> str:
        """Why it shall stand still, as last told; empty where it shall go on."""
        return self._ended or self._stopped

    @property
    def cause(self) -> Status | None:
        """Why it does not go on in this tick, as a status."""
        return Status.STOPPED if self.why else None

    def stop(self, why: Any) -> None:
        """Stop; the first reason counts."""
        self._stopped = self._stopped or reason(why, "it was told to stop")

    def end(self, why: Any) -> None:
        """Stop for good; the first reason counts."""
        self._ended = self._ended or reason(why, "it was told to end")

    def resume(self) -> None:
        """Go on, unless it has ended."""
        if self.told and not self.ends:
            self._resumed, self._stopped = True, ""

    def look(self) -> bool:
        """A tick begins; whether it was told to go on since the last."""
        self.why, resumed = self.told, self._resumed
        if resumed:
            self._resumed, self._wrong_since = False, None
            self.goes_on_again, self.by_itself = True, False
        return resumed

    def halt(self, why: str) -> None:
        """Stop in this tick, by itself; the first reason counts."""
        self.by_itself = self.by_itself or not self.told
        self.stop(why)
        self.why = self.told

    def heard(self, wrong: Status | None, now: float, elapsed: float) -> None:
        """Lose patience where that is due."""
        if elapsed > self._patience:
            self.halt(f"no tick came for {elapsed:.3g} s")
        if wrong is None:
            self._wrong_since = None
        elif self._wrong_since is None:
            self._wrong_since = now
        elif now - self._wrong_since >= self._patience:
            self.halt(f"for {now - self._wrong_since:.3g} s {_WORDS[wrong]}")


_WORDS = {
    Status.ROBOT_SILENT: "the robot has not said where it is",
    Status.NOT_MEASURED: "the measured joints were no numbers",
    Status.MEASURED_JUMPED: "the measured joints were elsewhere",
}


def reason(why: Any, otherwise: str) -> str:
    """A reason in words, whatever was given: a robot must stop for any, and for none."""
    try:
        return ("" if why is None else str(why).strip()) or otherwise
    except Exception:  # noqa: BLE001 - an object of a user's may not say what it is
        return otherwise


#: What ends a loop, and what it is called.
NAMES = {signal.SIGINT: "Ctrl-C", signal.SIGTERM: "SIGTERM"}


class Interrupts:
    """The signals that end a loop while it runs, in the main thread; in others they stay as is."""

    def __init__(self, end: Callable[[str], None]) -> None:
        self._end, self._depth, self._caught = end, 0, False
        self._before: dict[signal.Signals, Any] = {}

    def take(self) -> None:
        """Take them over."""
        self._depth += 1
        if self._depth == 1 and threading.current_thread() is threading.main_thread():
            self._caught = False
            self._before = {number: signal.signal(number, self._catch) for number in NAMES}

    def give_back(self) -> None:
        """Let them be what they were."""
        self._depth -= 1
        if self._depth == 0:
            for number, before in self._before.items():
                signal.signal(number, signal.SIG_DFL if before is None else before)
            self._before = {}

    def _catch(self, number: int, frame: FrameType | None) -> None:
        if self._caught:  # comes out of the tick, so that who runs the loop can stop the robot
            raise KeyboardInterrupt if number == signal.SIGINT else SystemExit(128 + number)
        self._caught = True
        self._end(NAMES[signal.Signals(number)])
