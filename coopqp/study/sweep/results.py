"""The journals as one Parquet file: a row a variant and controller, in order."""

from __future__ import annotations

import fcntl
import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from itertools import islice
from pathlib import Path
from typing import Any

import coopqp
from coopqp.errors import CoopqpError, MissingDependencyError
from coopqp.study.sweep.index import Index, kind_of, wider
from coopqp.study.sweep.space import Box, Listed, Normal
from coopqp.study.sweep.study import SEED, Study, Varied

NAME = "results.parquet"
LOCK = ".results.lock"
GROUP = 20_000  # rows
#: Columns of every study, before those of what is varied, and after them.
FIRST = {"row": "int", "variant": "int", "controller": "text", "state": "text", "reason": "text"}
LAST = {"success": "bool", "blocked_by": "text", "broken": "text"}
OWN_SEED = "variant_seed"


def needs_arrow() -> None:
    """Refuse to begin where results could not be written.

    Raises:
        MissingDependencyError: pyarrow is not installed.
    """
    try:
        import pyarrow  # noqa: F401
    except ImportError:
        raise MissingDependencyError("a study", "studies") from None


def compact(study: Study, folder: Path) -> Index:
    """Write what the journals hold by now; the old file stays until the new one is whole.

    Args:
        study: whose journals they are.
        folder: with them.

    Raises:
        CoopqpError: it cannot be written.
    """
    aside = folder / f".{NAME}.{os.getpid()}"
    try:
        with _alone(folder):
            index = Index(folder, study)
            _write(study, index, aside)
            os.replace(aside, folder / NAME)
    except OSError as error:
        words = f"cannot write '{folder / NAME}': {error.strerror or error}"
        raise CoopqpError(f"{words}; the journal has all results") from None
    finally:
        aside.unlink(missing_ok=True)
    return index


@contextmanager
def _alone(folder: Path) -> Iterator[None]:
    """Wait for others, so that an older look at the journals never replaces a newer one."""
    with open(folder / LOCK, "w") as stream:
        fcntl.flock(stream, fcntl.LOCK_EX)
        yield


def _write(study: Study, index: Index, path: Path) -> None:
    import pyarrow as pa
    from pyarrow import parquet as pq

    types = {"int": pa.int64(), "float": pa.float64(), "bool": pa.bool_(), "text": pa.string()}
    kinds = _kinds(study, index)
    kept = {
        "coopqp.version": coopqp.__version__,
        "coopqp.study": study.file.text,
        "coopqp.scenario": study.scenario_text[1],
    }
    schema = pa.schema([pa.field(name, types[kind]) for name, kind in kinds.items()], kept)
    rows = _rows(study, index, kinds)
    with pq.ParquetWriter(path, schema, compression="zstd") as writer:
        while group := list(islice(rows, GROUP)):
            columns = zip(zip(*group, strict=True), schema, strict=True)
            arrays = [pa.array(values, field.type) for values, field in columns]
            writer.write_batch(pa.record_batch(arrays, schema=schema))
    with open(path, "rb") as stream:
        os.fsync(stream.fileno())


def _kinds(study: Study, index: Index) -> dict[str, str]:
    """The kind of each column, in order."""
    varied = {name: kind for one in study.varied for name, kind in _varied_kinds(one)}
    fixed = {**FIRST, OWN_SEED: "int", **varied, **LAST}
    return {**fixed, **{k: v for k, v in index.columns.items() if k not in fixed}}


def _varied_kinds(one: Varied) -> Iterator[tuple[str, str]]:
    over = one.over
    if isinstance(over, Box):
        for name, side in zip(one.columns, over.sides, strict=True):
            yield name, "int" if side.whole and not over.grows else "float"
    elif isinstance(over, Normal):
        yield one.path, "float"
    elif isinstance(over, Listed):
        values = [over.parts(value) for value in over.values]
        for name, column in zip(one.columns, zip(*values, strict=True), strict=True):
            kind = ""
            for value in column:
                kind = wider(kind, kind_of(value))
            yield name, kind or "text"


def _rows(study: Study, index: Index, kinds: dict[str, str]) -> Iterator[list[Any]]:
    rest = list(kinds)[len(FIRST) + 1 + len(study.columns) :]
    texts = {name for name, kind in kinds.items() if kind == "text"}
    columns = study.columns
    for number, rows in index.rows():
        variant = study.variant(number)
        seed = variant.values[_seed_at(study)] if _seed_at(study) >= 0 else variant.seed
        values = [_text(x) if name in texts else x
                  for name, x in zip(columns, study.parts(variant), strict=True)]  # fmt: skip
        for k, (controller, row) in enumerate(zip(study.controllers, rows, strict=True)):
            own = [_text(row.get(name)) if name in texts else row.get(name) for name in rest]
            place = number * len(study.controllers) + k
            yield [place, number, controller, row["state"], row["reason"], seed, *values, *own]


def _seed_at(study: Study) -> int:
    """Where among what is varied the seed is; -1 nowhere."""
    places: Sequence[tuple[Any, ...]] = [one.location for one in study.varied]
    return places.index((SEED,)) if (SEED,) in places else -1


def _text(value: Any) -> Any:
    return value if value is None or isinstance(value, str) else str(value)
