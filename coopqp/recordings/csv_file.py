"""``trace.csv``: all controllers in one file, the scenario beside it."""

from __future__ import annotations

import csv
from collections import Counter
from collections.abc import Iterator, Mapping
from pathlib import Path

from coopqp.errors import CoopqpError
from coopqp.reading import open_bytes
from coopqp.recordings.column import NEEDED
from coopqp.recordings.format import Cells, Format
from coopqp.scenario.catalog import Catalog
from coopqp.scenario.loader import load
from coopqp.scenario.scenario import Scenario

LONGEST = 1 << 20  # bytes of a line


class CsvFile(Format):
    """Written by ``coopqp compare --out``; what no other format holds is taken for one."""

    def holds(self, path: Path) -> bool:
        return True

    def rows(self, path: Path) -> Iterator[Cells]:
        reader, ticks = csv.reader(_lines(path), strict=True), Counter[str]()
        try:
            header = next(reader, [])
            if not set(header) >= NEEDED:
                words = "is not a trace.csv written by 'coopqp compare --out'"
                raise CoopqpError(f"{path}:1: {words}")
            if twice := [name for name, count in Counter(header).items() if count > 1]:
                words = f"two columns are called '{twice[0][:40]}'; the trace is damaged"
                raise CoopqpError(f"{path}:1: {words}")
            for cells in reader:
                place = f"{path}:{reader.line_num}"
                if len(cells) != len(header):
                    words = f"found {len(cells)} cells, but line 1 {len(header)}; it is damaged"
                    raise CoopqpError(f"{place}: {words}")
                texts = dict(zip(header, cells, strict=True))
                _check_tick(place, texts, ticks)
                yield Cells(place, texts, f"{path}:1")
        except csv.Error as error:
            raise CoopqpError(f"{path}:{reader.line_num}: is no CSV: {error}") from None

    def scenario(self, path: Path, catalog: Catalog) -> Scenario:
        return load(path.parent / "scenario.yaml", catalog)


def _check_tick(place: str, texts: Mapping[str, str], ticks: Counter[str]) -> None:
    """Refuse a row that does not follow the one before of its controller; counts it."""
    name = texts["controller"]
    if texts["tick"] != str(ticks[name]):
        words = f"tick: found {texts['tick'][:40]}, needs {ticks[name]}; the trace is damaged"
        raise CoopqpError(f"{place}: {words}")
    ticks[name] += 1


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
