"""Parquet, for pandas, polars, DuckDB and their like: a column each, with its unit.

Numbers are float64, ``tick`` is int64, texts are UTF-8; an empty cell is null. The file's metadata
has the scenario, each field's its unit.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from typing import Any, ClassVar

from coopqp import __version__
from coopqp.errors import CoopqpError
from coopqp.reading import open_bytes
from coopqp.recordings import column
from coopqp.recordings.format import Cells, ExportFormat, RecordedRun, needs, readable
from coopqp.scenario.catalog import Catalog
from coopqp.scenario.loader import load_text
from coopqp.scenario.scenario import Scenario

GROUP = 10_000  # rows
SCENARIO = b"coopqp.scenario"


class Parquet(ExportFormat):
    """One file a controller."""

    name: ClassVar[str] = "parquet"
    suffix: ClassVar[str] = ".parquet"

    def write(self, run: RecordedRun, path: Path) -> None:
        pa, pq = _arrow()
        schema = arrow_schema(run.scenario, run.controller, run.source, run.columns)
        rows = run.rows()
        with pq.ParquetWriter(path, schema, compression="zstd") as writer:
            while group := list(islice(rows, GROUP)):
                columns = [[column.value(row, name) for row in group] for name in schema.names]
                writer.write_batch(pa.record_batch(columns, schema=schema))

    def rows(self, path: Path) -> Iterator[Cells]:
        _, pq = _arrow()
        with open_bytes(path) as stream, readable(path):
            file = pq.ParquetFile(stream)
            column.check_needed(str(path), file.schema_arrow.names)
            first = 0
            for batch in file.iter_batches():
                yield from rows_of(path, batch, first)
                first += batch.num_rows

    def scenario(self, path: Path, catalog: Catalog) -> Scenario:
        _, pq = _arrow()
        with open_bytes(path) as stream, readable(path):
            kept = pq.ParquetFile(stream).schema_arrow.metadata
        return scenario_in(path, kept, catalog)


def _arrow() -> tuple[Any, Any]:
    with needs("Parquet"):
        import pyarrow as pa
        from pyarrow import parquet as pq
    return pa, pq


def arrow_schema(scenario: Scenario, controller: str, source: str, columns: tuple[str, ...]) -> Any:
    """The columns' types and units, and the scenario; of Parquet and of Arrow alike.

    Args:
        scenario: as the controller holds it.
        controller: its name.
        source: the scenario's text.
        columns: names.
    """
    import pyarrow as pa

    unit = column.unit_of(scenario)
    fields = []
    for name in columns:
        kind = pa.int64() if column.is_whole(name) else pa.float64()
        of_text = pa.string() if column.is_text(name) else kind
        fields.append(pa.field(name, of_text, metadata={"unit": unit(name)}))
    kept = {"coopqp.version": __version__, "coopqp.controller": controller, SCENARIO: source}
    return pa.schema(fields, metadata=kept)


def rows_of(path: Path, batch: Any, first: int) -> Iterator[Cells]:
    """The rows of a record batch.

    Args:
        path: of the file, for faults.
        batch: of pyarrow.
        first: number of its first row.
    """
    names = batch.schema.names
    columns = [map(column.text, values.to_pylist()) for values in batch.columns]
    for k, texts in enumerate(zip(*columns, strict=True), first):
        yield Cells(f"{path}: row {k}", dict(zip(names, texts, strict=True)))


def scenario_in(path: Path, kept: dict[bytes, bytes] | None, catalog: Catalog) -> Scenario:
    """The scenario in a schema's metadata.

    Raises:
        CoopqpError: there is none, or it cannot be loaded.
    """
    if SCENARIO not in (kept or {}):
        raise CoopqpError(f"{path}: holds no run of coopqp: has no scenario in its metadata")
    assert kept
    return load_text(path, kept[SCENARIO].decode("utf-8", "replace"), catalog)
