"""Who hands the loop's ticks and inputs to what keeps them, and lets no fault of it out."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Literal, Protocol

from coopqp.checked import Array
from coopqp.controller import Command
from coopqp.input import Arrival
from coopqp.online.session import Session
from coopqp.phase_run import PhaseRun
from coopqp.scenario.scenario import Scenario
from coopqp.state import State

#: So much of a session is kept in memory before it is written by a tick itself [s].
AT_MOST = 1.0


class Record(Protocol):
    """Takes down ticks; raises nothing and waits for nothing."""

    def tick(
        self, state: State, command: Command, us: float, also: Array | Sequence[float] = ()
    ) -> None:
        """Take down a tick, as :meth:`coopqp.online.recording.LiveRecording.tick`."""

    def begin(self, state: State, since: float = 0.0) -> None:
        """Say that the loop goes on from another state than the last tick's, as after a stop."""

    def close(self) -> None:
        """Write the rest and the end."""


class Kept(Protocol):
    """A loop, as it is seen from here."""

    controller: str

    @property
    def scenario(self) -> Scenario: ...
    @property
    def phases(self) -> tuple[PhaseRun, ...]: ...


class Keeper:
    """Session and recording of a loop.

    Attributes:
        session: the files; None where there are none.
        fault: why nothing is kept any more; empty while all is well.
    """

    def __init__(self, loop: Any, out: Path | None, record: Callable[[Any], Record] | None) -> None:
        self._loop: Kept = loop
        self._out, self._make = out, record
        self.session: Session | None = None
        self._record: Record | None = None
        self.fault, self._flushed = "", 0.0

    def begin(self, given: Scenario) -> None:
        """The loop has begun.

        Raises:
            CoopqpError: it cannot be written.
        """
        if self._out is not None:
            self.session = Session(self._out, self._loop.scenario, given, self._loop.controller)
            self._out, self._flushed = None, 0.0
        self._record = self._make(self._loop) if self._make else None

    def go_on(self) -> None:
        """The loop goes on from another state, as after a stop or in another phase."""
        if self._record is not None:
            now, record = self._loop.phases[-1], self._record
            self._safely("_record", lambda: record.begin(now.state, now.since))

    def arrived(self, arrivals: Sequence[Arrival]) -> None:
        """Keep what arrived and was taken; write it when it is much."""
        if self.session is None:
            return
        run = self._loop.phases[-1]
        since, t = run.since, run.state.t
        taken = run.state.inputs.arrived
        for name, value, _ in arrivals:
            if name in taken:
                kind = run.inputs.channels[name].kind
                self.session.add(name, kind, since + t, since + taken[name][0], value)
        if since + t - self._flushed > AT_MOST:
            self.flush()

    def tick(self, state: State, command: Command, us: float) -> None:
        """Hand a tick to the recording."""
        record = self._record
        if record is not None:
            self._safely("_record", lambda: record.tick(state, command, us))

    def flush(self) -> None:
        """Write what is new of the session."""
        if self.session is None or not self._loop.phases:
            return
        run, session = self._loop.phases[-1], self.session
        now = self._flushed = run.since + run.state.t
        self._safely("session", lambda: session.flush(now, self._loop.phases))

    def close(self) -> None:
        """Write the rest of all."""
        if self._record is not None:
            self._safely("_record", self._record.close)
            self._record = None
        if self.session is not None:
            session, self.session = self.session, None
            self._safely("session", lambda: session.close(self._loop.phases))

    def _safely(self, whose: Literal["session", "_record"], write: Callable[[], None]) -> None:
        try:
            write()
        except Exception as error:  # noqa: BLE001 - the robot comes before its record
            self.fault = f"the record is not whole: {error}"
            setattr(self, whose, None)
