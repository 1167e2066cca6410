"""The report as files: the page, the metrics as JSON and every tick as CSV."""

from __future__ import annotations

from pathlib import Path

from coopqp.comparison import Comparison
from coopqp.errors import CoopqpError, InternalError
from coopqp.recordings import csv_file
from coopqp.report import folder as report_folder
from coopqp.report import strict_json
from coopqp.report.folder import publish, replace_file
from coopqp.report.page import render
from coopqp.study.sweep.journal import OLDER, PATTERN
from coopqp.wording import by_user, raised

NAMES = ("report.html", "metrics.json", "trace.csv", "scenario.yaml")


def write(comparison: Comparison, folder: Path) -> list[Path]:
    """Write ``report.html``, ``metrics.json``, ``trace.csv`` and ``scenario.yaml``.

    They change all at once, also when the process is killed (:mod:`coopqp.report.folder`).

    Args:
        comparison: from :func:`coopqp.compare`.
        folder: made if it does not exist; files of these names are replaced.

    Returns:
        What was written.

    Raises:
        CoopqpError: the folder cannot be made or written to; a user's code keeps the page from
            being drawn, and all else is written.
        InternalError: the page could not be drawn; all else is written.
    """
    contents = {"metrics.json": metrics_json(comparison), "trace.csv": trace_csv(comparison)}
    if comparison.scenario.source:
        contents["scenario.yaml"] = comparison.scenario.portable  # for explain and replay
    fault: BaseException | None = None
    try:
        contents["report.html"] = render(comparison)
    except KeyboardInterrupt:
        raise
    except BaseException as error:  # noqa: BLE001 - a finished run is not lost for its pictures
        fault = error
    try:
        written = publish(contents, folder)
    except OSError as error:
        reason = error.strerror or str(error)
        raise CoopqpError(f"cannot write the report to '{folder}': {reason}") from error
    if fault:
        kept = ", ".join(path.name for path in written)
        words = f"the page cannot be drawn: {raised(fault)}; {kept} are written to '{folder}'"
        theirs = isinstance(fault, CoopqpError) or by_user(fault)
        raise (CoopqpError if theirs else InternalError)(words) from fault
    return [folder / name for name in NAMES if name in contents]


def write_one(path: Path, content: str) -> None:
    """Write one file; the old one stays when that fails.

    Raises:
        CoopqpError: it cannot be written.
    """
    try:
        replace_file(path, content)
    except OSError as error:
        raise CoopqpError(f"cannot write '{path}': {error.strerror or error}") from error


def check_folder(folder: Path) -> None:
    """Refuse a folder that no report can be written to, before a long run and not after it.

    Raises:
        CoopqpError: with the reason.
    """
    if any(next(folder.glob(pattern), None) for pattern in (PATTERN, OLDER)):
        words = "holds a study, whose page a report would replace; give another --out"
        raise CoopqpError(f"'{folder}' {words}")
    report_folder.check_folder(folder, NAMES)


def metrics_json(comparison: Comparison) -> str:
    """``metrics.json``: what is not finite is null, because JSON has no word for it."""
    return strict_json.text(comparison.as_json()) + "\n"


def trace_csv(comparison: Comparison) -> str:
    """``trace.csv``: all that is recorded of each controller's run."""
    return csv_file.text(list(comparison.traces.values()))
