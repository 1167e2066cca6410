"""Columns of Arrow: Parquet, for pandas, polars and DuckDB, and the stream of a loop that runs.

Numbers are float64, ``tick`` is int64, texts are UTF-8; an empty cell is null, in a stream also
NaN. The metadata of the file has the scenario, that of each field its unit.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from coopqp import __version__
from coopqp.base.errors import CoopqpError
from coopqp.base.reading import open_bytes
from coopqp.recordings import column
from coopqp.recordings.run import ExportFormat, Format, Run, needs, readable, run_of
from coopqp.scenario.catalog import Catalog
from coopqp.scenario.loader import load_text
from coopqp.scenario.scenario import Scenario

GROUP = 10_000  # rows
SCENARIO = b"coopqp.scenario"
SUFFIX = ".arrows"
#: What a stream that was closed ends with.
END = b"\xff\xff\xff\xff\x00\x00\x00\x00"


class Parquet(ExportFormat):
    """One file a controller."""

    name: ClassVar[str] = "parquet"
    suffix: ClassVar[str] = ".parquet"

    def write(self, run: Run, scenario: Scenario, path: Path) -> None:
        with needs("Parquet"):
            import pyarrow as pa
            from pyarrow import parquet as pq
        schema = arrow_schema(scenario, run.controllers[0], scenario.portable, run.columns)
        with pq.ParquetWriter(path, schema, compression="zstd") as writer:
            for first in range(0, len(run), GROUP):
                part = run.only(slice(first, first + GROUP)).columns.values()
                lists = [x if x.dtype.kind in "fi" else column.cells(x) for x in part]
                pairs = zip(lists, schema.types, strict=True)
                arrays = [pa.array(x, kind, from_pandas=True) for x, kind in pairs]
                writer.write_batch(pa.record_batch(arrays, schema=schema))

    def read(self, path: Path) -> Run:
        with parquet_file(path) as file:
            return _run(path, file.read())

    def scenario(self, path: Path, catalog: Catalog) -> Scenario:
        with parquet_file(path) as file:
            return scenario_in(path, file.schema_arrow.metadata, catalog)


@contextmanager
def parquet_file(path: Path) -> Iterator[Any]:
    """As pyarrow opens it; errors as :meth:`Format.read`."""
    with needs("Parquet"):
        from pyarrow import parquet as pq
    with open_bytes(path) as stream, readable(path):
        yield pq.ParquetFile(stream)


class ArrowStream(Format):
    """One file a controller, of a live loop: :class:`coopqp.online.recording.LiveRecording`.

    What was on the disk when its writer was killed can be read: whole pieces, up to the last.
    """

    def holds(self, path: Path) -> bool:
        return path.suffix == SUFFIX

    def read(self, path: Path) -> Run:
        with open_bytes(path) as stream:
            reader = _opened(path, stream)
            import pyarrow as pa

            batches = list(_whole(reader))
            return _run(path, pa.Table.from_batches(batches, reader.schema))

    def scenario(self, path: Path, catalog: Catalog) -> Scenario:
        with open_bytes(path) as stream:
            return scenario_in(path, _opened(path, stream).schema.metadata, catalog)

    def cut_short(self, path: Path) -> bool:
        with open_bytes(path) as stream:
            stream.seek(0, 2)
            stream.seek(-min(stream.tell(), len(END)), 2)
            return stream.read() != END


def arrow_schema(scenario: Scenario, controller: str, source: str, names: Iterable[str]) -> Any:
    """The columns' types and units, and the scenario."""
    import pyarrow as pa

    types = {"number": pa.float64(), "whole": pa.int64(), "text": pa.string()}
    unit = column.unit_of(scenario)
    fields = [pa.field(x, types[column.kind_of(x)], metadata={"unit": unit(x)}) for x in names]
    kept = {"coopqp.version": __version__, "coopqp.controller": controller, SCENARIO: source}
    return pa.schema(fields, metadata=kept)


def _run(path: Path, table: Any) -> Run:
    """A run from a table of pyarrow's."""
    lists = {name: _values(table.column(i)) for i, name in enumerate(table.column_names)}
    return run_of(path, f"{path}: row ", lists, np.arange(table.num_rows), str(path))


def _values(found: Any) -> Any:
    kind = str(found.type)
    return found.to_numpy() if kind in ("double", "int64") else found.to_pylist()


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


def scenario_in(path: Path, kept: dict[bytes, bytes] | None, catalog: Catalog) -> Scenario:
    """The scenario in a schema's metadata."""
    if SCENARIO not in (kept or {}):
        raise CoopqpError(f"{path}: holds no run of coopqp: has no scenario in its metadata")
    assert kept
    return load_text(path, kept[SCENARIO].decode("utf-8", "replace"), catalog)
