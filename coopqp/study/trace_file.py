"""Reading a recorded run back: runs, ticks and states.

A file that is damaged, or of another scenario, is refused with the line that shows it.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from coopqp.assessment.ends import settled
from coopqp.checked import Array
from coopqp.controller import Law
from coopqp.errors import CoopqpError, InvalidValueError, UnknownNameError, one_line
from coopqp.input import wanted
from coopqp.recordings.column import split
from coopqp.recordings.csv_file import CsvFile
from coopqp.recordings.known import controllers_of, format_of
from coopqp.scenario.scenario import Scenario
from coopqp.signal import Course, Followed
from coopqp.solver import HALTS, Status, causes_of
from coopqp.state import State
from coopqp.study.explanation.leg import Recording
from coopqp.study.trace_checks import strange_tick, units_of_parts
from coopqp.trace import InputTrace, no_input

LOOP = ("position", "orientation")
#: A joint beyond it, or faster, is damage [rad, m; rad/s, m/s].
FARTHEST = 1e12
#: Times of two phases that are the same may differ by this [s].
ROUNDING = 1e-9
#: After what a live loop's time stands still.
_STANDS = {status.name for status in (*HALTS, Status.NOT_MEASURED, Status.NOT_BEGUN, Status.RAISED)}
OTHER = "the trace is damaged, or it is of another scenario than the one beside it: run it again"


@dataclass(frozen=True)
class _Row:
    """A row of a trace.

    Attributes:
        place: file and line.
        header: file and line of the columns' names.
        cells: texts by column.
    """

    place: str
    header: str
    cells: Mapping[str, str]

    def number(self, column: str, *, nan: bool = False) -> float:
        """A finite number.

        Args:
            column: whose.
            nan: whether NaN counts too: what a sensor that fails measured, or a task that raised.

        Raises:
            InvalidValueError: no such column, or no such number there.
        """
        text = self.cells.get(column)
        if text is None:
            raise InvalidValueError(f"{self.header}: has no column '{column}'; {OTHER}")
        try:
            value = float(text)
        except ValueError:
            value = math.inf
        if not (math.isfinite(value) or (nan and math.isnan(value))):
            words = f"{column}: found '{one_line(text[:40])}', needs a finite number"
            raise InvalidValueError(f"{self.place}: {words}; the trace is damaged")
        return value

    def numbers(self, key: str, joints: Sequence[str], *, nan: bool = False) -> list[float]:
        """A number a joint.

        Raises:
            InvalidValueError: one is missing, or so large that no joint has it.
        """
        found = [self.number(f"{key}[{joint}]", nan=nan) for joint in joints]
        for joint, value in zip(joints, found, strict=True):
            if abs(value) > FARTHEST:
                words = f"{key}[{joint}]: found {value:g}, where no joint can be"
                raise InvalidValueError(f"{self.place}: {words}; the trace is damaged")
        return found

    def tells(self, key: str, joints: Sequence[str]) -> bool:
        """Whether there is anything in a joint's column."""
        return any(self.cells.get(f"{key}[{joint}]") for joint in joints)

    @property
    def errors(self) -> dict[str, float]:
        """Errors of the tasks that count here."""
        return {
            key.removeprefix("error[").removesuffix("]"): self.number(key, nan=True)
            for key, text in self.cells.items()
            if key.startswith("error[") and text
        }

    @property
    def tick(self) -> int:
        """Which tick."""
        value = self.number("tick")
        if not (value >= 0.0 and value.is_integer()):
            raise InvalidValueError(f"{self.place}: tick: found {value:g}, needs a whole number")
        return int(value)

    @property
    def causes(self) -> str:
        """What became of the tick, in the words of :func:`coopqp.solver.written`."""
        word = self.cells["status"]
        for name in word.split("+"):
            if name not in Status.__members__:
                words = f"status: no status '{one_line(name[:40])}'; the trace is damaged"
                raise InvalidValueError(f"{self.place}: {words}")
        return word


def recording_from_trace(path: Path, scenario: Scenario, controller: str) -> Recording:
    """A controller's whole run.

    Args:
        path: of ``trace.csv``, or of a run in another format.
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
    rows = list(_rows(path, controller))
    if len(rows) != ticks + 1:
        raise CoopqpError(
            f"{rows[min(ticks + 1, len(rows) - 1)].place}: '{controller}' has {len(rows) - 1} "
            f"ticks, its scenario {ticks}; the file is damaged, of another scenario, or of a live "
            "loop, of which only a tick can be explained: name it with --tick"
        )
    tau = [_torques(row, joints) for row in rows[:-1]] if rows[0].tells("tau", joints) else [[]]
    q = np.array([row.numbers("q", joints) for row in rows])
    v = np.array([row.numbers("v", joints) for row in rows[:-1]])
    wrong = strange_tick(held, [row.number("t") for row in rows], q, v)
    if wrong:
        k, words = wrong
        raise CoopqpError(f"{rows[k].place}: {words}; {OTHER}")
    units, errors = units_of_parts(held), _errors(rows)
    if missing := sorted(units.keys() - errors.keys()):
        raise CoopqpError(f"{rows[0].header}: has no error of '{missing[0]}'; {OTHER}")
    return Recording(
        controller=controller,
        q=q,
        v=v,
        status=tuple(row.causes for row in rows[:-1]),
        errors={
            name: float(settled(np.array(found), units.get(name, ""), held.dt).max())
            for name, found in errors.items()
        },
        tau=np.array(tau),
        loop=np.array([[row.number(f"loop_{of}", nan=True) for of in LOOP] for row in rows]),
        inputs=_inputs(rows[:-1], held),
        place=rows[0].header,
    )


def check_trace(path: Path, scenario: Scenario, controller: str) -> None:
    """Refuse a controller's run that is damaged, or of another scenario.

    A live loop's run, which is in no CSV file, is as long as it was, with gaps where nobody ticked.

    Args:
        path: of ``trace.csv``, or of a run in another format.
        scenario: that it was written for.
        controller: whose.

    Raises:
        CoopqpError: no such file or controller, or a damaged file.
    """
    if isinstance(format_of(path), CsvFile):
        recording_from_trace(path, scenario, controller)
    for row in _rows(path, controller):
        row.number("t")


def _inputs(rows: Sequence[_Row], scenario: Scenario) -> dict[str, InputTrace]:
    """What was followed, by name."""
    found = {}
    for name, kind in scenario.followed().items():
        kept = found[name] = no_input(kind, len(rows))
        for k, row in enumerate(rows):
            _read(row, f"followed[{name}].", kept.value[k])
            _read(row, f"followed_rate[{name}].", kept.rate[k])
            if row.cells.get(f"input[{name}].sent"):
                kept.sent[k] = row.number(f"input[{name}].sent")
    return found


def _torques(row: _Row, joints: Sequence[str]) -> list[float]:
    """A torque a joint; zero where the column is empty, as for passive joints."""
    return [row.number(f"tau[{j}]") if row.cells.get(f"tau[{j}]") else 0.0 for j in joints]


def _errors(rows: Sequence[_Row]) -> dict[str, list[float]]:
    """Each task's errors at the instants for which it counts."""
    found: dict[str, list[float]] = {}
    for row in rows:
        for name, error in row.errors.items():
            found.setdefault(name, []).append(error)
    return found


def state_from_trace(
    path: Path, controller: str, tick: int, law: Law, t_start: float = 0.0
) -> State:
    """The state that a tick of a written trace decided from; the law's tick repeats it.

    The gap is what the observer had made of the measured joints already, and who squeezes of the
    forces, so neither adds to it.

    Args:
        path: of ``trace.csv``, or of a run in another format.
        controller: whose.
        tick: which.
        law: gives the joints.
        t_start: when its phase began [s].

    Raises:
        CoopqpError: no such file, controller or tick; a damaged row.
    """
    joints = law.problem.chain.joint_names
    state, found, last, before = law.start(), False, 0, tick == 0
    for row in _rows(path, controller):
        if not row.cells["tick_us"]:
            continue
        k = row.tick
        last = max(last, k)
        if k == tick:
            found = True
            state.t = max(0.0, row.number("t") - t_start)  # of the phase, but for rounding
            state.q[:] = row.numbers("commanded" if row.tells("commanded", joints) else "q", joints)
            _read(row, "gap[", state.gap)
            if row.tells("measured", joints):
                state.q_measured = np.array(row.numbers("measured", joints, nan=True))
                state.corrected = 0.0
            if Status.FORCE_NOT_MEASURED.name not in row.causes.split("+"):
                state.hand_wrench = np.zeros(6 * len(law.problem.chain.robot.arms))
            _read(row, "memory[", state.memory.numbers)
            _read_inputs(row, law, state)
        elif k == tick - 1:
            state.v[:], before = row.numbers("v", joints), True
    if found and not before:
        words = f"has tick {tick}, but not the one before it, which it follows from"
        raise InvalidValueError(f"{path}: controller '{controller}' {words}")
    if not found:
        raise InvalidValueError(
            f"{path}: controller '{controller}' has no tick {tick}; it has 0 to {last}"
        )
    state.update()
    return state


def _read_inputs(row: _Row, law: Law, state: State) -> None:
    """What was made of the inputs, into a state."""
    problem, followed = law.problem, Followed()
    for name, (kind, _) in wanted(
        (*problem.tasks, *problem.wrenches, *problem.secondary), law.start()
    ).items():
        if not any(key.startswith(f"followed[{name}].") and row.cells[key] for key in row.cells):
            continue
        followed[name] = Course(kind, kind.zero)
        _read(row, f"followed[{name}].", followed[name].value)
        _read(row, f"followed_rate[{name}].", followed[name].rate)
    causes = row.causes.split("+")
    if Status.INPUT_STALE.name in causes:
        followed.stale = tuple(followed)
    if Status.INPUT_REFUSED.name in causes:
        followed.refused = tuple(followed)
    state.inputs = followed


def halted(path: Path, controller: str, tick: int) -> str:
    """What became of a tick in which a live loop came to rest, and its law did nothing.

    Its time stands still then, so that is how it shows.

    Args:
        path: of a live loop's recording, or of a run.
        controller: whose.
        tick: which.

    Returns:
        Its causes, as written; empty where the law was asked.

    Raises:
        CoopqpError: no such file, or a damaged row.
    """
    found: _Row | None = None
    for row in _rows(path, controller):
        if found is not None:
            return found.causes if row.number("t") <= found.number("t") else ""
        if row.cells["tick_us"] and row.tick == tick:
            if HALTS.intersection(causes_of(row.causes)):
                return row.causes
            found = row
    return ""


def recorded_velocity(path: Path, controller: str, tick: int) -> dict[str, float]:
    """What was commanded in a tick, by joint [rad/s, m/s].

    Raises:
        CoopqpError: no such file, or a damaged row.
    """
    for row in _rows(path, controller):
        if row.cells["tick_us"] and row.tick == tick:
            parts = ((split(key), key) for key, text in row.cells.items() if text)
            return {part[1]: row.number(key) for part, key in parts if part[0] == "v"}
    return {}


def _read(row: _Row, start: str, numbers: Array) -> None:
    """Numbers from the columns whose names start so; nothing where they are empty."""
    columns = [key for key, text in row.cells.items() if key.startswith(start) and text]
    found = [row.number(column) for column in columns[: len(numbers)]]
    numbers[: len(found)] = found


def measured_joints(path: Path, controller: str, joints: Sequence[str], ticks: float) -> Array:
    """Where the sensors said that the joints are, tick by tick, shape (T, n) [rad, m].

    Ticks in which they said nothing are left out.

    Args:
        path: of ``trace.csv``, or of a run in another format.
        controller: whose.
        joints: names, shape (n,).
        ticks: only those before this one.

    Raises:
        CoopqpError: no such file or controller; the trace is of other joints; a damaged row.
    """
    if controller not in controllers_of(path):
        raise UnknownNameError("controller", controller, controllers_of(path), f"{path}: ")
    found = []
    for row in _rows(path, controller):
        sensed = any(key.startswith("measured[") for key in row.cells)
        if not sensed or all(row.cells.get(f"measured[{joint}]") == "" for joint in joints):
            continue
        measured = row.numbers("measured", joints, nan=True)
        if row.tick < ticks:
            found.append(measured)
    values: Array = np.array(found, float).reshape(-1, len(joints))
    return np.asarray(values[np.isfinite(values).all(axis=1)], float)


def blocked_tick(path: Path, controller: str) -> int:
    """The tick worth explaining: the first that gave something up or failed, else the last.

    Raises:
        CoopqpError: no such file or controller; a damaged row.
    """
    if controller not in controllers_of(path):
        raise UnknownNameError("controller", controller, controllers_of(path), f"{path}: ")
    last = 0
    for row in _rows(path, controller):
        status = row.cells["status"]
        if not status:
            continue
        if status not in (Status.OPTIMAL.name, Status.INACCURATE.name):
            return row.tick
        last = row.tick
    return last


def _rows(path: Path, controller: str | None = None) -> Iterator[_Row]:
    """The rows of a controller; all if None.

    Raises:
        CoopqpError: no such file, not a trace, a row with too few or too many cells, or ticks that
            do not follow each other.
    """
    last = dict[str, tuple[float, str]]()
    for found in format_of(path).rows(path):
        row = _Row(found.place, found.header or found.place, found.texts)
        _check_time(row, last)
        if controller in (None, row.cells["controller"]):
            yield row


def _check_time(row: _Row, last: dict[str, tuple[float, str]]) -> None:
    """Refuse time that goes back, or stands still without a reason.

    Args:
        row: the next one.
        last: by controller, its last time and what became of that tick; written.
    """
    name, t = row.cells["controller"], row.number("t")
    then, causes = last.get(name, (-math.inf, ""))
    if t <= then and not (t >= then - ROUNDING and _STANDS.intersection(causes.split("+"))):
        words = f"t: found {t:g} after {then:g}; the trace is damaged"
        raise InvalidValueError(f"{row.place}: {words}")
    last[name] = t, row.cells["status"]
