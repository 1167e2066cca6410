"""Ctrl-C, told to the loop: the first one ends it at rest, the second one ends it at once."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable
from types import FrameType
from typing import Any


class Interrupts:
    """SIGINT while a loop runs, in the main thread; in others it stays as it is.

    Args:
        end: told why.
    """

    def __init__(self, end: Callable[[str], None]) -> None:
        self._end, self._depth = end, 0
        self._before: Any = None

    def take(self) -> None:
        """Take SIGINT over."""
        self._depth += 1
        if self._depth == 1 and threading.current_thread() is threading.main_thread():
            self._before = signal.signal(signal.SIGINT, self._caught)

    def give_back(self) -> None:
        """Let SIGINT be what it was."""
        self._depth -= 1
        if self._depth == 0 and self._before is not None:
            signal.signal(signal.SIGINT, self._before)
            self._before = None

    def _caught(self, number: int, frame: FrameType | None) -> None:
        self._end("Ctrl-C")
        signal.signal(signal.SIGINT, signal.default_int_handler)
