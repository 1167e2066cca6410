"""A recording of a loop while it runs, in pieces: whoever kills the process loses the last of them.

    with LiveRecording(path, scenario, law, state, controller="qp") as recording:
        while True:
            command = law.tick(state)
            recording.tick(state, command, us)  # before the state goes on
            ...

A tick copies numbers into a ring that was there before the first one, and does nothing else. Every
``EVERY`` seconds a thread adds what is new to the file, as one piece of Arrow's IPC stream, which
is done without Python's lock but for a moment. Nothing waits: where the disk does not keep up, the
ring fills, and ticks that find no room are left out and counted.

The columns are those of ``trace.csv`` from which a tick is done again. Nobody knows the truth of a
real robot: ``q`` is what the tick decided from, and the object is where q has it; ``measured`` is
what the sensors said. What was made of the inputs is in it, too.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from types import TracebackType
from typing import Any

from coopqp.checked import Array
from coopqp.controller import Command, Law
from coopqp.errors import CoopqpError, InvalidValueError
from coopqp.online.ring import TickRing
from coopqp.recordings.column import kind_of
from coopqp.recordings.format import needs
from coopqp.recordings.parquet import SUFFIX, arrow_schema
from coopqp.scenario.scenario import Scenario
from coopqp.solver import written
from coopqp.state import State

#: Seconds between pieces, so that a crash loses less than one.
EVERY = 0.25
#: Seconds of ticks that the ring holds, for disks that are slow for a while.
ROOM = 8.0


class LiveRecording:
    """A file that grows while a loop runs.

    Args:
        path: of the file, ``NAME.arrows``; must not exist.
        scenario: whose joints and tasks they are.
        law: whose ticks, of the first phase.
        start: the state before the first tick. Where it has measured joints, all ticks have.
        controller: the law's name in the scenario.
        source: the scenario's text, with which ticks are done again; what it was read from if
            omitted.
        also: names of further columns, such as ``input[hand].x``; all numbers, NaN is nothing.
        memory: how many numbers the laws remember at most, where later ones remember more.
        every: seconds between pieces; 0 without a thread: whoever ticks calls :meth:`flush`.

    Attributes:
        path: of the file.
        fault: why it could not be written on, as a sentence; empty while all is well.

    Raises:
        CoopqpError: the file exists, or cannot be made.
        InvalidValueError: another ending than ``.arrows``; a scenario without a text; a further
            column whose name is taken.
        MissingDependencyError: pyarrow is not installed.
    """

    def __init__(
        self,
        path: Path,
        scenario: Scenario,
        law: Law,
        start: State,
        *,
        controller: str,
        source: str = "",
        also: Sequence[str] = (),
        memory: int = 0,
        every: float = EVERY,
    ) -> None:
        self.path, self.fault, held = Path(path), "", scenario.held_by(controller)
        room, inputs = max(16, int(ROOM / law.problem.dt)), held.followed()
        self._ring = TickRing(law, start, also, room, memory, inputs)
        columns = ("controller", "tick", *self._ring.names, "status")
        text = source or scenario.portable
        _check(self.path, text, columns, also)
        with needs("a recording of a live loop"):
            import pyarrow as pa
        self._pa: Any = pa
        self._schema = arrow_schema(held, controller, text, columns)
        names = pa.array([controller] * self._ring.capacity)
        self._batch = pa.record_batch(  # over the ring's own memory, but for names and statuses
            [names, self._ring.numbered, *self._ring.numbers, names], schema=self._schema
        )
        self._alone, self._stop = threading.Lock(), threading.Event()
        self._open()
        self._thread = threading.Thread(target=self._run, args=(every,), daemon=True)
        if every > 0.0:
            self._thread.start()

    @property
    def dropped(self) -> int:
        """How many ticks were left out because the disk did not keep up."""
        return self._ring.dropped

    def tick(
        self, state: State, command: Command, us: float, also: Array | Sequence[float] = ()
    ) -> None:
        """Take down a tick; raises nothing and waits for nothing.

        Args:
            state: as the law left it, before it goes on.
            command: the law's.
            us: how long the law took [us].
            also: the further columns' numbers.
        """
        self._ring.add(state, command, us, also)

    def begin(self, state: State, since: float = 0.0) -> None:
        """Say that the loop goes on from another state than the last tick's, as after a stop.

        Args:
            state: before its first tick.
            since: when its own time began, as in a later phase [s].
        """
        self._ring.begin(state, since)

    def flush(self) -> None:
        """Write what is new; a thread does it by itself."""
        if self.fault:
            return
        with self._alone:
            try:
                for piece in self._ring.waiting():
                    self._write(piece)
                    self._ring.emptied += piece.stop - piece.start
                os.fsync(self._file.fileno())
            except (OSError, self._pa.ArrowException) as error:
                self.fault = f"cannot write '{self.path}': {error}"

    def close(self) -> None:
        """Write the rest and the end.

        Raises:
            CoopqpError: something could not be written.
        """
        self._stop.set()
        if self._thread.is_alive():
            self._thread.join()
        if self._file.closed:
            return
        self.flush()
        if not self.fault:
            self._stream.close()
        self._file.close()
        if self.fault:
            raise CoopqpError(self.fault)

    def __enter__(self) -> LiveRecording:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def _open(self) -> None:
        pa = self._pa
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            os.close(os.open(self.path, os.O_CREAT | os.O_EXCL, 0o644))  # never another's
            self._file = pa.OSFile(str(self.path), "wb")
            options = pa.ipc.IpcWriteOptions(compression="zstd", use_threads=False)
            self._stream = pa.ipc.new_stream(self._file, self._schema, options=options)
        except OSError as error:
            reason = error.strerror or str(error)
            raise CoopqpError(f"cannot write '{self.path}': {reason}") from error

    def _run(self, every: float) -> None:
        while not self._stop.wait(every):
            self.flush()

    def _write(self, piece: slice) -> None:
        # One look into a dictionary a tick: the loop waits for Python's lock meanwhile.
        words = self._pa.array(list(map(_word, self._ring.causes[piece])))
        batch = self._batch.slice(piece.start, piece.stop - piece.start)
        last = batch.num_columns - 1
        batch = batch.set_column(last, self._schema.field(last), words)
        self._stream.write_batch(batch)


_word = cache(written)


def _check(path: Path, text: str, columns: Sequence[str], also: Sequence[str]) -> None:
    """Refuse what could be written and not be read."""
    if path.suffix != SUFFIX:
        raise InvalidValueError(f"'{path}': needs a name that ends with {SUFFIX}")
    if not text:
        words = "a recording keeps its scenario's text, but this one was read from no file"
        raise InvalidValueError(f"{words}; use coopqp.load, or give source")
    for name in also:
        if list(columns).count(name) > 1 or kind_of(name) != "number":
            raise InvalidValueError(f"also: '{name}' is the name of another column")
