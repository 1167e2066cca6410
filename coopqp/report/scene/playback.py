"""What the playback of the page draws: robot, object, forces and markers in some tens of frames.

The arrow of a hand's force ends where the hand touches the object, that of the weight begins at the
centre of mass. Markers of tasks and limits that move with the robot differ between controllers.

Letters: m points, r rims, f frames of a marker.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np
import pinocchio as pin

from coopqp.assessment.limits import beyond
from coopqp.assessment.thresholds import AT_LIMIT
from coopqp.base.spec import Array, type_name
from coopqp.closed_loop.forces import squeezes
from coopqp.execution.comparison import Comparison
from coopqp.execution.instants import arm_points
from coopqp.model import marker
from coopqp.model.marker import Marker, marks_of
from coopqp.report.cells import length
from coopqp.report.curves import Json, styles
from coopqp.report.figures.joints import joint_units, margin
from coopqp.report.scene.bodies import Body, body_places, moved, robot_bodies, solid_body
from coopqp.robot import RobotModel
from coopqp.robot_files.meshes import Ints
from coopqp.scenario.scenario import Scenario
from coopqp.tasks.posture import posture
from coopqp.trace import Trace

GRAVITY = 9.81  # [m/s2]
LONGEST = 1.3  # length of the longest arrow, in longest edges of the object
ORDINARY = 0.95  # share of frames whose forces are drawn to scale; larger ones are cut off
MIN_FORCE = 1.0  # drawn with the length LONGEST, at least [N]
MAX_FRAMES = 80
INSIDE, AT, BEYOND = 0, 1, 2
WIDEST = 0.5  # times the size at the start; further out the view does not follow
SLICES = 8  # of what is shown, to find the largest scale at which it fits

#: Half edge of the patch drawn for a plane, half length of the piece of a line, and length of the
#: axes of a pose, in longest edges of the object.
PLANE_SHARE, LINE_SHARE, AXES_SHARE = 0.65, 1.0, 0.5

KINDS = ("goals", "lines", "directions", "planes", "circles", "spheres", "poses", "orientations")
#: Which of its values say where it is.
PLACES = {
    "goals": "at", "poses": "at", "circles": "center", "spheres": "center", "planes": "corners",
    "lines": "ends",
}  # fmt: skip
#: What moves with the robot, and so differs between controllers.
TRACKED, POSTURE, RELATIVE = "tracked", "posture", "relative"
SOLID = "solid"  # what stands still, and is drawn as the robot is
#: Kinds of markers whose fields are drawn as they are.
AS_THEY_ARE: dict[type, str] = {
    marker.PointMarker: "goals", marker.CircleMarker: "circles", marker.SphereMarker: "spheres",
    marker.TrackedMarker: TRACKED, marker.PostureMarker: POSTURE,
}  # fmt: skip


class Place:
    """Draws markers; what has no end is cut off near the object's start."""

    def __init__(self, scenario: Scenario) -> None:
        self._start, self._size = scenario.chain.start_position, max(scenario.held.size)

    def drawn(self, mark: Marker) -> tuple[str, Json]:
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
        return AXES_SHARE * self._size * rotation.T

    def _patch(self, plane: marker.PlaneMarker) -> Array:
        """Corners of a patch of a plane, shape (4, 3) [m]."""
        n = plane.normal
        middle = self._start - n * (n @ (self._start - plane.through))
        side = np.cross(n, np.eye(3)[np.abs(n).argmin()])
        side /= np.linalg.norm(side)
        other = np.cross(n, side)
        signs = ((1, 1), (-1, 1), (-1, -1), (1, -1))
        half = PLANE_SHARE * self._size
        return middle + half * np.array([a * side + b * other for a, b in signs])


def scene(comparison: Comparison) -> Json:
    """Everything that is drawn, for ``playback.js``."""
    scenario, traces = comparison.scenario, comparison.traces
    first = next(iter(traces.values()))
    last = len(first.t) - 1
    frames = np.unique(np.linspace(0, last, min(last + 1, MAX_FRAMES)).round().astype(np.int64))
    looks = styles(traces)
    robot = scenario.chain.robot
    bodies, faults = robot_bodies(robot)
    undrawn: list[str] = []
    marks = shown_marks(scenario, frames, first, undrawn)
    solids = [mark.values[0]["solid"] for mark in marks if mark.kind == SOLID]
    bodies = (*bodies, *map(solid_body, solids))
    moving = [body for body in bodies if body.joint > 0]
    return {
        "t": short(first.t[frames]),
        "duration": float(first.t[-1]),
        "size": list(scenario.held.size),
        "view": view(comparison, bodies, in_view(marks)),
        "bodies": [
            {
                "moves": body.joint > 0,
                "arm": body.arm,
                "vertices": short(body.surface.vertices.ravel()),
                "triangles": body.surface.corners.ravel().tolist(),
            }
            for body in bodies
        ],
        "notes": [*robot.warnings, *faults, *dict.fromkeys(undrawn)],
        **as_json(marks),
        "controllers": [
            {
                "name": name,
                "color": looks[name].color,
                **_motion(trace, scenario, frames),
                "forces": arrows(trace, scenario, frames),
                "poses": [
                    short(np.concatenate([np.zeros(0), *map(pin.SE3ToXYZQUAT, places)]))
                    for places in body_places(robot, moving, trace, frames)
                ],
                **carried(marks, scenario.held_by(name), trace, frames),
            }
            for name, trace in traces.items()
        ],
    }


def _motion(trace: Trace, scenario: Scenario, frames: Ints) -> Json:
    state, robot = joint_state(trace), scenario.chain.robot
    places, middle = label_places(robot, trace.points), short(_middle(trace.points))
    columns = {a.name: [trace.joints.index(j) for j in robot.arm_joints(a)] for a in robot.arms}
    return {
        "arms": [
            {
                "name": name,
                "points": short(trace.points[name][frames]),
                "state": state[frames][:, joints].tolist(),
                "label": places[name],
                "middle": middle,
            }
            for name, joints in columns.items()  # as the bodies number them
        ],
        "position": short(trace.position[frames]),
        "rotation": short(trace.rotation[frames].reshape(-1, 9)),
        "readout": _readout(trace, frames),
    }


def label_places(robot: RobotModel, points: Mapping[str, Array]) -> dict[str, int]:
    """At which of its points, joints base first and then the hand, each arm's name stands.

    Of the joints that no other arm has it is the one farthest from the middle of all arms at the
    start; the hand where an arm shares all its joints. Points by arm, shape (T + 1, p, 3) [m].
    """
    middle = _middle(points)
    joints = {arm.name: robot.arm_joints(arm) for arm in robot.arms}
    counts = Counter(joint for of in joints.values() for joint in of)
    places = {}
    for name, of in joints.items():
        away = np.linalg.norm(points[name][0] - middle, axis=1)
        own = [i for i, joint in enumerate(of) if counts[joint] == 1]
        places[name] = max(own, key=lambda i: float(away[i])) if own else len(of)
    return places


def _middle(points: Mapping[str, Array]) -> Array:
    """Of all arms at the start, shape (3,) [m]."""
    return np.asarray(np.concatenate([of[0] for of in points.values()]).mean(axis=0))


def joint_state(trace: Trace) -> Ints:
    """Whether each joint is inside, at or beyond its limits, shape (T + 1, n)."""
    out = beyond(trace)
    return np.select([out > AT_LIMIT, out >= -AT_LIMIT], [BEYOND, AT], INSIDE)


def _readout(trace: Trace, frames: Ints) -> list[list[str]]:
    texts, margins = [], {unit: margin(trace, unit) for unit in joint_units([trace])}
    for k in frames:
        lines = []
        errors = zip(trace.tasks, trace.goal_error[k], trace.task_error[k], strict=True)
        for task, goal, reference in errors:
            if not np.isnan(goal):  # a task of another phase
                (far, unit), (behind, _) = (length(float(e), task.unit) for e in (goal, reference))
                same = behind == far or trace.t[k] >= task.end
                way = "" if same else f", {behind:.3g} from its reference"
                lines.append(f"{task.name} {far:.3g} {unit} off{way}")
        if left := [f"{m[k]:.3g} {unit}" for unit, m in margins.items() if np.isfinite(m[k])]:
            lines.append(f"limit margin {', '.join(left)}")
        if k > 0 and "hand_wrench" in trace.signals:
            signals = (trace.signals[name][k - 1] for name in ("hand_point", "hand_wrench"))
            lines += filter(None, [squeeze_words(*signals)])
        texts.append(lines)
    return texts


def view(comparison: Comparison, bodies: Sequence[Body], goals: Array) -> dict[str, Any]:
    """Lowest and highest corner of what is shown, and its rims; without what is far away."""
    traces, half = comparison.traces.values(), 0.5 * max(comparison.scenario.held.size)
    moving = [points for trace in traces for points in trace.points.values()]
    for trace in traces:
        moving += [trace.position[:, None] - half, trace.position[:, None] + half]
    starts = np.concatenate([points[0] for points in moving])
    reach = WIDEST * np.ptp(starts, axis=0).max()
    robot = comparison.scenario.chain.robot
    surfaces = [
        moved(body.surface, X).vertices
        for trace in traces
        for places in body_places(robot, bodies, trace, np.array([0, len(trace.t) - 1]))
        for body, X in zip(bodies, places, strict=True)
    ]
    everything = np.concatenate([*(points.reshape(-1, 3) for points in moving), *surfaces])
    everything = everything[np.isfinite(everything).all(axis=1)]
    near = np.clip(everything, starts.min(axis=0) - reach, starts.max(axis=0) + reach)
    shown = np.concatenate([near, goals])
    low, high = shown.min(axis=0), shown.max(axis=0)
    return {"low": short(low), "high": short(high), "rims": short(_rims(shown, 0.5 * (low + high)))}


def _rims(points: Array, middle: Array) -> Array:
    """What the points reach when turned about z: heights and radii, shape (r, 2)."""
    x, y, z = (points - middle).T
    radius, half = np.hypot(x, y), np.ptp(z) / (2 * SLICES)
    rims = []
    for height in np.linspace(z.min(), z.max(), SLICES + 1):
        near = np.abs(z - height) <= half
        if near.any():
            rims += [(end, radius[near].max()) for end in (z[near].min(), z[near].max())]
    return np.array(rims)


def weight(scenario: Scenario) -> float:
    """Of the real object [N]."""
    return GRAVITY * scenario.held.mass * scenario.disturbance.object_mass


def squeeze_words(points: Array, wrenches: Array) -> str:
    """Such as "squeeze 60.0 N", by signals of the hands, (3 N,), (6 N,); empty if there is none."""
    forces = squeezes(points.reshape(-1, 3), wrenches.reshape(-1, 6))
    return f"squeeze {', '.join(f'{force:.3g}' for force in forces)} N" if forces else ""


def arrows(trace: Trace, scenario: Scenario, frames: Ints) -> Json | None:
    """Start and way of each arrow in each frame, for ``playback.js``; None without forces."""
    if "hand_wrench" not in trace.signals or not trace.ticks:
        return None
    points = trace.signals["hand_point"].reshape(trace.ticks, -1, 3)
    forces = trace.signals["hand_wrench"].reshape(trace.ticks, -1, 6)[:, :, :3]
    down = weight(scenario)
    sizes = np.nan_to_num(np.linalg.norm(forces, axis=2).max(axis=1))
    longest = max(float(np.quantile(sizes, ORDINARY)), down, MIN_FORCE)
    scale = LONGEST * max(scenario.held.size) / longest
    before = frames[frames > 0] - 1
    shown = np.nan_to_num(forces[before])
    length_of = np.linalg.norm(shown, axis=2, keepdims=True)
    ways = scale * (shown * np.minimum(1.0, longest / np.maximum(length_of, 1e-9)))
    starts = np.where((ways != 0.0).any(axis=2, keepdims=True), points[before] - ways, 0.0)
    hands = np.zeros((len(frames), points.shape[1], 6))
    hands[frames > 0] = np.concatenate([starts, ways], axis=2)
    own = np.array(scenario.held.com) + scenario.disturbance.object_com  # of the real object [m]
    com = trace.position[frames] + trace.rotation[frames] @ own
    falls = np.tile([0.0, 0.0, -scale * down], (len(frames), 1))
    return {"hands": short(hands), "weight": short(np.concatenate([com, falls], axis=1))}


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
        return {"first": self.first, "last": self.first + len(self.values) - 1}

    def stacked(self, key: str) -> Array:
        """One of the values in all frames, shape (f, ...)."""
        return np.array([values[key] for values in self.values], float)

    def as_json(self) -> Json:
        values = {key: short(self.stacked(key)) for key in self.values[0]}
        return {"name": self.name, "limit": self.limit, **self.frames, **values}


def shown_marks(scenario: Scenario, frames: Ints, trace: Trace, faults: list[str]) -> list[Shown]:
    """The markers of the tasks of all phases and of the limits, at ticks; errors become faults."""
    place, every = Place(scenario), list[Shown]()
    phases = np.searchsorted(scenario.first_ticks, frames, side="right") - 1
    for i, (phase, tick) in enumerate(zip(scenario.schedule, scenario.first_ticks, strict=True)):
        own = np.flatnonzero(phases == i).tolist()
        times = {k: float(trace.t[frames[k]]) - tick * scenario.dt for k in own}
        sources: list[Any] = [(task, task.name, False) for task in phase.tasks]
        sources += [(limit, type_name(type(limit)), True) for limit in scenario.limits]
        for source, name, limit in sources:
            current: dict[tuple[int, str], Shown] = {}  # which may come and go
            for k, t in times.items():
                at = t if limit else trace.moment(int(frames[k]), t)
                for n, mark in enumerate(marks_of(name, partial(source.marks, at), faults)):
                    kind, values = place.drawn(mark)
                    last = current.get((n, kind))
                    if last is None or last.frames["last"] < k - 1:
                        last = current[n, kind] = Shown(kind, name, limit, k)
                        every.append(last)
                    last.values.append(values)
    return every


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


def carried(marks: Sequence[Shown], scenario: Scenario, trace: Trace, frames: Ints) -> Json:
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


def _posture(scenario: Scenario, trace: Trace, mark: Shown, own: Ints) -> list[Any]:
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


def _relative(scenario: Scenario, trace: Trace, mark: Shown, own: Ints) -> Json:
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
