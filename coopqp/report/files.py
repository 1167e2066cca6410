"""The report as files: the page, the metrics as JSON and every tick as CSV.

They change all at once, whenever the process that writes them dies. They lie in a folder of their
own, ``.report-XXXX``. ``.report`` is a symbolic link to it, and ``report.html`` and
the others are links through it. A new report is written whole beside the old one; then one rename
gives ``.report`` its new target, which the file system does in one step or not at all. Against a
loss of power the files are flushed to the disk before the rename.
"""

import fcntl
import os
import secrets
import shutil
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from coopqp.base.errors import CoopqpError, InternalError, one_line
from coopqp.base.table import csv_text
from coopqp.base.wording import by_user, raised
from coopqp.execution.comparison import Comparison
from coopqp.recordings import csv_file
from coopqp.report import strict_json
from coopqp.report.page import render
from coopqp.scenario.planned import FOLLOWED
from coopqp.scenario.yaml import with_keys
from coopqp.study.sweep.results import OLDER, PATTERN

NAMES = ("report.html", "metrics.json", "trace.csv", "scenario.yaml", FOLLOWED)
POINTER = ".report"
PREFIX = ".report-"


def write(comparison: Comparison, folder: Path) -> list[Path]:
    """Write the page, ``metrics.json``, ``trace.csv``, ``scenario.yaml`` and its plan, all at once.

    CoopqpError: the folder cannot be written to; or, as InternalError, the page cannot be drawn,
    and all else is written.
    """
    contents = {"metrics.json": metrics_json(comparison), "trace.csv": trace_csv(comparison)}
    if (scenario := comparison.scenario).source:
        contents["scenario.yaml"] = scenario.portable  # for explain and replay
        if scenario.follows:
            keys = scenario.keys_with(folder / FOLLOWED)
            contents["scenario.yaml"] = with_keys(scenario.source, keys)
            contents[FOLLOWED] = csv_text(scenario.follows.columns, 17)
    fault: BaseException | None = None
    try:
        contents["report.html"] = render(comparison, folder)
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
    """Write one file; the old one stays when that fails; CoopqpError: it cannot be written."""
    aside = path.parent / _new_name()
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            _write(aside, content)
            os.replace(aside, path)
        finally:
            aside.unlink(missing_ok=True)
    except OSError as error:
        raise CoopqpError(f"cannot write '{path}': {error.strerror or error}") from error


def check_folder(folder: Path) -> None:
    """CoopqpError for a folder that no report can be written to, before a long run."""
    if any(next(folder.glob(pattern), None) for pattern in (PATTERN, OLDER)):
        words = "holds a study, whose page a report would replace; give another --out"
        raise CoopqpError(f"'{folder}' {words}")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with _alone(folder):
            _sweep(folder)
            trial = _new_folder(folder)
            os.symlink(trial.name, trial / "link")
            shutil.rmtree(trial)
        for name in NAMES:
            if (folder / name).is_dir():
                words = "is a folder, but a file is to be written there"
                raise CoopqpError(f"'{folder / name}' {words}")
        if os.path.lexists(folder / POINTER) and not (folder / POINTER).is_symlink():
            raise CoopqpError(f"'{folder / POINTER}' is in the way; remove it")
    except FileExistsError:
        raise CoopqpError(one_line(f"'{folder}' is not a folder")) from None
    except OSError as error:
        words = f"cannot write to '{folder}': {error.strerror or error}"
        raise CoopqpError(one_line(words)) from error


@contextmanager
def checked_folder(folder: Path | None) -> Iterator[None]:
    """:func:`check_folder` before the body; a folder made for it goes where the body raises."""
    made = folder is not None and not os.path.lexists(folder)
    try:
        if folder is not None:
            check_folder(folder)
        yield
    except BaseException:
        if made and folder is not None:
            shutil.rmtree(folder, ignore_errors=True)
        raise


def metrics_json(comparison: Comparison) -> str:
    """``metrics.json``: what is not finite is null, because JSON has no word for it."""
    return strict_json.text(comparison.as_json()) + "\n"


def trace_csv(comparison: Comparison) -> str:
    """``trace.csv``: all that is recorded of each controller's run."""
    return csv_file.text(list(comparison.traces.values()))


def publish(contents: Mapping[str, str], folder: Path) -> list[Path]:
    """Replace the files of a folder by others, by name, in one step; what is not ours stays.

    OSError: it cannot be written to, or has no symbolic links; the old report is as it was.
    """
    folder.mkdir(parents=True, exist_ok=True)
    with _alone(folder):
        try:
            new = _new_folder(folder)
            for name, content in contents.items():
                _write(new / name, content)
            before = {link.name for link in folder.iterdir() if _is_ours(link)}
            _adopt(contents, folder)
            _link(POINTER, new.name, folder)  # the step
            for name in before - set(contents):
                (folder / name).unlink()
        finally:
            _sweep(folder)
    return [folder / name for name in contents]


@contextmanager
def _alone(folder: Path) -> Iterator[None]:
    """Wait for others that write to the folder; the system ends the wait where they die."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX)
        yield
    finally:
        os.close(descriptor)


def _adopt(names: Iterable[str], folder: Path) -> None:
    """Make a link through the pointer of every name; what each shows stays the same."""
    if not (folder / POINTER).is_symlink():
        _link(POINTER, _new_folder(folder).name, folder)
    for name in names:
        path = folder / name
        if _is_ours(path):
            continue
        if path.exists():  # a report of an earlier version, or a copy
            shutil.copy2(path, folder / POINTER / name)
        else:
            (folder / POINTER / name).unlink(missing_ok=True)
        _link(name, f"{POINTER}/{name}", folder)


def _is_ours(path: Path) -> bool:
    return path.is_symlink() and os.readlink(path) == f"{POINTER}/{path.name}"


def _link(name: str, target: str, folder: Path) -> None:
    """A symbolic link in one step, also where something else has its name."""
    aside = folder / _new_name()
    os.symlink(target, aside)
    os.replace(aside, folder / name)


def _sweep(folder: Path) -> None:
    """Remove what is no part of the report: older ones, and what writers that died have left."""
    pointer = folder / POINTER
    kept = os.readlink(pointer) if pointer.is_symlink() else ""
    for path in folder.glob(f"{PREFIX}*"):
        if path.name == kept:
            continue
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path)
        else:
            path.unlink()


def _new_name() -> str:
    return PREFIX + secrets.token_hex(8)


def _new_folder(folder: Path) -> Path:
    new = folder / _new_name()
    new.mkdir()
    return new


def _write(path: Path, content: str) -> None:
    path.write_text(content, encoding="utf-8", newline="")
    with open(path, "rb") as stream:
        os.fsync(stream.fileno())
