"""An Arrow IPC stream, as :class:`coopqp.online.recording.LiveRecording` writes it while running.

What was on the disk when its writer was killed can be read: whole pieces, up to the last.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from coopqp.errors import CoopqpError
from coopqp.reading import open_bytes
from coopqp.recordings import column
from coopqp.recordings.format import Cells, Format, needs, readable
from coopqp.recordings.parquet import rows_of, scenario_in
from coopqp.scenario.catalog import Catalog
from coopqp.scenario.scenario import Scenario

SUFFIX = ".arrows"
#: What a stream that was closed ends with.
END = b"\xff\xff\xff\xff\x00\x00\x00\x00"


class ArrowStream(Format):
    """One file a controller, of a live loop."""

    def holds(self, path: Path) -> bool:
        return path.suffix == SUFFIX

    def rows(self, path: Path) -> Iterator[Cells]:
        with open_bytes(path) as stream:
            reader = _opened(path, stream)
            column.check_needed(str(path), reader.schema.names)
            first = 0
            for batch in _whole(reader):
                yield from rows_of(path, batch, first)
                first += batch.num_rows

    def scenario(self, path: Path, catalog: Catalog) -> Scenario:
        with open_bytes(path) as stream:
            return scenario_in(path, _opened(path, stream).schema.metadata, catalog)

    def cut_short(self, path: Path) -> bool:
        with open_bytes(path) as stream:
            stream.seek(0, 2)
            stream.seek(-min(stream.tell(), len(END)), 2)
            return stream.read() != END


def _opened(path: Path, stream: Any) -> Any:
    with needs("a recording of a live loop"):
        import pyarrow as pa
    if not stream.read(1):
        raise CoopqpError(f"{path}: is empty: its writer was killed before the first tick")
    stream.seek(0)
    with readable(path):
        return pa.ipc.open_stream(stream)


def _whole(reader: Any) -> Iterator[Any]:
    """The pieces up to the first that is not whole."""
    import pyarrow as pa

    while True:
        try:
            batch = reader.read_next_batch()
            batch.validate(full=True)
        except (StopIteration, pa.ArrowInvalid, OSError):
            return
        yield batch
