"""Messages of joint states, which may each have some of the joints, as a configuration."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from coopqp.base.spec import Array


class JointStates:
    """Where the joints are.

    Args:
        names: of the joints, in ROS.
        silent_after: what was stamped longer ago is not used [s].

    Attributes:
        wrong: what was wrong with the last message; empty if nothing was.
    """

    def __init__(self, names: Sequence[str], silent_after: float) -> None:
        self._names, self._silent_after = tuple(names), silent_after
        self._places = {name: i for i, name in enumerate(names)}
        self._q = np.full(len(names), np.nan)
        self._sent = np.full(len(names), -np.inf)
        self._new = np.zeros(len(names), bool)
        self.wrong = ""

    def take(self, message: Any, sent: float | None, now: float) -> None:
        """A message has come.

        Args:
            message: sensor_msgs/JointState.
            sent: when it was stamped [s]; None where it was not.
            now: when it came [s]; what is stamped later was sent now.
        """
        sent = now if sent is None else min(sent, now)
        names, positions = list(message.name), np.asarray(message.position, float)
        self.wrong = ""
        if len(names) != len(positions):
            self.wrong = f"{len(names)} names and {len(positions)} positions in a message"
            return
        if now - sent > self._silent_after:
            clocks = "are the clocks of both machines in step?"
            self.wrong = f"stamped {now - sent:.3g} s before they came; {clocks}"
            return
        for name, position in zip(names, positions, strict=True):
            i = self._places.get(name)
            if i is None:
                continue
            if sent < self._sent[i]:
                self.wrong = f"{name} is older than the last, by {self._sent[i] - sent:.3g} s"
                continue
            self._q[i], self._sent[i], self._new[i] = position, sent, True

    def read(self) -> Array | None:
        """All joints, once each of them has been told of anew; shape (n,)."""
        if not self._new.all():
            return None
        self._new[:] = False
        return self._q.copy()

    def silence(self, now: float) -> str:
        """Who has said nothing for too long, as a sentence; empty while all is well.

        Args:
            now: [s].
        """
        age = now - self._sent
        silent = age > self._silent_after
        if not silent.any():
            return ""
        never = [name for name, a in zip(self._names, age, strict=True) if np.isinf(a)]
        if never:
            return f"nothing has come of {_some(never)}"
        old = [name for name, a in zip(self._names, silent, strict=True) if a]
        return f"nothing has come for {age.max():.3g} s of {_some(old)}"


def _some(names: Sequence[str]) -> str:
    more = f" and {len(names) - 3} more" if len(names) > 3 else ""
    return ", ".join(names[:3]) + more
