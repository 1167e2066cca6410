"""What is given to a tick of the loop as inputs, with its times by the loop's clock.

The loop's time stands still while it comes to rest, and waits for late ticks. Values are stamped by
a clock that does neither, so their age is what counts: sent = t - age.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping
from numbers import Real
from typing import Any

from coopqp.checked import real
from coopqp.errors import unknown_name
from coopqp.input import AHEAD, Arrival, Inputs
from coopqp.signal import Kind, matrix

#: So many unknown names are remembered, to speak of each but once.
MOST_NAMES = 100


class Arrivals:
    """From a mapping of the user's to arrivals.

    Args:
        names: of all inputs of the scenario; what no task of this phase follows is let pass.
        since: when the phase began, in the time of the whole session [s].

    Attributes:
        refused: what was wrong with the mapping of the last tick, a sentence each.
    """

    def __init__(self, inputs: Inputs, names: Collection[str], since: float) -> None:
        self._inputs, self._names, self._since = inputs, names, since
        self._stamped: dict[str, float] = {}
        self._sent: dict[str, float] = {}
        self._strange: set[str] = set()
        self.refused: list[str] = []

    def read(self, given: Any, t: float, now: float) -> list[Arrival]:
        """The arrivals of a tick.

        Args:
            given: by name a value, or a value and when it was sent by the loop's clock [s]; or
                nothing.
            t: the loop's time [s].
            now: by its clock [s].
        """
        self.refused = []
        if given is None:
            return []
        if not isinstance(given, Mapping):
            self.refused = [f"inputs: found a {type(given).__name__}, needs values by name"]
            return []
        return list(self._read(given, t, now))

    def _read(self, given: Mapping[Any, Any], t: float, now: float) -> Iterator[Arrival]:
        for name, value in given.items():
            channel = self._inputs.channels.get(name)
            if channel is None:
                self._say_unknown(str(name))
                continue
            if not _is_stamped(value):
                self._stamped[name] = now  # it is sent when it arrives
                yield name, in_columns(channel.kind, value), self._shared(name, t)
                continue
            value, stamp = value
            why = self._wrong_stamp(name, stamp, now)
            if why:
                self.refused.append(f"{name}: {why}")
                continue
            # A tick that was late must not make a later value the older one.
            sent = max(t - (now - float(stamp)), self._sent.get(name, -math.inf))
            self._stamped[name] = float(stamp)
            yield name, in_columns(channel.kind, value), self._shared(name, min(sent, t))

    def age(self, time: float) -> None:
        """Let what has arrived be older by a time that the loop's own time does not know of [s]."""
        for channel in self._inputs.channels.values():
            channel.sent -= time

    def _shared(self, name: str, t: float) -> float:
        """The time as who plays the session again comes to know it, to the last digit."""
        self._sent[name] = (self._since + t) - self._since
        return self._sent[name]

    def _wrong_stamp(self, name: str, stamp: Any, now: float) -> str:
        if not isinstance(stamp, Real) or not math.isfinite(float(stamp)):
            return "needs a value, or a value and when it was sent [s]"
        stamp = float(stamp)
        if stamp > now + AHEAD:
            return f"is from the future, sent at {stamp:.3f} s and it is {now:.3f} s"
        last = self._stamped.get(name, -math.inf)
        if stamp < last:
            return f"is older than the last, sent at {stamp:.3f} s after {last:.3f} s"
        return ""

    def _say_unknown(self, name: str) -> None:
        new = name not in self._strange and len(self._strange) < MOST_NAMES
        if new and name not in self._names:
            self._strange.add(name)
            self.refused.append(unknown_name("input", name, self._names))


def in_columns(kind: Kind, value: Any) -> Any:
    """A value as the columns of a file have it, so that who reads them takes the same for it.

    What cannot be one is left as it is, for the input to refuse.
    """
    try:
        found = real(value)
        if found.shape == (len(kind.columns),):
            return found
    except (TypeError, ValueError):
        pass
    try:
        read = kind.read(value)
    except Exception:  # noqa: BLE001 - anything can arrive
        return value
    return matrix(read)[:, 2] if kind.axis else read


def _is_stamped(value: Any) -> bool:
    """Whether it is a value and when it was sent; two numbers are a value."""
    return isinstance(value, tuple) and len(value) == 2 and not isinstance(value[0], Real)
