"""Ctrl-C and SIGTERM, told to the loop: the first ends it at rest, the second at once."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable
from types import FrameType
from typing import Any

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
