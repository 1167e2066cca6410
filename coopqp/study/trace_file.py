"""Reading a written ``trace.csv`` back: controllers, runs, ticks and states.

A file that is damaged, or of another scenario, is refused with the line that shows it.
"""

from __future__ import annotations

import csv
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TextIO

import numpy as np

from coopqp.checked import Array
from coopqp.errors import CoopqpError, InvalidValueError, UnknownNameError
from coopqp.qp_law.law import QPLaw
from coopqp.scenario.scenario import Scenario
from coopqp.solver import Status
from coopqp.state import State
from coopqp.study.explanation.leg import Recording


def recording_from_trace(path: Path, scenario: Scenario, controller: str) -> Recording:
    """A controller's whole run.

    Args:
        path: of ``trace.csv``.
        scenario: that it was written for.
        controller: whose.

    Raises:
        CoopqpError: no such file or controller, or a damaged file.
    """
    known = controllers_of(path)
    if controller not in known:
        raise UnknownNameError("controller", controller, known, f"{path}: ")
    held = scenario.held_by(controller)
    joints, ticks = held.chain.joint_names, held.ticks
    with _open(path) as stream, _damage(path) as line:
        rows = []
        for row in csv.DictReader(stream):
            line[0] += 1
            if row["controller"] == controller:
                rows.append(row)
                _numbers(row, "q", joints)  # so that the line is known where it is damaged
        if len(rows) != ticks + 1:
            raise CoopqpError(
                f"{path}: '{controller}' has {len(rows) - 1} ticks, its scenario {ticks}; the file "
                "is damaged, or of another scenario"
            )
        status = tuple(row["status"] for row in rows[:-1])
        unknown = {name for word in status for name in word.split("+")} - set(Status.__members__)
        if unknown:
            raise ValueError(f"no status '{min(unknown)}'")
        tau = any(row.get(f"tau[{joint}]") for row in rows[:1] for joint in joints)
        return Recording(
            controller=controller,
            q=np.array([_numbers(row, "q", joints) for row in rows]),
            v=np.array([_numbers(row, "v", joints) for row in rows[:-1]]),
            status=status,
            errors=_last_errors(rows),
            tau=np.array([_numbers(row, "tau", joints) for row in rows[:-1]] if tau else [[]]),
        )


def _numbers(row: Mapping[str, str], key: str, joints: Sequence[str]) -> list[float]:
    """A number a joint; zero where the column is empty, as for torques of passive joints."""
    return [float(row[f"{key}[{joint}]"] or (0.0 if key == "tau" else "")) for joint in joints]


def _last_errors(rows: Sequence[Mapping[str, str]]) -> dict[str, float]:
    """Each task's error at the end of the time for which it counts."""
    found = {}
    for row in rows:
        for key, text in row.items():
            if key and key.startswith("error[") and text:
                found[key.removeprefix("error[").removesuffix("]")] = float(text)
    return found


@contextmanager
def _damage(path: Path) -> Iterator[list[int]]:
    """Refuse what cannot be read, with the line; the caller counts in the list that it gets."""
    line = [1]
    try:
        yield line
    except (KeyError, TypeError, ValueError, csv.Error) as error:
        what = f"no column {error}" if isinstance(error, KeyError) else " ".join(str(error).split())
        raise CoopqpError(f"{path}:{line[0]}: the trace is damaged: {what}") from None


def state_from_trace(
    path: Path, controller: str, tick: int, law: QPLaw, t_start: float = 0.0
) -> State:
    """The state that a tick of a written trace decided from; the law's tick repeats it.

    The gap is what the observer had made of the measured joints already, so it learns nothing more.

    Args:
        path: of ``trace.csv``.
        controller: whose.
        tick: which.
        law: gives the joints.
        t_start: when its phase began [s].

    Raises:
        CoopqpError: no such file, controller or tick.
    """
    joints = law.problem.chain.joint_names
    state = law.start()
    rows = _rows_of(path, controller)
    if tick not in rows:
        last = max(rows, default=0)
        raise InvalidValueError(
            f"{path}: controller '{controller}' has no tick {tick}; it has 0 to {last}"
        )
    with _open(path) as stream, _damage(path) as line:
        wanted = {rows[tick]: "now", rows.get(tick - 1, -1): "before"}
        for i, row in enumerate(csv.DictReader(stream)):
            line[0] += 1
            role = wanted.get(i)
            if role == "now":
                state.t = max(0.0, float(row["t"]) - t_start)  # of the phase, but for rounding
                told = bool(row.get(f"commanded[{joints[0]}]"))
                key = "commanded" if told else "q"
                state.q[:] = [float(row[f"{key}[{joint}]"]) for joint in joints]
                _read(row, "gap[", state.gap)
                if row.get(f"measured[{joints[0]}]"):
                    measured = [float(row[f"measured[{joint}]"]) for joint in joints]
                    state.q_measured = np.array(measured)
                    state.corrected = 0.0
                _read(row, "memory[", state.memory.numbers)
            elif role == "before":
                state.v[:] = [float(row[f"v[{joint}]"]) for joint in joints]
    state.update()
    return state


def _read(row: Mapping[str, str], start: str, numbers: Array) -> None:
    """Numbers from the columns whose names start so; nothing where they are empty."""
    found = [text for key, text in row.items() if key.startswith(start) and text]
    numbers[: len(found)] = [float(text) for text in found[: len(numbers)]]


def measured_joints(path: Path, controller: str, joints: Sequence[str], ticks: float) -> Array:
    """Where the sensors said that the joints are, tick by tick, shape (T, n) [rad, m].

    Ticks in which they said nothing are left out.

    Args:
        path: of ``trace.csv``.
        controller: whose.
        joints: names, shape (n,).
        ticks: only those before this one.

    Raises:
        CoopqpError: no such file or controller; the trace is of other joints.
    """
    if controller not in controllers_of(path):
        raise UnknownNameError("controller", controller, controllers_of(path), f"{path}: ")
    columns, found = [f"measured[{joint}]" for joint in joints], []
    with _open(path) as stream:
        reader = csv.DictReader(stream)
        for column in columns:
            if column not in (reader.fieldnames or ()):
                raise CoopqpError(
                    f"{path}: has no column '{column}'; it is of another scenario than the one "
                    "beside it, or was written before traces had measured joints: run it again"
                )
        for row in reader:
            told = row["controller"] == controller and all(row[column] for column in columns)
            if told and int(row["tick"]) < ticks:
                found.append([float(row[column]) for column in columns])
    values: Array = np.array(found, float).reshape(-1, len(columns))
    return np.asarray(values[np.isfinite(values).all(axis=1)], float)


def blocked_tick(path: Path, controller: str) -> int:
    """The tick worth explaining: the first that gave something up or failed, else the last.

    Raises:
        CoopqpError: no such file or controller.
    """
    if controller not in controllers_of(path):
        raise UnknownNameError("controller", controller, controllers_of(path), f"{path}: ")
    last = 0
    with _open(path) as stream, _damage(path) as line:
        for row in csv.DictReader(stream):
            line[0] += 1
            if row["controller"] != controller or not row.get("status"):
                continue
            if row["status"] not in (Status.OPTIMAL.name, Status.INACCURATE.name):
                return int(row["tick"])
            last = int(row["tick"])
    return last


def controllers_of(path: Path) -> list[str]:
    """Names of the controllers in a written trace, in their order.

    Raises:
        CoopqpError: no such file, or not a trace.
    """
    try:
        with _open(path) as stream:
            found = list(dict.fromkeys(row["controller"] for row in csv.DictReader(stream)))
    except (KeyError, UnicodeDecodeError, csv.Error):
        raise CoopqpError(f"{path}: is not a trace.csv written by 'coopqp compare --out'") from None
    return found


def _rows_of(path: Path, controller: str) -> dict[int, int]:
    """Row number of each tick of a controller."""
    with _open(path) as stream, _damage(path):
        return {
            int(row["tick"]): i
            for i, row in enumerate(csv.DictReader(stream))
            if row["controller"] == controller and row["tick_us"]
        }


def _open(path: Path) -> TextIO:
    try:
        return path.open(encoding="utf-8", newline="")
    except OSError as error:
        raise CoopqpError(f"{path}: cannot be read: {error.strerror}") from None
