"""Whether the loop goes on: who has stopped it, and what it has waited for in vain."""

from __future__ import annotations

from coopqp.solver import Status


class Stops:
    """Stops and their reasons.

    Args:
        patience: time without a usable measurement, or without a tick, after which it stops [s].

    Attributes:
        why: it stands still until :meth:`resume`; empty while it goes on.
        ends: whether it stands still for good.
        goes_on_again: whether it was stopped and has not gone on yet.
    """

    def __init__(self, patience: float) -> None:
        self._patience = patience
        self.forget()

    def forget(self) -> None:
        """Begin anew."""
        self.why, self.ends, self.goes_on_again = "", False, False
        self._wrong_since: float | None = None

    @property
    def cause(self) -> Status | None:
        """Why it does not go on, as a status."""
        return Status.STOPPED if self.why else None

    def stop(self, why: str) -> None:
        """Stop; the first reason counts."""
        self.why = self.why or why

    def end(self, why: str) -> None:
        """Stop for good."""
        self.why, self.ends = (self.why if self.ends else why), True

    def resume(self) -> None:
        """Go on, unless it has ended."""
        if self.why and not self.ends:
            self.why, self.goes_on_again, self._wrong_since = "", True, None

    def heard(self, wrong: Status | None, now: float, elapsed: float) -> None:
        """Lose patience where that is due.

        Args:
            wrong: what is wrong with the measurement.
            now: [s].
            elapsed: since the tick before [s]; NaN for a first one.
        """
        if elapsed > self._patience:
            self.stop(f"no tick came for {elapsed:.3g} s")
        if wrong is None:
            self._wrong_since = None
        elif self._wrong_since is None:
            self._wrong_since = now
        elif now - self._wrong_since >= self._patience:
            self.stop(f"for {now - self._wrong_since:.3g} s {_WORDS[wrong]}")


_WORDS = {
    Status.ROBOT_SILENT: "the robot has not said where it is",
    Status.NOT_MEASURED: "the measured joints were no numbers",
    Status.MEASURED_JUMPED: "the measured joints were elsewhere",
}
