"""Everything that people can steer: goals of tasks as inputs, by gizmos; gains as dials.

A task that asks for a point, a direction, a rotation or a pose, as a constant, gets an input that
begins there: until somebody drags, the motion is that of the scenario. A scenario that has inputs
already is played with these alone. A gizmo may steer two fields, such as a plane's point and
normal: its position is the one, its z axis the other.

A :class:`Recording` is what was sent while a scenario was played, as one that ``coopqp compare``
replays. OUT/scenario.yaml is the scenario with an input for everything that can be dragged,
OUT/inputs/NAME.csv what has arrived at it, tick by tick: t, sent and the columns of its kind.
"""

import tempfile
import typing
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import reduce
from operator import getitem
from pathlib import Path
from typing import Any

import numpy as np

from coopqp.base.errors import CoopqpError, InvalidValueError
from coopqp.base.spec import Array, Pose, spec
from coopqp.grasp import pose_matrix
from coopqp.limits import ObjectSpeed
from coopqp.model.marker import RelativeMarker
from coopqp.model.profile import Profile
from coopqp.model.state import State
from coopqp.model.trajectory_filter import RAMPS, VELOCITIES, MotionLimits
from coopqp.recordings.csv_file import FOLDER, InputRows, fed, file_name
from coopqp.report.files import write_one
from coopqp.scenario.input import Arrival, InputSettings
from coopqp.scenario.scenario import MAX_KEPT, Scenario
from coopqp.scenario.yaml import as_yaml, parsed
from coopqp.signal import (
    DIRECTION,
    ROTATION,
    Instant,
    Kind,
    Moment,
    Reads,
    Signal,
    Trajectory,
    quaternion_of,
    trajectory_of,
)
from coopqp.signals import Input
from coopqp.task import Task
from coopqp.viewer.messages import Dial, Gizmo, Key

KAPPA = "kappa"
SQUEEZE = "squeeze"
#: Least upper ends of sliders; twice a scenario's value where that is more.
MAX_GAIN, MAX_WEIGHT, MAX_PRIORITY = 20.0, 10.0, 3
MIN_GAIN, STEPS = 0.1, 200  # smallest gain [1/s], and steps of a slider


@dataclass(frozen=True)
class SteeredField:
    """A field of a task that follows an input."""

    name: str  # of the input
    phase: int  # index
    task: int  # index in its phase
    field: str
    kind: Kind  # of its values
    # the constant that it replaces, as in a file; None for a scenario's own input
    start: tuple[float, ...] | None = None


@spec
class Fixed(Signal):
    """The target of an input, as a constant of any kind."""

    value: list[float]
    """As many numbers as are needed."""

    def bind(self, kind: Kind, start: Instant, here: Array | None) -> Trajectory:
        return Trajectory(kind, kind.read(self.value))

    @property
    def rest(self) -> float:
        return 0.0


def with_inputs(scenario: Scenario) -> tuple[Scenario, tuple[SteeredField, ...]]:
    """The scenario with inputs for everything that can be dragged, and the fields they steer."""
    if scenario.inputs:
        return scenario, tuple(_own(scenario))
    state, steered = State(scenario.chain), list[SteeredField]()

    def with_own(task: Task, i: int, j: int) -> Task:
        name = f"{scenario.schedule[i].name} {task.name}".strip()
        changed, own = _with_inputs(task, name, (i, j), state)
        steered.extend(own)
        return changed

    changed = _with_tasks(scenario, with_own)
    settings = InputSettings(**input_limits(scenario))
    return replace(changed, inputs={field.name: settings for field in steered}), tuple(steered)


def _with_tasks(scenario: Scenario, changed: Callable[[Task, int, int], Task]) -> Scenario:
    """The scenario with other tasks, each made of one with the indices of its phase and itself."""
    phases = tuple(
        replace(phase, tasks=tuple(changed(task, i, j) for j, task in enumerate(phase.tasks)))
        for i, phase in enumerate(scenario.schedule)
    )
    own: Any = {"phases": phases} if scenario.phases else {"tasks": phases[0].tasks}
    return replace(scenario, **own)


def input_limits(scenario: Scenario) -> dict[str, Any]:
    """Speed limits of inputs: those of the scenario's object_speed, as far as a filter may have."""
    limits: dict[str, Any] = {}
    usual = MotionLimits()
    for limit in (limit for limit in scenario.limits if isinstance(limit, ObjectSpeed)):
        linear = "velocity", limit.linear, usual.acceleration
        angular = "angular_velocity", limit.angular, usual.angular_acceleration
        for key, speed, acceleration in (linear, angular):
            if speed:
                slowest = max(VELOCITIES[0], RAMPS[0] * acceleration)
                limits[key] = min(max(speed, slowest), VELOCITIES[1])
    return limits


def at_targets(task: Task, targets: Mapping[str, Array]) -> Task:
    """A task whose goal is the target of its inputs, without a profile on the way there."""

    def fixed(value: Any) -> Any:
        if isinstance(value, dict):
            return {key: fixed(each) for key, each in value.items()}
        if isinstance(value, Input) and value.name in targets:
            return Fixed(value=targets[value.name].tolist())
        return value

    values = ((field.name, getattr(task, field.name)) for field in fields(task))
    changes = {key: fixed(value) for key, value in values if isinstance(value, dict | Input)}
    if isinstance(task.way, Profile):
        changes["profile"] = Profile(kind="step")
    return replace(task, **changes) if changes else task


def _followed_fields(task: Task) -> Iterator[tuple[str, Kind]]:
    """Fields of a task that can follow a signal with a position or an orientation."""
    for name, hint in typing.get_type_hints(type(task), include_extras=True).items():
        for note in getattr(hint, "__metadata__", ()):
            if isinstance(note, Reads) and note.kind is not None:
                yield name, note.kind


def _own(scenario: Scenario) -> Iterator[SteeredField]:
    for i, phase in enumerate(scenario.schedule):
        for j, task in enumerate(phase.tasks):
            for name, kind in _followed_fields(task) if not task.of_forces else ():
                value = getattr(task, name)
                if isinstance(value, Input):
                    yield SteeredField(value.name, i, j, name, kind)


def _with_inputs(
    task: Task, name: str, place: tuple[int, int], start: State
) -> tuple[Task, list[SteeredField]]:
    """A task with inputs for its constants, as far as it can follow any."""
    if task.of_forces or any(isinstance(mark, RelativeMarker) for mark in task.marks(Moment(0.0))):
        return task, []  # without a place, or relative to an arm that moves
    steered: list[SteeredField] = []
    constants = [
        (key, kind, value)
        for key, kind in _followed_fields(task)
        if (value := _constant(task, key, kind)) is not None
    ]
    for key, kind, value in constants:
        own = name if len(constants) == 1 else f"{name} {key}"
        changes: dict[str, Any] = {key: Input(name=own, start=list(value))}
        if kind is ROTATION and hasattr(task, "rpy"):
            changes |= {"rpy": None, "rpy_deg": None}
        try:
            other = replace(task, **changes)
            other.bind(start)
        except CoopqpError:  # it moves by itself already, or cannot say where it begins
            continue
        task = other
        steered.append(SteeredField(own, *place, key, kind, value))
    return task, steered


def _constant(task: Task, field: str, kind: Kind) -> tuple[float, ...] | None:
    """The constant in a field, as a file would have it; None where there is none."""
    value = getattr(task, field)
    angles: dict[str, Any] = {key: getattr(task, key, None) for key in ("rpy", "rpy_deg")}
    if kind is ROTATION and value is None and any(angles.values()):
        return tuple(np.asarray(quaternion_of(pose_matrix(Pose(**angles)).rotation)).tolist())
    if kind is ROTATION or value is None or isinstance(value, Signal):
        return None
    if kind is DIRECTION:
        return tuple(value)
    return tuple(trajectory_of(value, kind, Moment()).value.tolist())


@dataclass(frozen=True)
class Handle:
    """A gizmo, the point of the object that its task moves [m], and the fields that it steers."""

    gizmo: Gizmo
    point: Array
    steered: list[SteeredField]

    def pose(self, targets: Mapping[str, Array], state: State) -> Array:
        """Its pose, shape (7,)."""
        place, turn = state.point(self.point), np.array([0.0, 0.0, 0.0, 1.0])
        for field in self.steered:
            value = targets.get(field.name)
            if value is None:
                continue
            if field.kind.numbers:
                place = value[:3]
            if field.kind.turns:
                turn = value[field.kind.numbers :]
        return np.concatenate([place, turn])

    def sent(self, pose: Sequence[float]) -> Iterator[tuple[str, list[float]]]:
        """Values of its inputs at a pose x, y, z, qx, qy, qz, qw."""
        for field in self.steered:
            kind, place, turn = field.kind, list(pose[:3]), list(pose[3:])
            if kind.axis:
                yield field.name, Trajectory(kind, np.array(turn)).R[:, 2].tolist()
            else:
                yield field.name, place * bool(kind.numbers) + turn * kind.turns

    def carried(self, place: Sequence[float], targets: Mapping[str, Array], state: State) -> Array:
        """The pose for which the object's origin goes to a place, turned as before."""
        lever = state.R_WO @ self.point
        return np.concatenate([np.array(place) + lever, self.pose(targets, state)[3:]])


def handles(scenario: Scenario, steered: Sequence[SteeredField]) -> tuple[Handle, ...]:
    """One for each task of which something can be dragged."""
    by_task: dict[tuple[int, int], list[SteeredField]] = {}
    for field in steered:
        by_task.setdefault((field.phase, field.task), []).append(field)
    every = []
    for (phase, number), own in by_task.items():
        task = scenario.schedule[phase].tasks[number]
        moves, turns = any(f.kind.numbers for f in own), any(f.kind.turns for f in own)
        point = np.array(getattr(task, "point", (0.0, 0.0, 0.0)), float)
        every.append(Handle(Gizmo(task.name, phase, moves, turns), point, own))
    return tuple(every)


def dials_of(scenario: Scenario) -> Iterator[Dial]:
    """Gains, weights, priorities, squeezes and kappa."""
    for i, phase in enumerate(scenario.schedule):
        for j, task in enumerate(phase.tasks):
            place, group = ("tasks", i, j), ": ".join(filter(None, (phase.name, task.name)))
            yield from _dials_of(task, place, group, scenario.dt)
            if task.mode == "soft":
                high, now = float(max(MAX_PRIORITY, task.priority)), float(task.priority)
                yield Dial((*place, "priority"), group, "priority, 0 is first", 0.0, high, 1.0, now)
    for i, task in enumerate(scenario.secondary):
        yield from _dials_of(task, ("secondary", i), task.name, scenario.dt)
    now = scenario.drift_gain
    high = max(1.0 / scenario.dt, now)  # which rounding may tell apart
    yield Dial((KAPPA,), "loop", "kappa, drift gain [1/s]", 0.0, high, high / STEPS, now)


def _dials_of(task: Task, place: Key, group: str, dt: float) -> Iterator[Dial]:
    force = getattr(task, SQUEEZE, None) if task.of_forces else None
    if isinstance(force, float | int) and force > 0.0:
        high = 2.0 * force
        yield Dial((*place, SQUEEZE), group, "squeeze [N]", 0.0, high, high / STEPS, force)
    if not (task.asks_velocity or task.of_forces or task.impedance):
        high = max(min(max(MAX_GAIN, 2.0 * task.gain), 1.0 / dt), task.gain)
        low = min(MIN_GAIN, task.gain)
        step = (high - low) / STEPS
        yield Dial((*place, "gain"), group, "gain [1/s]", low, high, step, task.gain)
    high = max(MAX_WEIGHT, 2.0 * task.weight)
    yield Dial((*place, "weight"), group, "weight", 0.0, high, high / STEPS, task.weight)


def with_dials(scenario: Scenario, values: Mapping[Key, float]) -> Scenario:
    """The scenario with the values of its dials, by key."""
    if not values:
        return scenario

    def changed(task: Task, *place: str | int) -> Task:
        keys = {name: (*place, name) for name in ("gain", "weight", "priority", SQUEEZE)}
        given: dict[str, Any] = {n: values[key] for n, key in keys.items() if key in values}
        if "priority" in given:
            given["priority"] = round(given["priority"])
        return replace(task, **given) if given else task

    secondary = tuple(changed(t, "secondary", i) for i, t in enumerate(scenario.secondary))
    other = _with_tasks(scenario, lambda task, i, j: changed(task, "tasks", i, j))
    return replace(other, secondary=secondary, kappa=values.get((KAPPA,), scenario.kappa))


FILE = "scenario.yaml"


def check_folder(folder: Path) -> None:
    """Raise a CoopqpError for a folder that has a session or cannot be written to."""
    try:
        if (folder / FILE).exists() or (folder / FOLDER).exists():
            raise CoopqpError(f"--record: '{folder}' holds a session already; name another folder")
        there = next(path for path in (folder, *folder.absolute().parents) if path.exists())
        with tempfile.TemporaryDirectory(dir=there) as trial:
            (Path(trial) / folder.name).mkdir(exist_ok=True)
    except (OSError, ValueError) as error:
        why = f"{getattr(error, 'strerror', None) or error}; name another folder"
        raise CoopqpError(f"--record: cannot write to '{folder}': {why}") from error


class Recording:
    """What is recorded so far: ticks of each phase; the note says why it has ended."""

    def __init__(
        self,
        scenario: Scenario,
        steered: Sequence[SteeredField],
        controllers: Sequence[str],
        dials: Mapping[Key, float],
    ) -> None:
        self._scenario, self._steered, self._names = scenario, steered, controllers
        self._dials = dict(dials)
        self.ticks, self.note = [0], ""
        self._sent: dict[str, InputRows] = {}
        joints = len(scenario.robot_model.joint_names)
        self._max_ticks = MAX_KEPT // (joints * max(1, len(controllers)))

    @property
    def seconds(self) -> float:
        return sum(self.ticks) * self._scenario.dt

    def add(
        self, phase: int, since: float, t: float, sent: Iterable[Arrival], kinds: Mapping[str, Kind]
    ) -> None:
        if self.note:
            return
        if sum(self.ticks) >= self._max_ticks:
            self.note = f"is full after {self.seconds:.0f} s"
            return
        while len(self.ticks) <= phase:
            self.ticks.append(0)
        self.ticks[phase] += 1
        for name, value, when in sent:
            kept = self._sent.setdefault(name, InputRows(kinds[name]))
            kept.add(since + t, since + when, value)

    def end(self, why: str) -> None:
        """Record no more; what there is can be saved."""
        self.note = self.note or why

    def save(self, folder: Path) -> Path:
        """Write it; raise a CoopqpError where that is not possible, or nothing is recorded."""
        if sum(self.ticks) <= 1:  # the first is decided before anybody looks
            raise InvalidValueError("nothing has been played yet, so nothing is recorded")
        try:
            (folder / FOLDER).mkdir(parents=True, exist_ok=True)
        except OSError as error:
            reason = error.strerror or str(error)
            raise CoopqpError(f"cannot write the recording to '{folder}': {reason}") from error
        names: dict[str, str] = {}
        for name, sent in self._sent.items():
            names[name] = file_name(name, names.values())
            write_one(folder / FOLDER / names[name], sent.header + sent.lines())
        played = f"{self._scenario.name}, played for {self.seconds:.3f} s"
        text = f"# {played}; coopqp compare replays it.\n{as_yaml(self._data(names, folder))}"
        write_one(folder / FILE, text)
        return folder / FILE

    def _data(self, names: Mapping[str, str], folder: Path) -> dict[str, Any]:
        """The scenario file as a mapping, with what was played."""
        scenario = self._scenario
        data = dict(parsed(Path(scenario.name), scenario.source).data)
        if scenario.folder is not None:
            data["folder"] = str(scenario.folder)
        phases = self._phases(data)
        secondary = [_spelled(slot) for slot in data.get("secondary", [])]
        slots: Any = {"tasks": [phase["tasks"] for phase in phases], "secondary": secondary}
        for (*place, name), value in self._dials.items():
            if place[:1] == ["tasks"] and place[1] not in range(len(phases)):
                continue  # of a phase that was not played
            slot: Any = reduce(getitem, place, slots) if place else {KAPPA: data}
            (fields,) = slot.values()
            fields[name] = round(value) if name == "priority" else value
        if secondary:
            data["secondary"] = secondary
        inputs = dict(data.get("inputs") or {})
        for field in self._steered:
            if field.start and field.phase < len(phases):
                (fields,) = phases[field.phase]["tasks"][field.task].values()
                for other in ("rpy", "rpy_deg") if field.kind is ROTATION else ():
                    fields.pop(other, None)
                fields[field.field] = {"input": {"name": field.name, "start": list(field.start)}}
                inputs.setdefault(field.name, input_limits(scenario))
        base = Path() if scenario.folder is None else folder.resolve()
        paths = {name: str(base / FOLDER / file) for name, file in names.items()}
        if inputs:
            data["inputs"] = fed(inputs, paths)
        own = list(scenario.controllers)
        given = data.get("controllers") or own
        data["controllers"] = [given[own.index(n)] if n in own else n for n in self._names]
        return data

    def _phases(self, data: dict[str, Any]) -> list[dict[str, Any]]:
        """Put the phases that were played into the mapping, with their durations."""
        phases, schedule = [], self._scenario.schedule
        for given, phase, n in zip(data.get("phases", [data]), schedule, self.ticks, strict=False):
            end = max((task.end for task in phase.tasks), default=0.0)
            tasks = [*map(_spelled, given["tasks"])]
            phases.append(given | {"duration": max(n * self._scenario.dt, end), "tasks": tasks})
        data |= {"phases": phases} if "phases" in data else phases[0]
        return phases


def _spelled(slot: Any) -> dict[str, Any]:
    if isinstance(slot, str):
        return {slot: {}}
    ((name, fields),) = slot.items()
    return {name: dict(fields or {})}
