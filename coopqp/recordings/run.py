"""A recorded run that was read from a file, and what a format of such files is.

A run is columns, and where each row of them stands in the file. A file that is damaged is refused
with the place that shows it.
"""

from __future__ import annotations

import math
import os
import secrets
import shutil
from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from coopqp.base.errors import CoopqpError, InvalidValueError, UnknownNameError, one_line
from coopqp.base.spec import Array
from coopqp.recordings import column
from coopqp.scenario.catalog import Catalog
from coopqp.scenario.scenario import Scenario
from coopqp.solver import STANDS, Status

#: A joint beyond it, or faster, is damage, and so is an error [rad, m; rad/s, m/s; N, N m].
FARTHEST = 1e12
ROUNDING = 1e-9  # times of two phases that are the same may differ by this [s]
MAX_TICKS = 2**53  # more ticks than any run has
_STANDS = {status.name for status in STANDS}  # after what a live loop's time stands still
OTHER = "the trace is damaged, or it is of another scenario than the one beside it: run it again"


@dataclass(frozen=True, kw_only=True)
class Run:
    """A recorded run; in ``trace.csv``, those of all controllers."""

    path: Path
    columns: column.Columns
    rows: NDArray[np.int64]  # what each row is called in the file, behind ``at``
    at: str  # the file, and what its rows are
    header: str  # where the names of the columns stand

    def __len__(self) -> int:
        return len(self.rows)

    @cached_property
    def controllers(self) -> list[str]:
        return list(dict.fromkeys(self.columns["controller"].tolist()))

    def place(self, k: int) -> str:
        return f"{self.at}{self.rows[k]}"

    def fault(self, k: int, message: str) -> InvalidValueError:
        return InvalidValueError(f"{self.place(k)}: {message}; the trace is damaged")

    def only(self, which: Any) -> Run:
        kept = {name: values[which] for name, values in self.columns.items()}
        return replace(self, columns=kept, rows=self.rows[which])

    def of(self, controller: str) -> Run:
        if controller not in self.controllers:
            raise UnknownNameError("controller", controller, self.controllers, f"{self.path}: ")
        return self.only(self.columns["controller"] == controller)

    @property
    def ticks(self) -> Run:
        """The rows without the end."""
        return self.only(self.columns["status"] != "")

    def numbers(self, names: Sequence[str], *, empty: bool = False) -> Array:
        """Columns beside each other, shape (rows, names); cells and columns that are empty are NaN.

        InvalidValueError: one may not be ``empty``, or has a number that cannot be.
        """
        nothing = np.full(len(self), np.nan)
        for name in names:
            if name not in self.columns and not empty:
                raise InvalidValueError(f"{self.header}: has no column '{name}'; {OTHER}")
        found = [self.columns.get(name, nothing) for name in names]
        values = np.stack(found, axis=1) if found else np.zeros((len(self), 0))
        for k, i in np.argwhere(np.isinf(values) if empty else ~np.isfinite(values))[:1].tolist():
            cell = "nothing" if np.isnan(values[k, i]) else values[k, i]
            raise self.fault(k, f"{names[i]}: found {cell}, needs a finite number")
        for k, i in np.argwhere(np.abs(values) > FARTHEST)[:1].tolist():
            raise self.fault(k, f"{names[i]}: found {values[k, i]:g}, which cannot be")
        return values

    def joints(self, name: str, joints: Sequence[str], *, empty: bool = False) -> Array:
        """A column a joint of a field, shape (rows, joints), as :meth:`numbers`."""
        columns = column.of_field(name, column.Layout(joints=tuple(joints)))
        return self.numbers(columns, empty=empty)


def read_rows(path: Path, at: str, rows: Iterable[Mapping[str, Any]]) -> Run:
    """A run from rows, as messages have them."""
    lists, count = dict[str, list[Any]](), 0
    for row in rows:
        lists |= {name: [None] * count for name in row if name not in lists}
        for name, values in lists.items():
            values.append(row.get(name))
        count += 1
    return run_of(path, at, lists, np.arange(count), f"{at}0")


def run_of(
    path: Path, at: str, lists: Mapping[str, Any], rows: NDArray[np.int64], header: str
) -> Run:
    """A run from its columns as a file has them: arrays of numbers, or lists of any values."""
    missing = [name for name in column.NEEDED if name not in lists]
    if missing:
        raise CoopqpError(f"{header}: holds no run of coopqp: has no column '{missing[0]}'")
    if not len(rows):
        raise CoopqpError(f"{path}: has no rows; the trace is damaged")
    columns = {name: typed(name, values, at, rows) for name, values in lists.items()}
    return Run(path=path, columns=columns, rows=rows, at=at, header=header)


def typed(name: str, values: Any, at: str, rows: NDArray[np.int64]) -> NDArray[Any]:
    """A column as the table has it."""
    kind = column.kind_of(name)
    if kind == "text":
        return np.array(["" if x is None else str(x) for x in values], object)
    try:
        numbers = _floats(values)
    except (TypeError, ValueError, OverflowError):
        k = next(k for k, value in enumerate(values) if not _is_number(value))
        words = f"{name}: found '{one_line(str(values[k])[:40])}', needs a number"
        raise InvalidValueError(f"{at}{rows[k]}: {words}; the trace is damaged") from None
    if kind == "number":
        return numbers
    for k in np.flatnonzero(~((numbers >= 0) & (numbers < MAX_TICKS) & (numbers % 1 == 0)))[:1]:
        words = f"{name}: found {numbers[k]:g}, needs a whole number"
        raise InvalidValueError(f"{at}{rows[k]}: {words}")
    return numbers.astype(np.int64)


def _floats(values: Any) -> Array:
    if isinstance(values, np.ndarray):
        return np.asarray(values, float)
    return np.array([math.nan if x is None or x == "" else float(x) for x in values], float)


def _is_number(value: Any) -> bool:
    try:
        return bool(_floats([value]).size)
    except (TypeError, ValueError, OverflowError):
        return False


def check(run: Run) -> None:
    """Refuse a status that there is not, and time that goes back, or stands still for no reason."""
    status = run.columns["status"]
    for word in dict.fromkeys(status.tolist()):
        for name in word.split("+") if word else ():
            if name not in Status.__members__:
                words = f"status: no status '{one_line(name[:40])}'"
                raise run.fault(int(np.argmax(status == word)), words)
    for own in map(run.of, run.controllers):
        t, status = own.numbers(["t"])[:, 0], own.columns["status"]
        for k in np.flatnonzero(np.diff(t) <= 0.0).tolist():
            rested = t[k + 1] >= t[k] - ROUNDING and _STANDS.intersection(status[k].split("+"))
            if not rested:
                raise own.fault(k + 1, f"t: found {t[k + 1]:g} after {t[k]:g}")


class Format(ABC):
    """A format that can be read."""

    @abstractmethod
    def holds(self, path: Path) -> bool:
        """Whether a path is of this format, by its name."""

    @abstractmethod
    def read(self, path: Path) -> Run:
        """All rows; CoopqpError: no such file, or damaged; MissingDependencyError: no package."""

    @abstractmethod
    def scenario(self, path: Path, catalog: Catalog) -> Scenario:
        """The scenario that was run; CoopqpError: as :meth:`read`, or it cannot be loaded."""

    def cut_short(self, path: Path) -> bool:
        """Whether its writer was killed, so that the end is missing."""
        return False


class ExportFormat(Format):
    """A format that can be written too."""

    name: ClassVar[str]
    """As ``--to`` has it; its files' names end with it."""

    def holds(self, path: Path) -> bool:
        return path.suffix == f".{self.name}"

    @abstractmethod
    def write(self, run: Run, scenario: Scenario, path: Path) -> None:
        """Write a new file of one controller's run, and the scenario as the controller holds it.

        CoopqpError: a row is damaged; MissingDependencyError: no package that writes it; OSError.
        """

    def replace(self, run: Run, scenario: Scenario, path: Path) -> None:
        """:meth:`write`, but a file that is there stays until the new one is whole; CoopqpError."""
        if path.is_dir() and not self.holds(path):
            raise CoopqpError(f"'{path}' is a folder, and none of this format; choose another name")
        aside = path.with_name(f".{path.name}-{secrets.token_hex(8)}")
        try:
            aside.mkdir(parents=True)
            self.write(run, scenario, aside / path.name)  # files in it are named after it
            if path.is_dir():
                shutil.rmtree(path)
            os.replace(aside / path.name, path)
        except OSError as error:
            raise CoopqpError(f"cannot write '{path}': {error.strerror or error}") from error
        finally:
            shutil.rmtree(aside, ignore_errors=True)


@contextmanager
def readable(path: Path) -> Iterator[None]:
    """One line for whatever a library raises over a file that is damaged."""
    try:
        yield
    except CoopqpError:
        raise
    except Exception as error:  # noqa: BLE001 - each library has its own, and names them anew
        words = " ".join(str(error).split()) or type(error).__name__
        raise CoopqpError(f"{path}: cannot be read: {words[:200]}; the file is damaged") from None
