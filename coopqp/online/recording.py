"""A recording of a running loop, in pieces: a process that is killed loses the last of them.

    with LiveRecording(path, scenario, law, state, controller="qp") as recording:
        while True:
            command = law.tick(state)
            recording.tick(state, command, us)  # before the state goes on
            ...

A tick copies numbers into a preallocated ring. Every ``EVERY`` seconds a thread adds what is new to
the file, as one piece of Arrow's IPC stream, almost without the GIL. Nothing waits: where the disk
does not keep up, the ring fills, and ticks without room are left out and counted.

The columns are those of ``trace.csv`` from which a tick can be repeated: ``q`` is the configuration
before the tick, the object's pose is that at q, ``measured`` are the sensors' joints. Input values
are in it, too.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from coopqp.base.errors import CoopqpError, InvalidValueError, needs
from coopqp.controller import Command, Law
from coopqp.kernel import native
from coopqp.model.state import State
from coopqp.recordings.column import Layout, names, of_field
from coopqp.recordings.parquet import SUFFIX, arrow_schema
from coopqp.scenario.scenario import Scenario
from coopqp.solver import Status, written

#: What the loops are open by stands for two fields: its largest errors.
OPEN = "open"
ERRORS = ("loop_position", "loop_orientation")
#: Fields of the table other than time, memory and inputs, as a live loop has them.
MEASURED: dict[str, Callable[[State, Command], Any]] = {
    "q": lambda state, command: state.q,
    "v": lambda state, command: command.v,
    "measured": lambda state, command: np.nan if state.q_measured is None else state.q_measured,
    "loop_offset": lambda state, command: state.loop_offset,
    "tau": lambda state, command: command.tau,
    "position": lambda state, command: state.p_WO,
    "rotation": lambda state, command: state.R_WO,
    OPEN: lambda state, command: state.closed_error,
    "scale": lambda state, command: command.scale,
}


#: Time between pieces [s]; a crash loses less than one.
EVERY = 0.25
#: Time that the ring holds, for disks that are slow for a while [s].
ROOM = 8.0


class LiveRecording:
    """A file that grows while a loop runs.

    Ticks that are not written yet are in a ring buffer. A row is copied in one step and counted
    after that, so writer and reader need no lock.

    Args:
        path: ``NAME.arrows``; must not exist.
        law: of the first phase.
        start: the state before the first tick. Where it has measured joints, all ticks have.
        controller: the law's name in the scenario.
        source: the scenario's text, for repeating ticks; what it was read from if omitted.
        memory: largest size of the laws' memory, where later ones have more than the first.
        every: time between pieces [s]; 0 without a thread: the caller calls :meth:`flush`.

    Attributes:
        fault: why writing failed; empty if it did not.
        dropped: number of ticks left out because the disk did not keep up.

    Raises:
        CoopqpError: the file exists, or cannot be made.
        InvalidValueError: another ending than ``.arrows``; a scenario without a text.
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
        memory: int = 0,
        every: float = EVERY,
    ) -> None:
        self.path, self.fault, held = Path(path), "", scenario.held_by(controller)
        self.dropped = self._filled = self._emptied = self._ticks = 0  # rows in and out
        layout = Layout(
            joints=law.problem.chain.joint_names,
            loops=len(start.loop_offset) // 6 + (held.stands and not start.chain.standing),
            memory=max(memory, len(start.memory.numbers)),
            inputs=held.followed(),
        )
        without = {"measured"} if start.q_measured is None else set()
        without |= {"tau"} if law.command.tau is None else set()
        fields = {name: of for name, of in MEASURED.items() if name not in without}
        others = ("t", "memory", "followed", "followed_rate", "tick_us", *ERRORS)
        self._names = names(layout, {*fields, *others} - {OPEN})
        columns = ("controller", "tick", *self._names, "status")
        text = source or scenario.portable
        if self.path.suffix != SUFFIX:
            raise InvalidValueError(f"'{path}': needs a name that ends with {SUFFIX}")
        if not text:
            words = "a recording keeps its scenario's text, but this one was read from no file"
            raise InvalidValueError(f"{words}; use coopqp.load, or give source")
        with needs("a recording of a live loop", "recordings"):
            import pyarrow as pa
        self._pa: Any = pa
        self._schema = arrow_schema(held, controller, text, columns)
        self._capacity = room = max(16, int(ROOM / law.problem.dt))
        self._numbers = np.full((len(self._names), room), np.nan)  # an empty cell is NaN
        self._numbered = np.zeros(room, np.int64)
        self._causes: list[tuple[Status, ...]] = [()] * room
        controllers = pa.array([controller] * room)
        self._batch = pa.record_batch(  # over the ring's own memory, but for names and statuses
            [controllers, self._numbered, *self._numbers, controllers], schema=self._schema
        )
        self._measured, self._inputs = tuple(fields.values()), tuple(layout.inputs)
        alone = (Layout(joints=(), inputs={name: kind}) for name, kind in layout.inputs.items())
        parts = [(name, layout) for name in ("t", "tick_us", "memory", *fields)]
        parts += [(name, own) for own in alone for name in ("followed", "followed_rate")]
        self._places = [self._place(*part) for part in parts]
        self._errors, self._v = parts.index((OPEN, layout)), self._place("v", layout)
        self._memory = np.zeros(len(of_field("memory", layout)))
        first, sizes = zip(
            *((part.start, part.stop - part.start) for part in self._places), strict=True
        )
        found = native.module()
        self._quick = found and found.Columns(self._numbers, first, sizes, self._errors).add
        self.begin(start)
        self._alone, self._stop = threading.Lock(), threading.Event()
        self._open()
        self._thread = threading.Thread(target=self._run, args=(every,), daemon=True)
        if every > 0.0:
            self._thread.start()

    def _place(self, name: str, layout: Layout) -> slice:
        """Where the columns of a field are, which are adjacent."""
        columns = ERRORS if name == OPEN else of_field(name, layout)
        first = self._names.index(columns[0]) if columns else 0
        return slice(first, first + len(columns))

    def tick(self, state: State, command: Command, us: float) -> None:
        """Record a tick before the state advances, and its computing time [us]; never waits."""
        tick, i = self._ticks, self._filled % self._capacity
        self._ticks = tick + 1
        if self._filled - self._emptied < self._capacity:
            self._write_tick(i, state, command, us)
            self._numbered[i], self._causes[i] = tick, command.causes
            self._filled += 1
        else:
            self.dropped += 1
        self._remember(state)

    def begin(self, state: State, since: float = 0.0) -> None:
        """Go on from another state than the last tick's, as after a stop.

        A tick is repeated from the velocity of the one before. Where that is not the state's, a
        number is left out between them. ``since`` is when its own time began [s].
        """
        self._remember(state)
        self._since = since
        last = self._numbers[self._v, (self._filled - 1) % self._capacity]
        if self._ticks and not np.array_equal(last, state.v):
            self._ticks += 1

    def _remember(self, state: State) -> None:
        kept = state.memory.numbers
        self._memory[: len(kept)], self._memory[len(kept) :] = kept, 0.0

    def _write_tick(self, i: int, state: State, command: Command, us: float) -> None:
        values = [self._since + state.t, us, self._memory]
        values += [of(state, command) for of in self._measured]
        for followed in map(state.inputs.get, self._inputs):
            values += (np.nan, np.nan) if followed is None else (followed.value, followed.rate)
        if self._quick and self._quick(i, values):
            return
        values[self._errors] = np.array([state.loop_position_error, state.loop_orientation_error])
        for place, value in zip(self._places, values, strict=True):
            part, value = self._numbers[place, i], np.asarray(value, float)
            if value.ndim:  # another phase may have another number of loops
                part[:], part = 0.0, part[: value.size]
            part[:] = value.ravel() if value.ndim else value

    def flush(self) -> None:
        """Write what is new; a thread does it by itself."""
        if self.fault:
            return
        with self._alone:
            try:
                first, count = self._emptied % self._capacity, self._filled - self._emptied
                before = min(count, self._capacity - first)  # the rest is around the end
                for piece in (slice(first, first + before), slice(0, count - before)):
                    if piece.stop > piece.start:
                        self._write(piece)
                        self._emptied += piece.stop - piece.start
                os.fsync(self._file.fileno())
            except (OSError, self._pa.ArrowException) as error:
                self.fault = f"cannot write '{self.path}': {error}"

    def close(self) -> None:
        """Write the rest and the end; CoopqpError: something could not be written."""
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

    def __exit__(self, *error: object) -> None:
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
        # One look-up a tick: the loop waits for the GIL meanwhile.
        words = self._pa.array(list(map(_word, self._causes[piece])))
        batch = self._batch.slice(piece.start, piece.stop - piece.start)
        last = batch.num_columns - 1
        batch = batch.set_column(last, self._schema.field(last), words)
        self._stream.write_batch(batch)


_word = cache(written)
