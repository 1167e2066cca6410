"""Columns of Arrow: Parquet, the stream of a loop that runs, and LeRobot's dataset.

Parquet is for pandas, polars and DuckDB.

Numbers are float64, ``tick`` is int64, texts are UTF-8; an empty cell is null, in a stream also
NaN. The metadata of the file has the scenario, that of each field its unit.

LeRobot's dataset, v3.0, is one episode. ``action`` is where a tick sends the joints and
``observation.state`` where they were, as LeRobot has them: arm by arm ``left_elbow_flex.pos`` for
the joint left/elbow_flex, in degrees (metres where it slides), float32, and ``left_gripper.pos``, 0
where the arm holds the object and 100 % where not. The whole run is in ``meta/coopqp.parquet``,
which LeRobot does not look at.
"""

import json
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from coopqp import __version__
from coopqp.base.errors import CoopqpError, needs
from coopqp.base.reading import open_bytes
from coopqp.base.spec import Array
from coopqp.recordings import column
from coopqp.recordings.run import ExportFormat, Format, Run, readable, run_of
from coopqp.scenario.catalog import Catalog
from coopqp.scenario.loader import load_text
from coopqp.scenario.scenario import Scenario

GROUP = 10_000  # rows
SCENARIO = b"coopqp.scenario"
SUFFIX = ".arrows"
END = b"\xff\xff\xff\xff\x00\x00\x00\x00"  # what a stream that was closed ends with


class Parquet(ExportFormat):
    """One file a controller."""

    name: ClassVar[str] = "parquet"

    def write(self, run: Run, scenario: Scenario, path: Path) -> None:
        with needs("Parquet", "recordings"):
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
    with needs("Parquet", "recordings"):
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
            reader, batches = _opened(path, stream), []
            import pyarrow as pa

            with suppress(pa.ArrowInvalid, OSError):  # what follows is not whole
                for batch in reader:
                    batch.validate(full=True)
                    batches.append(batch)
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
    columns = zip(table.column_names, table.columns, strict=True)
    numbers = ("double", "int64")
    lists = {k: x.to_numpy() if str(x.type) in numbers else x.to_pylist() for k, x in columns}
    return run_of(path, f"{path}: row ", lists, np.arange(table.num_rows), str(path))


def _opened(path: Path, stream: Any) -> Any:
    with needs("a recording of a live loop", "recordings"):
        import pyarrow as pa
    if not stream.read(1):
        raise CoopqpError(f"{path}: is empty: its writer was killed before the first tick")
    stream.seek(0)
    with readable(path):
        return pa.ipc.open_stream(stream)


def scenario_in(path: Path, kept: dict[bytes, bytes] | None, catalog: Catalog) -> Scenario:
    """The scenario in a schema's metadata."""
    if (text := (kept or {}).get(SCENARIO)) is None:
        raise CoopqpError(f"{path}: holds no run of coopqp: has no scenario in its metadata")
    return load_text(path, text.decode("utf-8", "replace"), catalog)


RUN = Path("meta", "coopqp.parquet")
FILE = "chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
FIRST = FILE.format(chunk_index=0, file_index=0)
OPEN = 100.0  # of a gripper [%]
ROUNDING = 1e-4  # by which times may be off the rate of a dataset [s], as in LeRobot
QUANTILES = 1, 10, 50, 90, 99
#: Of the only episode, beside its length and statistics.
ZEROS = (
    "episode_index", "dataset_from_index", "data/chunk_index", "data/file_index",
    "meta/episodes/chunk_index", "meta/episodes/file_index",
)  # fmt: skip
INDICES = "frame_index", "episode_index", "index", "task_index"


class Lerobot(ExportFormat):
    """One folder a controller."""

    name: ClassVar[str] = "lerobot"

    def holds(self, path: Path) -> bool:
        return super().holds(path) or (path / RUN).is_file()

    def write(self, run: Run, scenario: Scenario, path: Path) -> None:
        with needs("LeRobot's datasets", "recordings"):
            import pyarrow as pa
            from pyarrow import parquet as pq
        for folder in (path / "data", path / "meta" / "episodes"):
            (folder / FIRST).parent.mkdir(parents=True)
        Parquet().write(run, scenario, path / RUN)
        names, numbers = _frames(run, scenario)
        task, count = scenario.description or scenario.name, len(numbers["index"])
        stats, features, columns = dict[str, Any](), dict[str, Any](), dict[str, Any]()
        for key, x in numbers.items():
            own = names if x.ndim > 1 else None
            stats[key] = _stats(x.reshape(count, -1).astype(float))
            features[key] = {"dtype": str(x.dtype), "shape": [len(own) if own else 1], "names": own}
            kind = pa.list_(pa.float32(), len(own)) if own else None
            columns[key] = pa.array(list(x) if own else x, kind)
        pq.write_table(pa.table(columns), path / "data" / FIRST)
        pq.write_table(_tasks(task), path / "meta" / "tasks.parquet")
        pq.write_table(pa.table(_episode(task, count, stats)), path / "meta" / "episodes" / FIRST)
        rate = round(1.0 / scenario.dt, 6)
        info = {
            "codebase_version": "v3.0", "robot_type": scenario.robot_model.name,
            "total_episodes": 1, "total_frames": count, "total_tasks": 1, "chunks_size": 1000,
            "data_files_size_in_mb": 100, "video_files_size_in_mb": 200,
            "fps": int(rate) if rate.is_integer() else rate, "splits": {"train": "0:1"},
            "data_path": f"data/{FILE}", "video_path": None, "features": features,
        }  # fmt: skip
        for name, text in (("info", info), ("stats", stats)):
            (path / "meta" / f"{name}.json").write_text(json.dumps(text, indent=4), "utf-8")

    def read(self, path: Path) -> Run:
        return replace(Parquet().read(path / RUN), path=path)

    def scenario(self, path: Path, catalog: Catalog) -> Scenario:
        with parquet_file(path / RUN) as file:
            return scenario_in(path, file.schema_arrow.metadata, catalog)


def _frames(run: Run, scenario: Scenario) -> tuple[list[str], dict[str, NDArray[Any]]]:
    """The numbers' names, and a dataset's columns."""
    ticks, robot = run.ticks, scenario.robot_model
    late, count = ticks.numbers(["t"])[:, 0], np.arange(len(ticks))
    off = float(np.ptp(late - count * scenario.dt)) if len(late) else np.inf
    if off > ROUNDING:
        words = f"time is up to {off:.3g} s off one tick each {scenario.dt:g} s"
        raise CoopqpError(f"{run.path}: {words}, and a dataset of LeRobot has one rate")
    names, gaps = robot.joint_names, ("commanded", "measured")
    q, commanded, measured, v = (ticks.joints(x, names, empty=x in gaps) for x in ("q", *gaps, "v"))
    goal = np.where(np.isnan(commanded), q, commanded) + scenario.dt * v
    at, grips = _columns(ticks, scenario)
    state = np.where(np.isnan(measured), q, measured)
    scale = np.array([1.0 if unit == "m" else 180.0 / np.pi for unit in robot.joint_units])
    found: dict[str, NDArray[Any]] = {
        key: np.hstack([x * scale, grips])[:, [*at.values()]].astype(np.float32)
        for key, x in (("action", goal), ("observation.state", state))
    }
    found["timestamp"] = (count * scenario.dt).astype(np.float32)
    zero = np.zeros_like(count)
    return [*at], found | dict(zip(INDICES, (count, zero, count, zero), strict=True))


def _columns(ticks: Run, scenario: Scenario) -> tuple[dict[str, int], Array]:
    """Names arm by arm, where they are among joints and grippers, and how open these are [%]."""
    robot, joints, at = scenario.robot_model, scenario.robot_model.joint_names, dict[str, int]()
    grips = np.zeros((len(ticks), len(robot.arms)))
    for phase in scenario.phases:
        opened = [OPEN * (arm.name in phase.released) for arm in robot.arms]
        grips[ticks.columns["phase"] == phase.name] = opened
    for i, arm in enumerate(robot.arms):
        at |= {_key(joint): joints.index(joint) for joint in robot.arm_joints(arm)}
        at[_key(f"{arm.name.split('/')[0]}/gripper")] = len(joints) + i
    return at | {_key(joint): i for i, joint in enumerate(joints)}, grips


def _key(joint: str) -> str:
    return f"{joint.replace('/', '_')}.pos"


def _stats(x: Array) -> dict[str, list[float]]:
    """What LeRobot keeps of numbers, shape (T, k)."""
    found = {name: getattr(x, name)(axis=0).tolist() for name in ("min", "max", "mean", "std")}
    quantiles = {f"q{part:02d}": np.percentile(x, part, axis=0).tolist() for part in QUANTILES}
    return found | {"count": [len(x)]} | quantiles


def _episode(task: str, count: int, stats: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    """The only row of meta/episodes."""
    row = {"tasks": [task], "length": count, "dataset_to_index": count, **dict.fromkeys(ZEROS, 0)}
    row |= {f"stats/{key}/{name}": x for key, of in stats.items() for name, x in of.items()}
    return {name: [value] for name, value in row.items()}


def _tasks(task: str) -> Any:
    """Texts with their numbers; LeRobot looks a text up in the index that pandas makes of it."""
    import pyarrow as pa

    kinds = ("task_index", "int64", "int64"), ("task", "unicode", "object")
    known = {
        "index_columns": ["task"], "column_indexes": [], "pandas_version": "2.0.0",
        "columns": [{"name": name, "field_name": name, "pandas_type": kind, "numpy_type": of,
                     "metadata": None} for name, kind, of in kinds],
    }  # fmt: skip
    table = pa.table({"task_index": pa.array([0], pa.int64()), "task": [task]})
    return table.replace_schema_metadata({"pandas": json.dumps(known)})
