"""CSV files: ``trace.csv``, and what arrived at the inputs of a run.

``trace.csv`` has all controllers in one file, the scenario beside it. From the others a scenario
feeds its inputs again; both what the page and what a loop for a robot write is of this form:

    inputs/NAME.csv      t: of the tick for which it arrived; sent: when; the columns of its kind
"""

import csv
import io
import math
import re
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from itertools import islice, takewhile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coopqp.base.errors import CoopqpError
from coopqp.base.reading import open_bytes
from coopqp.recordings import column
from coopqp.recordings.run import Format, Run, run_of, typed
from coopqp.scenario.catalog import Catalog
from coopqp.scenario.loader import load
from coopqp.scenario.scenario import Scenario
from coopqp.signal import Kind
from coopqp.trace import Trace

LONGEST = 1 << 20  # bytes of a line
BLOCK = 4096  # rows that are texts at a time


def text(traces: Sequence[Trace]) -> str:
    """``trace.csv``: a row for each controller and instant, with numbers that read back exactly."""
    parts = [column.columns_of(trace) for trace in traces]
    header = [x for x in column.names(column.layout_of(traces)) if any(x in own for own in parts)]
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(header)
    for own in parts:
        nothing = [None] * len(own["t"])
        lists = [column.cells(own[name]) if name in own else nothing for name in header]
        writer.writerows(zip(*lists, strict=True))
    return stream.getvalue()


class CsvFile(Format):
    """Written by ``coopqp compare --out``; what no other format holds is taken for one."""

    def holds(self, path: Path) -> bool:
        return True

    def read(self, path: Path) -> Run:
        reader = csv.reader(_lines(path), strict=True)
        try:
            header = next(reader, [])
            if not set(header) >= set(column.NEEDED):
                words = "is not a trace.csv written by 'coopqp compare --out'"
                raise CoopqpError(f"{path}:1: {words}")
            if twice := [name for name, count in Counter(header).items() if count > 1]:
                words = f"two columns are called '{twice[0][:40]}'; the trace is damaged"
                raise CoopqpError(f"{path}:1: {words}")
            run = _read(path, header, reader)
        except csv.Error as error:
            raise CoopqpError(f"{path}:{reader.line_num}: is not CSV: {error}") from None
        _check_ticks(run)
        return run

    def scenario(self, path: Path, catalog: Catalog) -> Scenario:
        return load(path.parent / "scenario.yaml", catalog)


def _read(path: Path, header: list[str], reader: Any) -> Run:
    """The rows, of which only a block at a time is kept as texts."""
    at, lines = f"{path}:", list[NDArray[np.int64]]()
    blocks: dict[str, list[NDArray[Any]]] = {name: [] for name in header}
    rows = _rows(path, header, reader)
    while block := list(islice(rows, BLOCK)):
        lines.append(np.array([line for line, _ in block]))
        lists = zip(*(cells for _, cells in block), strict=True)
        for name, values in zip(header, lists, strict=True):
            blocks[name].append(typed(name, values, at, lines[-1]))
    nothing = [np.zeros(0, np.int64)]
    columns = {name: np.concatenate(of or nothing) for name, of in blocks.items()}
    return run_of(path, at, columns, np.concatenate(lines or nothing), f"{path}:1")


def _rows(path: Path, header: list[str], reader: Any) -> Iterator[tuple[int, list[str]]]:
    for cells in reader:
        if len(cells) != len(header):
            words = f"found {len(cells)} cells, but line 1 {len(header)}; it is damaged"
            raise CoopqpError(f"{path}:{reader.line_num}: {words}")
        yield reader.line_num, cells


def _check_ticks(run: Run) -> None:
    """Refuse a row that does not follow the one before of its controller."""
    ticks, needed = run.columns["tick"], np.zeros(len(run), np.int64)
    for name in run.controllers:
        own = run.columns["controller"] == name
        needed[own] = np.arange(own.sum())
    for k in np.flatnonzero(ticks != needed)[:1].tolist():
        raise run.fault(k, f"tick: found {ticks[k]}, needs {needed[k]}")


def _lines(path: Path) -> Iterator[str]:
    with open_bytes(path) as stream:
        for number, line in enumerate(iter(lambda: stream.readline(LONGEST), b""), 1):
            try:
                text = line.decode("utf-8")
            except UnicodeDecodeError:
                raise CoopqpError(f"{path}:{number}: is not a text file in UTF-8") from None
            if len(line) == LONGEST:
                raise CoopqpError(f"{path}:{number}: the line is longer than {LONGEST} bytes")
            yield text


FOLDER = "inputs"


class InputRows:
    """What arrived at one input, row by row."""

    def __init__(self, kind: Kind) -> None:
        self.header = ",".join(("t", "sent", *kind.columns)) + "\n"
        self._rows: list[tuple[float, ...]] = []

    def add(self, t: float, sent: float, value: Iterable[float]) -> None:
        """Keep what arrived for the tick at t and when it was sent [s]; for one tick the last."""
        if self._rows and self._rows[-1][0] == t:
            self._rows.pop()
        self._rows.append(tuple(map(float, (t, sent, *value))))

    def lines(self, before: float = math.inf) -> str:
        """The rows before a time [s], as lines."""
        rows = takewhile(lambda row: row[0] < before, self._rows)
        return "".join(",".join(map(repr, row)) + "\n" for row in rows)

    def take(self, before: float) -> str:
        """The same, which are kept no longer."""
        lines = self.lines(before)
        del self._rows[: lines.count("\n")]
        return lines


def file_name(name: str, taken: Collection[str]) -> str:
    """What an input's file is called, as ``hand.csv``."""
    plain = re.sub(r"[^\w-]+", "_", name) or "_"
    while f"{plain}.csv" in taken:
        plain += "_"
    return f"{plain}.csv"


def fed(inputs: Mapping[str, Any], feeds: Mapping[str, str]) -> dict[str, Any]:
    """The ``inputs`` of a scenario file, fed from files."""
    found = {}
    for name, given in inputs.items():
        keys = {k: v for k, v in (given or {}).items() if k not in ("feed", "feed_file")}
        found[name] = keys | ({"feed_file": feeds[name]} if name in feeds else {})
    return found
