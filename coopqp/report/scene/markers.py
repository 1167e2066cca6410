"""What the playback draws of tasks and limits: their markers, frame by frame.

Those that move with the robot differ between controllers. Letters: f frames of a marker.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from coopqp.base.spec import Array, type_name
from coopqp.execution.instants import arm_points
from coopqp.model import marker
from coopqp.model.marker import Marker, asked
from coopqp.scenario.scenario import Scenario
from coopqp.tasks.posture import posture
from coopqp.trace import Trace

Json = dict[str, Any]

#: Half edge of the patch drawn for a plane, half length of the piece of a line, and length of the
#: axes of a pose, in longest edges of the object.
PLANE_SHARE, LINE_SHARE, AXES_SHARE = 0.65, 1.0, 0.5

KINDS = (
    "goals", "lines", "directions", "planes", "circles", "spheres", "poses", "orientations"
)  # fmt: skip
#: Which of its values say where it is.
PLACES = {
    "goals": "at", "poses": "at", "circles": "center", "spheres": "center", "planes": "corners",
    "lines": "ends",
}  # fmt: skip
#: What moves with the robot, and so differs between controllers.
TRACKED, POSTURE, RELATIVE = "tracked", "posture", "relative"
#: What stands still, and is drawn as the robot is.
SOLID = "solid"
#: Kinds of markers whose fields are drawn as they are.
AS_THEY_ARE: dict[type, str] = {
    marker.PointMarker: "goals", marker.CircleMarker: "circles", marker.SphereMarker: "spheres",
    marker.TrackedMarker: TRACKED, marker.PostureMarker: POSTURE,
}  # fmt: skip


@dataclass(frozen=True)
class Shown:
    """A marker of a task or limit in consecutive frames; its kind is one of KINDS, or above."""

    kind: str
    name: str
    limit: bool
    first: int
    values: list[Json] = field(default_factory=list)

    @property
    def frames(self) -> Json:
        """The first and the last one."""
        return {"first": self.first, "last": self.first + len(self.values) - 1}

    def stacked(self, key: str) -> Array:
        """One of the values in all frames, shape (f, ...)."""
        return np.array([values[key] for values in self.values], float)

    def as_json(self) -> Json:
        values = {key: short(self.stacked(key)) for key in self.values[0]}
        return {"name": self.name, "limit": self.limit, **self.frames, **values}


def shown_marks(
    scenario: Scenario, frames: NDArray[np.int64], trace: Trace, faults: list[str]
) -> list[Shown]:
    """The markers of the tasks of all phases and of the limits, at ticks; errors become faults."""
    place, every = Place(scenario), []
    phases = np.searchsorted(scenario.first_ticks, frames, side="right") - 1
    for i, (phase, tick) in enumerate(zip(scenario.schedule, scenario.first_ticks, strict=True)):
        own = np.flatnonzero(phases == i).tolist()
        times = {k: float(trace.t[frames[k]]) - tick * scenario.dt for k in own}
        for task in phase.tasks:
            marks = {
                k: asked(task.name, partial(task.marks, trace.moment(int(frames[k]), t)), faults)
                for k, t in times.items()
            }
            every += _through_time(marks, task.name, place, limit=False)
        for limit in scenario.limits:
            name = type_name(type(limit))
            marks = {k: asked(name, partial(limit.marks, t), faults) for k, t in times.items()}
            every += _through_time(marks, name, place, limit=True)
    return every


def _through_time(
    marks: dict[int, tuple[Marker, ...]], name: str, place: Place, *, limit: bool
) -> list[Shown]:
    """Markers by frame, which may come and go; one that stays is one."""
    every: list[Shown] = []
    current: dict[tuple[int, str], Shown] = {}
    for k, marks_then in marks.items():
        for i, mark in enumerate(marks_then):
            kind, values = place.drawn(mark)
            shown = current.get((i, kind))
            if shown is None or shown.frames["last"] < k - 1:
                shown = current[i, kind] = Shown(kind, name, limit, k)
                every.append(shown)
            shown.values.append(values)
    return every


class Place:
    """Draws markers; what has no end is cut off near the object's start."""

    def __init__(self, scenario: Scenario) -> None:
        self._start, self._size = scenario.chain.start_position, max(scenario.held.size)

    def drawn(self, mark: Marker) -> tuple[str, Json]:
        """The kind and what is drawn."""
        match mark:
            case marker.LineMarker():
                return self._line(mark)
            case marker.PlaneMarker():
                return "planes", {"corners": self._patch(mark)}
            case marker.SolidMarker():
                return SOLID, {"solid": mark}
            case marker.PoseMarker(position=None):
                return "orientations", {"axes": self._axes(mark.rotation)}
            case marker.PoseMarker() | marker.RelativeMarker():
                kind = "poses" if isinstance(mark, marker.PoseMarker) else RELATIVE
                return kind, {"at": mark.position, "axes": self._axes(mark.rotation)}
        return AS_THEY_ARE[type(mark)], vars(mark)

    def _line(self, line: marker.LineMarker) -> tuple[str, Json]:
        """Ends of a piece of it, or a vector from the object."""
        d = line.direction
        way = LINE_SHARE * self._size * d
        if line.through is None:
            return "directions", {"way": way}
        middle = line.through + d * (d @ (self._start - line.through))
        return "lines", {"ends": [middle - way, middle + way]}

    def _axes(self, rotation: Array) -> Array:
        axes: Array = AXES_SHARE * self._size * rotation.T
        return axes

    def _patch(self, plane: marker.PlaneMarker) -> Array:
        """Corners of a patch of a plane, shape (4, 3) [m]."""
        n = plane.normal
        middle = self._start - n * (n @ (self._start - plane.through))
        side = np.cross(n, np.eye(3)[np.abs(n).argmin()])
        side /= np.linalg.norm(side)
        other = np.cross(n, side)
        signs = ((1, 1), (-1, 1), (-1, -1), (1, -1))
        half = PLANE_SHARE * self._size
        corners: Array = middle + half * np.array([a * side + b * other for a, b in signs])
        return corners


def as_json(marks: Sequence[Shown]) -> dict[str, list[Json]]:
    """By kind, for ``playback.js``."""
    return {kind: [mark.as_json() for mark in marks if mark.kind == kind] for kind in KINDS}


def in_view(marks: Sequence[Shown]) -> Array:
    """Points that a picture must not leave out, shape (p, 3) [m]."""
    shown = [mark for mark in marks if mark.kind in PLACES and not mark.limit]
    points = [mark.stacked(PLACES[mark.kind]).reshape(-1, 3) for mark in shown]
    return np.concatenate([*points, np.zeros((0, 3))])


def short(values: Array) -> Any:
    """Rounded to tenths of a millimetre, with zeros for what is not finite."""
    return np.nan_to_num(values, posinf=0.0, neginf=0.0).round(4).tolist()


def carried(
    marks: Sequence[Shown], scenario: Scenario, trace: Trace, frames: NDArray[np.int64]
) -> dict[str, list[Json]]:
    """By kind, for ``playback.js``."""
    every: dict[str, list[Json]] = {"tracked": [], "postures": [], "relatives": []}
    for mark in marks:
        own = frames[mark.first : mark.first + len(mark.values)]
        if mark.kind == TRACKED:
            moved = np.einsum("fij,fj->fi", trace.rotation[own], mark.stacked("point"))
            every["tracked"].append(mark.frames | {"points": short(trace.position[own] + moved)})
        elif mark.kind == POSTURE:
            arms = _posture(scenario, trace, mark, own)
            every["postures"] += [mark.frames | {"points": points} for points in arms]
        elif mark.kind == RELATIVE:
            every["relatives"].append(mark.frames | _relative(scenario, trace, mark, own))
    return every


def _posture(scenario: Scenario, trace: Trace, mark: Shown, own: NDArray[np.int64]) -> list[Any]:
    """Of each arm with a joint that has a goal, f times its joints and its hand."""
    chain, q, moved = scenario.chain, trace.q[own].copy(), set()
    goals = np.array([posture(values["goal"], chain) for values in mark.values])
    for name, values in zip(chain.joint_names, goals.T, strict=True):
        if np.isfinite(values).all():
            q[:, trace.joints.index(name)] = values
            moved.add(name)
    points = arm_points(chain, q)
    arms = (arm for arm in chain.arms if moved & set(chain.robot.arm_joints(arm)))
    return [short(points[arm.name]) for arm in arms]


def _relative(scenario: Scenario, trace: Trace, mark: Shown, own: NDArray[np.int64]) -> Json:
    """Origin and axes in the world, f each."""
    problems = list(scenario.problems(lambda first: np.asarray(trace.commanded[first])))
    phase = int(np.searchsorted(scenario.first_ticks, own[0], side="right")) - 1
    chain, at, axes = problems[phase].chain, [], []
    data = chain.model.createData()
    for q, values in zip(trace.q[own], mark.values, strict=True):
        pin.framesForwardKinematics(chain.model, data, q)
        X = data.oMf[chain.frames[0]]  # the object as the first arm carries it
        at.append(X.act(np.asarray(values["at"], float)))
        axes.append(values["axes"] @ X.rotation.T)
    return {"at": short(np.array(at)), "axes": short(np.array(axes))}
