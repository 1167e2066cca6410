"""Reading a written ``trace.csv`` back: which controllers, which ticks, which state."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from coopqp.checked import Array
from coopqp.errors import CoopqpError, InvalidValueError, UnknownNameError
from coopqp.qp_law.law import QPLaw
from coopqp.reading import open_bytes
from coopqp.solver import Status
from coopqp.state import State

LONGEST = 1 << 20  # bytes of a line
#: Columns that every trace has.
NEEDED = ("controller", "tick", "t", "status", "tick_us")


@dataclass(frozen=True)
class _Row:
    """A row of a trace.

    Attributes:
        place: file and line.
        cells: texts by column.
    """

    place: str
    cells: Mapping[str, str]

    def number(self, column: str) -> float:
        """A finite number.

        Raises:
            InvalidValueError: no such column, or no finite number there.
        """
        text = self.cells.get(column)
        if text is None:
            words = f"has no column '{column}'; the trace is damaged, or of another scenario"
            raise InvalidValueError(f"{self.place}: {words}")
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not math.isfinite(value):
            raise InvalidValueError(
                f"{self.place}: {column}: found '{text[:40]}', needs a finite number"
            )
        return value

    @property
    def tick(self) -> int:
        """Which tick."""
        value = self.number("tick")
        if not (value >= 0.0 and value.is_integer()):
            raise InvalidValueError(f"{self.place}: tick: found {value:g}, needs a whole number")
        return int(value)


def state_from_trace(
    path: Path, controller: str, tick: int, law: QPLaw, t_start: float = 0.0
) -> State:
    """The state that a tick of a written trace decided from; the law's tick repeats it.

    What the observer had made of the measured joints is in the gap, so that there is no q_measured.

    Args:
        path: of ``trace.csv``.
        controller: whose.
        tick: which.
        law: gives the joints.
        t_start: when its phase began [s].

    Raises:
        CoopqpError: no such file, controller or tick; a damaged row.
    """
    joints = law.problem.chain.joint_names
    state, found, last = law.start(), False, 0
    for row in _rows(path):
        if row.cells["controller"] != controller or not row.cells["tick_us"]:
            continue
        k = row.tick
        last = max(last, k)
        if k == tick:
            found = True
            state.t = max(0.0, row.number("t") - t_start)  # of the phase, but for rounding
            told = bool(row.cells.get(f"commanded[{joints[0]}]"))
            key = "commanded" if told else "q"
            state.q[:] = [row.number(f"{key}[{joint}]") for joint in joints]
            _read(row, "gap[", state.gap)
            _read(row, "memory[", state.memory.numbers)
        elif k == tick - 1:
            state.v[:] = [row.number(f"v[{joint}]") for joint in joints]
    if not found:
        raise InvalidValueError(
            f"{path}: controller '{controller}' has no tick {tick}; it has 0 to {last}"
        )
    state.update()
    return state


def _read(row: _Row, start: str, numbers: Array) -> None:
    """Numbers from the columns whose names start so; nothing where they are empty."""
    columns = [key for key, text in row.cells.items() if key.startswith(start) and text]
    found = [row.number(column) for column in columns[: len(numbers)]]
    numbers[: len(found)] = found


def blocked_tick(path: Path, controller: str) -> int:
    """The tick worth explaining: the first that gave something up or failed, else the last.

    Raises:
        CoopqpError: no such file or controller; a damaged row.
    """
    if controller not in controllers_of(path):
        raise UnknownNameError("controller", controller, controllers_of(path), f"{path}: ")
    last = 0
    for row in _rows(path):
        status = row.cells["status"]
        if row.cells["controller"] != controller or not status:
            continue
        if status not in (Status.OPTIMAL.name, Status.INACCURATE.name):
            return row.tick
        last = row.tick
    return last


def controllers_of(path: Path) -> list[str]:
    """Names of the controllers in a written trace, in their order.

    Raises:
        CoopqpError: no such file, or not a trace.
    """
    return list(dict.fromkeys(row.cells["controller"] for row in _rows(path)))


def _rows(path: Path) -> Iterator[_Row]:
    """All rows.

    Raises:
        CoopqpError: no such file, not a trace, or a row with too few or too many cells.
    """
    reader = csv.reader(_lines(path), strict=True)
    try:
        header = next(reader, [])
        if not set(NEEDED) <= set(header):
            words = "is not a trace.csv written by 'coopqp compare --out'"
            raise CoopqpError(f"{path}:1: {words}")
        for cells in reader:
            place = f"{path}:{reader.line_num}"
            if len(cells) != len(header):
                words = f"found {len(cells)} cells, needs {len(header)}; the trace is damaged"
                raise CoopqpError(f"{place}: {words}")
            yield _Row(place, dict(zip(header, cells, strict=True)))
    except csv.Error as error:
        raise CoopqpError(f"{path}:{reader.line_num}: is no CSV: {error}") from None


def _lines(path: Path) -> Iterator[str]:
    """The lines of a file, as text."""
    with open_bytes(path) as stream:
        number = 0
        while line := stream.readline(LONGEST):
            number += 1
            try:
                text = line.decode("utf-8")
            except UnicodeDecodeError:
                raise CoopqpError(f"{path}:{number}: is not a text file in UTF-8") from None
            if len(line) == LONGEST:
                raise CoopqpError(f"{path}:{number}: the line is longer than {LONGEST} bytes")
            yield text
