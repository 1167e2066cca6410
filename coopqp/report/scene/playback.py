"""What the playback of the page draws: robot, object, forces and markers in some tens of frames.

The arrow of a hand's force ends where the hand touches the object, that of the weight begins at the
centre of mass. Letters: m points, r rims.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from coopqp.assessment.limits import beyond
from coopqp.assessment.thresholds import AT_LIMIT
from coopqp.base.spec import Array
from coopqp.closed_loop.forces import squeezes
from coopqp.execution.comparison import Comparison
from coopqp.report.cells import length
from coopqp.report.figures.joints import joint_units, margin
from coopqp.report.scene.bodies import Body, body_places, joined, moved, robot_bodies, solid_body
from coopqp.report.scene.markers import SOLID, as_json, carried, in_view, short, shown_marks
from coopqp.report.style import styles
from coopqp.robot import RobotModel
from coopqp.scenario.scenario import Scenario
from coopqp.trace import Trace

Json = dict[str, Any]

GRAVITY = 9.81  # [m/s2]
LONGEST = 1.3  # length of the longest arrow, in longest edges of the object
ORDINARY = 0.95  # share of frames whose forces are drawn to scale; larger ones are cut off
MIN_FORCE = 1.0  # drawn with the length LONGEST, at least [N]
MAX_FRAMES = 80
INSIDE, AT, BEYOND = 0, 1, 2
WIDEST = 0.5  # times the size at the start; further out the view does not follow
SLICES = 8  # of what is shown, to find the largest scale at which it fits
DECIMALS = 4  # tenths of a millimetre


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
        "bodies": [_body(body) for body in bodies],
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


def _body(body: Body) -> Json:
    """The surface in its joint's frame; the base's is in the world."""
    return {
        "moves": body.joint > 0,
        "arm": body.arm,
        "vertices": short(body.surface.vertices.ravel()),
        "triangles": body.surface.corners.ravel().tolist(),
    }


def _motion(trace: Trace, scenario: Scenario, frames: NDArray[np.int64]) -> Json:
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
    mean: Array = np.concatenate([of[0] for of in points.values()]).mean(axis=0)
    return mean


def joint_state(trace: Trace) -> NDArray[np.int64]:
    """Whether each joint is inside, at or beyond its limits, shape (T + 1, n)."""
    out = beyond(trace)
    state: NDArray[np.int64] = np.select([out > AT_LIMIT, out >= -AT_LIMIT], [BEYOND, AT], INSIDE)
    return state


def _readout(trace: Trace, frames: NDArray[np.int64]) -> list[list[str]]:
    """Texts below each frame."""
    texts = []
    margins = {unit: margin(trace, unit) for unit in joint_units([trace])}
    for k in frames:
        lines = []
        errors = zip(trace.tasks, trace.goal_error[k], trace.task_error[k], strict=True)
        for task, goal, reference in errors:
            if not np.isnan(goal):  # a task of another phase
                (far, unit), (behind, _) = (length(float(e), task.unit) for e in (goal, reference))
                same = behind == far or trace.t[k] >= task.end
                way = "" if same else f", {behind:.3g} from its reference"
                lines.append(f"{task.name} {far:.3g} {unit} off{way}")
        left = [f"{m[k]:.3g} {unit}" for unit, m in margins.items() if np.isfinite(m[k])]
        if left:
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
    surfaces = [_vertices(comparison.scenario.chain.robot, bodies, trace) for trace in traces]
    everything = np.concatenate([*(points.reshape(-1, 3) for points in moving), *surfaces])
    everything = everything[np.isfinite(everything).all(axis=1)]
    near = np.clip(everything, starts.min(axis=0) - reach, starts.max(axis=0) + reach)
    shown = np.concatenate([near, goals])
    low, high = shown.min(axis=0), shown.max(axis=0)
    corners = {"low": low, "high": high, "rims": _rims(shown, 0.5 * (low + high))}
    return {name: values.round(DECIMALS).tolist() for name, values in corners.items()}


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


def _vertices(robot: RobotModel, bodies: Sequence[Body], trace: Trace) -> Array:
    """Of all bodies at the start and at the end, shape (m, 3) [m]."""
    ends = np.array([0, len(trace.t) - 1])
    surfaces = [
        moved(body.surface, X)
        for places in body_places(robot, bodies, trace, ends)
        for body, X in zip(bodies, places, strict=True)
    ]
    return joined(surfaces).vertices


def weight(scenario: Scenario) -> float:
    """Of the real object [N]."""
    return GRAVITY * scenario.held.mass * scenario.disturbance.object_mass


def squeeze_words(points: Array, wrenches: Array) -> str:
    """Such as "squeeze 60.0 N", by signals of the hands, (3 N,), (6 N,); empty if there is none."""
    forces = squeezes(points.reshape(-1, 3), wrenches.reshape(-1, 6))
    return f"squeeze {', '.join(f'{force:.3g}' for force in forces)} N" if forces else ""


def arrows(trace: Trace, scenario: Scenario, frames: NDArray[np.int64]) -> Json | None:
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
