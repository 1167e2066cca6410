"""Constants of tasks become inputs, so that what a task goes to can be dragged, by gizmos.

A task that asks for a point, a direction, a rotation or a pose, as a constant, gets an input that
begins there: until somebody drags, the motion is that of the scenario. A scenario that has inputs
already is played with these alone. A gizmo may steer two fields, such as a plane's point and
normal: its place is the one, its third axis the other.
"""

from __future__ import annotations

import typing
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from coopqp.base.errors import CoopqpError
from coopqp.base.spec import Array, Pose, spec
from coopqp.grasp import pose_matrix
from coopqp.limits import ObjectSpeed
from coopqp.model.geometry import pose_trajectory
from coopqp.model.marker import RelativeMarker
from coopqp.model.profile import Profile
from coopqp.model.state import State
from coopqp.model.trajectory_filter import RAMPS, VELOCITIES, MotionLimits
from coopqp.scenario.input import InputSettings
from coopqp.scenario.scenario import Phase, Scenario
from coopqp.signal import (
    DIRECTION,
    POSE,
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
from coopqp.viewer.messages import Gizmo

NOT_TURNED = (0.0, 0.0, 0.0, 1.0)


@dataclass(frozen=True)
class Live:
    """A field of a task that follows an input.

    Attributes:
        name: of the input. kind: of its values.
        phase, task, field: which field of which task, by their order.
        start: where it begins, as a file has it; None where the scenario's own input says that.
    """

    name: str
    phase: int
    task: int
    field: str
    kind: Kind
    start: tuple[float, ...] | None = None

    @property
    def made(self) -> bool:
        """Whether the scenario has a constant there."""
        return self.start is not None


@spec
class Fixed(Signal):
    """What an input goes to, as a constant of any kind."""

    value: list[float]
    """As many numbers as are needed."""

    def bind(self, kind: Kind, start: Instant, here: Array | None) -> Trajectory:
        """It stays."""
        return Trajectory(kind, kind.read(self.value))

    @property
    def rest(self) -> float:
        """At once [s]."""
        return 0.0


def with_inputs(scenario: Scenario) -> tuple[Scenario, tuple[Live, ...]]:
    """The scenario with everything that can be dragged as an input, and what that is."""
    if scenario.inputs:
        return scenario, tuple(_own(scenario))
    state = State(scenario.chain)
    lives: list[Live] = []
    schedule = []
    for i, phase in enumerate(scenario.schedule):
        tasks = []
        for j, task in enumerate(phase.tasks):
            changed, found = _loosened(task, f"{phase.name} {task.name}".strip(), (i, j), state)
            tasks.append(changed)
            lives += found
        schedule.append(replace(phase, tasks=tuple(tasks)))
    pace = InputSettings(**pace_of(scenario))
    inputs = {live.name: pace for live in lives}
    return replace(with_schedule(scenario, schedule), inputs=inputs), tuple(lives)


def with_schedule(scenario: Scenario, schedule: Sequence[Phase]) -> Scenario:
    """The scenario with other phases, or with the tasks of the only one."""
    if scenario.phases:
        return replace(scenario, phases=tuple(schedule))
    return replace(scenario, tasks=tuple(schedule[0].tasks))


def pace_of(scenario: Scenario) -> dict[str, Any]:
    """How fast inputs that are made may go, as far as the scenario's limits and the limiter say."""
    found: dict[str, Any] = {}
    usual = MotionLimits()
    for limit in (limit for limit in scenario.limits if isinstance(limit, ObjectSpeed)):
        for key, speed, acceleration in (
            ("velocity", limit.linear, usual.acceleration),
            ("angular_velocity", limit.angular, usual.angular_acceleration),
        ):
            if speed:
                least = max(VELOCITIES[0], RAMPS[0] * acceleration)
                found[key] = min(max(speed, least), VELOCITIES[1])
    return found


def at_targets(task: Task, targets: Mapping[str, Array]) -> Task:
    """A task with what its inputs go to as its goal, and its reference there at once."""
    changes: dict[str, Any] = {}
    for part in fields(task):
        value = getattr(task, part.name)
        if isinstance(value, dict):
            inside = {key: _fixed(each, targets) for key, each in value.items()}
            if inside != value:
                changes[part.name] = inside
        elif isinstance(value, Input):
            changes[part.name] = _fixed(value, targets)
    if isinstance(task.way, Profile):
        changes["profile"] = Profile(kind="step")
    return replace(task, **changes) if changes else task


def _fixed(value: Any, targets: Mapping[str, Array]) -> Any:
    if isinstance(value, Input) and value.name in targets:
        return Fixed(value=targets[value.name].tolist())
    return value


def followed_fields(task: Task) -> Iterator[tuple[str, Kind]]:
    """Fields of a task that can follow a signal with a place or a turn, and of which kind."""
    for name, hint in typing.get_type_hints(type(task), include_extras=True).items():
        for note in getattr(hint, "__metadata__", ()):
            if isinstance(note, Reads) and note.kind is not None:
                yield name, note.kind


def _own(scenario: Scenario) -> Iterator[Live]:
    """What the scenario itself lets inputs say."""
    for i, phase in enumerate(scenario.schedule):
        for j, task in enumerate(phase.tasks):
            for name, kind in followed_fields(task) if not task.of_forces else ():
                value = getattr(task, name)
                if isinstance(value, Input):
                    yield Live(value.name, i, j, name, kind)


def _loosened(
    task: Task, name: str, place: tuple[int, int], start: State
) -> tuple[Task, list[Live]]:
    """A task with inputs for its constants, as far as it can follow any."""
    if task.of_forces or any(isinstance(mark, RelativeMarker) for mark in task.marks(Moment(0.0))):
        return task, []  # without a place, or seen from an arm that moves
    found: list[Live] = []
    constants = [
        (key, kind, value)
        for key, kind in followed_fields(task)
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
        found.append(Live(own, *place, key, kind, value))
    return task, found


def _constant(task: Task, field: str, kind: Kind) -> tuple[float, ...] | None:
    """The constant in a field, as a file would have it; None where there is none."""
    value = getattr(task, field)
    if isinstance(value, Signal):
        return None
    if kind is ROTATION:
        return _rotation(task) if value is None else None
    if value is None:
        return None
    if kind is DIRECTION:
        return tuple(value)
    now = Moment()
    found = pose_trajectory(value, now) if kind is POSE else trajectory_of(value, kind, now)
    return tuple(found.value.tolist())


def _rotation(task: Task) -> tuple[float, ...] | None:
    """The rotation of a task that has it as angles."""
    rpy, rpy_deg = getattr(task, "rpy", None), getattr(task, "rpy_deg", None)
    if rpy is None and rpy_deg is None:
        return None
    R = pose_matrix(Pose(rpy=rpy, rpy_deg=rpy_deg)).rotation
    return tuple(np.asarray(quaternion_of(R)).tolist())


@dataclass(frozen=True)
class Handle:
    """A gizmo, the point of the object that its task moves [m], and the fields that it steers."""

    look: Gizmo
    point: Array
    lives: list[Live]

    def pose(self, targets: Mapping[str, Array], state: State) -> Array:
        """Where it is, shape (7,)."""
        place, turn = state.point(self.point), np.array(NOT_TURNED)
        for live in self.lives:
            value = targets.get(live.name)
            if value is None:
                continue
            if live.kind.numbers:
                place = value[:3]
            if live.kind.turns:
                turn = value[live.kind.numbers :]
        return np.concatenate([place, turn])

    def sent(self, pose: Sequence[float]) -> Iterable[tuple[str, list[float]]]:
        """What its tasks are sent for a pose x, y, z, qx, qy, qz, qw, by input."""
        for live in self.lives:
            kind, turn = live.kind, np.array(pose[3:])
            if kind.axis:
                yield live.name, Trajectory(kind, turn).R[:, 2].tolist()
                continue
            place = list(pose[:3]) if kind.numbers else []
            yield live.name, place + (turn.tolist() if kind.turns else [])

    def carried(self, place: Sequence[float], targets: Mapping[str, Array], state: State) -> Array:
        """The pose with which the object's origin goes to a place, turned as before."""
        lever = state.R_WO @ self.point
        return np.concatenate([np.array(place) + lever, self.pose(targets, state)[3:]])


def handles(scenario: Scenario, lives: Sequence[Live]) -> tuple[Handle, ...]:
    """One for each task of which something can be dragged."""
    found = []
    for phase, number in dict.fromkeys((live.phase, live.task) for live in lives):
        task = scenario.schedule[phase].tasks[number]
        own = [live for live in lives if (live.phase, live.task) == (phase, number)]
        moves, turns = any(o.kind.numbers for o in own), any(o.kind.turns for o in own)
        point = np.array(getattr(task, "point", (0.0, 0.0, 0.0)), float)
        found.append(Handle(Gizmo(task.name, phase, moves, turns), point, own))
    return tuple(found)
