"""What the playback draws of tasks and limits: their marks, frame by frame.

Those that move with the robot differ between controllers. Letters: f frames of a mark.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from coopqp.base.spec import Array
from coopqp.execution.instants import arm_points
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.marker import (
    CircleMarker,
    LineMarker,
    Marker,
    PlaneMarker,
    PointMarker,
    PoseMarker,
    PostureMarker,
    RelativeMarker,
    SolidMarker,
    SphereMarker,
    TrackedMarker,
    asked,
)
from coopqp.report.cells import plugin_name
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


@dataclass(frozen=True)
class Shown:
    """A mark in all frames in which it is seen, one after the other.

    Attributes:
        kind: one of KINDS, one of those that move with the robot, or SOLID.
        name: of the task or limit. values: what is drawn, in each frame from the first on.
    """

    kind: str
    name: str
    limit: bool
    first: int
    values: list[Json] = field(default_factory=list)

    @property
    def last(self) -> int:
        """Frame."""
        return self.first + len(self.values) - 1

    def stacked(self, key: str) -> Array:
        """One of the values in all frames, shape (f, ...)."""
        return np.array([values[key] for values in self.values], float)

    @property
    def frames(self) -> Json:
        """For ``playback.js``."""
        return {"first": self.first, "last": self.last}

    def as_json(self) -> Json:
        """For ``playback.js``."""
        values = {key: short(self.stacked(key)) for key in self.values[0]}
        return {"name": self.name, "limit": self.limit, **self.frames, **values}


def shown_marks(
    scenario: Scenario, frames: NDArray[np.int64], trace: Trace, faults: list[str]
) -> list[Shown]:
    """The marks of the tasks of all phases, and those of the limits; ``frames`` are ticks.

    What shows no mark or raises an error is left out, and a sentence added to the faults.
    """
    place, found = Place(scenario), []
    phases = np.searchsorted(scenario.first_ticks, frames, side="right") - 1
    for i, (phase, tick) in enumerate(zip(scenario.schedule, scenario.first_ticks, strict=True)):
        own = np.flatnonzero(phases == i).tolist()
        times = {k: float(trace.t[frames[k]]) - tick * scenario.dt for k in own}
        for task in phase.tasks:
            marks = {
                k: asked(task.name, partial(task.marks, trace.moment(int(frames[k]), t)), faults)
                for k, t in times.items()
            }
            found += _through_time(marks, task.name, place, limit=False)
        for limit in scenario.limits:
            name = plugin_name(limit)
            marks = {k: asked(name, partial(limit.marks, t), faults) for k, t in times.items()}
            found += _through_time(marks, name, place, limit=True)
    return found


def _through_time(
    marks: dict[int, tuple[Marker, ...]], name: str, place: Place, *, limit: bool
) -> list[Shown]:
    """Marks by frame, which may come and go; one that stays is one."""
    found: list[Shown] = []
    seen: dict[tuple[int, str], Shown] = {}
    for k, marks_then in marks.items():
        for i, mark in enumerate(marks_then):
            kind, values = place.drawn(mark)
            shown = seen.get((i, kind))
            if shown is None or shown.last < k - 1:
                shown = seen[i, kind] = Shown(kind, name, limit, k)
                found.append(shown)
            shown.values.append(values)
    return found


class Place:
    """Where what has no end is cut off: near the object's start."""

    def __init__(self, scenario: Scenario) -> None:
        self._start, self._size = scenario.chain.start_position, max(scenario.held.size)

    def drawn(self, mark: Marker) -> tuple[str, Json]:
        """The kind and what is drawn."""
        match mark:
            case PointMarker():
                return "goals", {"at": mark.at}
            case LineMarker():
                return self._line(mark)
            case PlaneMarker():
                return "planes", {"corners": self._patch(mark)}
            case CircleMarker():
                values = {"center": mark.center, "normal": mark.normal, "radius": mark.radius}
                return "circles", values
            case SphereMarker():
                return "spheres", {"center": mark.center, "radius": mark.radius}
            case SolidMarker():
                return SOLID, {"solid": mark}
            case PoseMarker():
                axes = {"axes": self._axes(mark.rotation)}
                where = mark.position
                return ("orientations", axes) if where is None else ("poses", {"at": where} | axes)
            case TrackedMarker() | PostureMarker() | RelativeMarker():
                return self._carried(mark)

    def _carried(self, mark: TrackedMarker | PostureMarker | RelativeMarker) -> tuple[str, Json]:
        """What moves with the robot."""
        match mark:
            case TrackedMarker():
                return TRACKED, {"point": mark.point}
            case PostureMarker():
                return POSTURE, {"goal": mark.goal}
        return RELATIVE, {"at": mark.position, "axes": self._axes(mark.rotation)}

    def _line(self, line: LineMarker) -> tuple[str, Json]:
        """Ends of a piece of it, or the way from the object."""
        d = line.direction
        way = LINE_SHARE * self._size * d
        if line.through is None:
            return "directions", {"way": way}
        middle = line.through + d * (d @ (self._start - line.through))
        return "lines", {"ends": [middle - way, middle + way]}

    def _axes(self, rotation: Array) -> Array:
        """The axes as rows."""
        axes: Array = AXES_SHARE * self._size * rotation.T
        return axes

    def _patch(self, plane: PlaneMarker) -> Array:
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
    """Tenths of a millimetre are enough to look at."""
    return np.nan_to_num(values, posinf=0.0, neginf=0.0).round(4).tolist()


def carried(
    marks: Sequence[Shown], scenario: Scenario, trace: Trace, frames: NDArray[np.int64]
) -> dict[str, list[Json]]:
    """By kind, for ``playback.js``."""
    found: dict[str, list[Json]] = {"tracked": [], "postures": [], "relatives": []}
    for mark in marks:
        own = frames[mark.first : mark.last + 1]
        if mark.kind == TRACKED:
            found["tracked"].append(mark.frames | {"points": _way(trace, mark, own)})
        elif mark.kind == POSTURE:
            arms = _posture(scenario, trace, mark, own)
            found["postures"] += [mark.frames | {"points": points} for points in arms]
        elif mark.kind == RELATIVE:
            found["relatives"].append(mark.frames | _relative(scenario, trace, mark, own))
    return found


def _way(trace: Trace, mark: Shown, own: NDArray[np.int64]) -> Any:
    """Of the point of the object that a task steers, f points."""
    turned = np.einsum("fij,fj->fi", trace.rotation[own], mark.stacked("point"))
    return short(trace.position[own] + turned)


def _posture(scenario: Scenario, trace: Trace, mark: Shown, own: NDArray[np.int64]) -> list[Any]:
    """Of each arm with a joint that has a goal, f times its joints and its hand."""
    chain = scenario.chain
    goals = np.array([posture(values["goal"], chain) for values in mark.values])
    asked = {
        name: values
        for name, values in zip(chain.joint_names, goals.T, strict=True)
        if np.isfinite(values).all()
    }
    q = trace.q[own].copy()
    for name, values in asked.items():
        q[:, trace.joints.index(name)] = values
    points = arm_points(chain, q)
    return [
        short(points[arm.name])
        for arm in chain.arms
        if set(asked) & set(chain.robot.arm_joints(arm))
    ]


def _relative(scenario: Scenario, trace: Trace, mark: Shown, own: NDArray[np.int64]) -> Json:
    """Origin and axes in the world, f each."""
    problems = list(scenario.problems(lambda first: np.asarray(trace.commanded[first])))
    phase = int(np.searchsorted(scenario.first_ticks, own[0], side="right")) - 1
    first = _object_of_first_arm(problems[phase].chain, trace.q[own])
    at, axes = mark.stacked("at"), mark.stacked("axes")
    return {
        "at": short(np.array([X.act(p) for X, p in zip(first, at, strict=True)])),
        "axes": short(np.array([A @ X.rotation.T for X, A in zip(first, axes, strict=True)])),
    }


def _object_of_first_arm(chain: ClosedChain, q: Array) -> list[pin.SE3]:
    """The object's pose as the first arm carries it."""
    data, poses = chain.model.createData(), []
    for row in q:
        pin.framesForwardKinematics(chain.model, data, row)
        poses.append(data.oMf[chain.frames[0]].copy())
    return poses
