"""Recorded runs in files that other tools open: what is in them, written and read back.

A run is rows of named columns, as ``trace.csv`` has them. Every format keeps all of them, bit for
bit, and the scenario beside them, so that ``explain`` and ``replay`` work on each; MCAP and rosbag2
tell the same again in the messages that Foxglove and ROS 2 know.
"""

from pathlib import Path

from coopqp.base.errors import CoopqpError, UnknownNameError, UnreadableFileError
from coopqp.recordings.csv_file import CsvFile
from coopqp.recordings.messages import Mcap, Rosbag2
from coopqp.recordings.parquet import ArrowStream, Lerobot, Parquet
from coopqp.recordings.run import ExportFormat, Format, Run, check
from coopqp.scenario.scenario import Scenario

EXPORTS: tuple[ExportFormat, ...] = (Mcap(), Rosbag2(), Parquet(), Lerobot())
_ALL: tuple[Format, ...] = (*EXPORTS, ArrowStream(), CsvFile())  # the last holds all the rest

NAMES = tuple(known.name for known in EXPORTS)


def format_of(path: Path) -> Format:
    """The format of a recorded run, by its name."""
    return next(known for known in _ALL if known.holds(path))


def trace_in(path: Path) -> Path:
    """A recorded run from its own path, or that of the folder of a report."""
    if not (path.is_dir() and isinstance(format_of(path), CsvFile)):
        return path
    if not (trace := path / "trace.csv").exists():
        words = "has no trace.csv, as a folder of coopqp compare --out has; of a session give its "
        raise UnreadableFileError(path, f"{words}scenario.yaml to coopqp compare")
    return trace


def is_run(path: Path) -> bool:
    """Whether a path names a recorded run, or a report's folder, and no saved tick."""
    return path.is_dir() or path.suffix == ".csv" or not isinstance(format_of(path), CsvFile)


def read(path: Path | Run) -> Run:
    """A recorded run; one that was read already as it is; CoopqpError: none, or damaged."""
    if isinstance(path, Run):
        return path
    run = format_of(path).read(path)
    check(run)
    return run


def export(run: Run, scenario: Scenario, to: str, controller: str, out: Path) -> None:
    """Write one controller's run in another format; CoopqpError: none such, damaged, unwritable."""
    chosen = {known.name: known for known in EXPORTS}.get(to)
    if chosen is None:
        raise UnknownNameError("format", to, NAMES)
    if out.resolve() == run.path.resolve():
        raise CoopqpError(f"'{out}' is what is read; choose another name with --out")
    chosen.replace(run.of(controller), scenario.held_by(controller), out)
