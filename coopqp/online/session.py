"""A session on disk, so that it can be played again: its scenario, and what arrived at its inputs.

    OUT/scenario.yaml        the scenario, begun where the robot was, fed from the files
    OUT/inputs/NAME.csv      t: of the tick for which it arrived; sent: when; the value's columns

``coopqp compare OUT/scenario.yaml`` plays it again, for the same law or for others. With the same
law on the same plant the joints are equal bit for bit, if nothing came in between: no stop, no
silence.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

from coopqp.checked import Array
from coopqp.errors import CoopqpError
from coopqp.online.played_again import played_again, scenario_text
from coopqp.phase_run import PhaseRun
from coopqp.recordings.sent import FOLDER, Sent, file_name
from coopqp.scenario.scenario import Scenario
from coopqp.signal import Kind


class _File(Sent):
    """A file that grows."""

    def __init__(self, path: Path, kind: Kind) -> None:
        super().__init__(kind)
        self.path, self.written = path, False

    def flush(self, now: float) -> None:
        """Write all rows before a time, after which no other can have their times [s]."""
        if not (lines := self.take(now)):
            return
        whole = self.path.stat().st_size if self.written else 0
        try:
            with self.path.open("a", encoding="utf-8") as file:
                file.write(lines if self.written else self.header + lines)
        except OSError:
            with suppress(OSError):  # a row that is torn would make all of them unreadable
                os.truncate(self.path, whole)
            raise
        self.written = True


class Session:
    """The files of a session.

    Raises:
        CoopqpError: there is a session already, or it cannot be written.
    """

    def __init__(self, folder: Path, scenario: Scenario, given: Scenario, controller: str) -> None:
        self._folder, self._scenario, self._given = Path(folder), scenario, given
        self._controller = controller
        self._sent: dict[str, _File] = {}
        try:
            if (self._folder / "scenario.yaml").exists() or (self._folder / FOLDER).exists():
                raise CoopqpError(f"'{folder}' holds a session already; name another folder")
            (self._folder / FOLDER).mkdir(parents=True)
            self._write_scenario(())
        except OSError as error:
            raise CoopqpError(f"cannot write to '{folder}': {error.strerror or error}") from error

    def add(self, name: str, kind: Kind, t: float, sent: float, value: Array) -> None:
        """Keep what arrived at an input."""
        if name not in self._sent:
            file = file_name(name, {sent.path.name for sent in self._sent.values()})
            self._sent[name] = _File(self._folder / FOLDER / file, kind)
        self._sent[name].add(t, sent, value)

    def flush(self, now: float, phases: Sequence[PhaseRun]) -> None:
        """Write what is new.

        Raises:
            OSError: the disk is full, or gone.
        """
        before = {name for name, sent in self._sent.items() if sent.written}
        for sent in self._sent.values():
            sent.flush(now)
        if before != {name for name, sent in self._sent.items() if sent.written}:
            self._write_scenario(phases)

    def close(self, phases: Sequence[PhaseRun]) -> None:
        """Write the rest, and how long the phases were.

        Raises:
            OSError: the disk is full, or gone.
        """
        self.flush(float("inf"), phases)
        self._write_scenario(phases)

    def replay(self, phases: Sequence[PhaseRun]) -> Scenario:
        """The scenario that plays what is on disk again."""
        return played_again(self._scenario, phases, self._feeds())

    def _feeds(self) -> dict[str, Path]:
        return {name: sent.path for name, sent in self._sent.items() if sent.written}

    def _write_scenario(self, phases: Sequence[PhaseRun]) -> None:
        if not self._scenario.source:
            return  # it was made in Python; who plays it again has it there
        text = scenario_text(
            self._scenario, self._given, self._controller, phases, self._feeds(), self._folder
        )
        path = self._folder / "scenario.yaml"
        fresh = path.with_suffix(".new")
        fresh.write_text(text, encoding="utf-8")
        fresh.replace(path)
