"""What the playback of the page draws: robot, object and goals in some tens of frames.

Letters: f frames of a phase.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from coopqp.checked import Array, unit
from coopqp.comparison import Comparison
from coopqp.report.cells import length
from coopqp.report.figures import margin
from coopqp.report.scene.bodies import Body, body_places, robot_bodies
from coopqp.report.scene.view import view
from coopqp.report.style import styles
from coopqp.scenario.scenario import Scenario
from coopqp.task import Task
from coopqp.trace import Trace

Json = dict[str, Any]

MOST_FRAMES = 80
AT_LIMIT = 1e-4  # distance to a limit that is drawn as being at it [rad, m]
PLANE_SHARE = 0.65  # half edge of the patch drawn for a plane, in longest edges of the object
INSIDE, AT, BEYOND = 0, 1, 2


def scene(comparison: Comparison) -> Json:
    """Everything that is drawn, for ``playback.js``."""
    scenario, traces = comparison.scenario, comparison.traces
    first = next(iter(traces.values()))
    frames = frame_indices(len(first.t))
    looks = styles(traces)
    robot = scenario.chain.robot
    bodies, faults = robot_bodies(robot)
    shown = _shown(scenario, frames)
    goals = _goals(shown)
    moving = [body for body in bodies if body.joint > 0]
    return {
        "t": _short(first.t[frames]),
        "duration": float(first.t[-1]),
        "size": list(scenario.held.size),
        "view": view(comparison, bodies, [goal["at"] for goal in goals]),
        "bodies": [_body(body) for body in bodies],
        "notes": [*robot.warnings, *faults],
        "goals": goals,
        "planes": _planes(scenario, shown, first.t[frames]),
        "controllers": [
            {
                "name": name,
                "color": looks[name].color,
                **_motion(trace, scenario, frames),
                "poses": [
                    _short(np.concatenate([pin.SE3ToXYZQUAT(X) for X in places]))
                    for places in body_places(robot, moving, trace, frames)
                ],
                "tracked": [
                    {**part.frames, "points": _short(_tracked(part, trace, frames))}
                    for part in shown
                ],
            }
            for name, trace in traces.items()
        ],
    }


def frame_indices(rows: int) -> NDArray[np.int64]:
    """Which instants are shown, evenly spread, first and last among them."""
    return np.unique(np.linspace(0, rows - 1, min(rows, MOST_FRAMES)).round().astype(np.int64))


@dataclass(frozen=True)
class _Shown:
    """A task while its phase lasts.

    Attributes:
        task: what is shown.
        first, last: its phase's first and last frame.
        since: when the phase begins [s].
    """

    task: Task
    first: int
    last: int
    since: float

    @property
    def frames(self) -> Json:
        """For ``playback.js``."""
        return {"first": self.first, "last": self.last}


def _shown(scenario: Scenario, frames: NDArray[np.int64]) -> list[_Shown]:
    """The tasks of all phases that have a frame."""
    found = []
    phases = np.searchsorted(scenario.first_ticks, frames, side="right") - 1
    for i, (phase, tick) in enumerate(zip(scenario.schedule, scenario.first_ticks, strict=True)):
        own = np.flatnonzero(phases == i).tolist()
        if own:
            since = tick * scenario.dt
            found += [_Shown(task, own[0], own[-1], since) for task in phase.tasks]
    return found


def _body(body: Body) -> Json:
    """The surface in its joint's frame; the base's is in the world."""
    return {
        "moves": body.joint > 0,
        "arm": body.arm,
        "vertices": _short(body.surface.vertices.ravel()),
        "triangles": body.surface.corners.ravel().tolist(),
    }


def _motion(trace: Trace, scenario: Scenario, frames: NDArray[np.int64]) -> Json:
    state = joint_state(trace)
    chain = scenario.chain
    arms = []
    for arm in chain.arms:
        columns = [trace.joints.index(joint) for joint in chain.robot.arm_joints(arm)]
        arms.append(
            {
                "name": arm.name,
                "points": _short(trace.points[arm.name][frames]),
                "state": state[frames][:, columns].tolist(),
            }
        )
    return {
        "arms": arms,
        "position": _short(trace.position[frames]),
        "rotation": _short(trace.rotation[frames].reshape(-1, 9)),
        "readout": _readout(trace, frames),
    }


def joint_state(trace: Trace) -> NDArray[np.int64]:
    """Whether each joint is inside, at or beyond its limits, shape (T + 1, n)."""
    room = np.minimum(trace.q - trace.lower, trace.upper - trace.q)
    state: NDArray[np.int64] = np.select([room < -AT_LIMIT, room <= AT_LIMIT], [BEYOND, AT], INSIDE)
    return state


def _readout(trace: Trace, frames: NDArray[np.int64]) -> list[list[str]]:
    """Texts below each frame."""
    texts = []
    room = margin(trace)
    for k in frames:
        lines = []
        for task, error in zip(trace.tasks, trace.task_error[k], strict=True):
            if not np.isnan(error):  # a task of another phase
                value, name = length(float(error), task.unit)
                lines.append(f"{task.name} {value:.3g} {name} off")
        if np.isfinite(room[k]):
            lines.append(f"limit margin {room[k]:.3g} rad")
        texts.append(lines)
    return texts


def _tracked(part: _Shown, trace: Trace, frames: NDArray[np.int64]) -> Array:
    """The point of the object that a task steers, shape (f, 3) with f frames of its phase."""
    given: Any = getattr(part.task, "point", ())
    point = np.array(given if np.shape(given) == (3,) else (0.0, 0.0, 0.0))
    own = frames[part.first : part.last + 1]
    way: Array = trace.position[own] + trace.rotation[own] @ point
    return way


def _goals(shown: Sequence[_Shown]) -> list[Json]:
    goals = [(part, getattr(part.task, "goal", ())) for part in shown]
    return [
        {"name": part.task.name, "at": list(goal), **part.frames}
        for part, goal in goals
        if np.shape(goal) == (3,)
    ]


def _planes(scenario: Scenario, shown: Sequence[_Shown], t: Array) -> list[Json]:
    planes = []
    for part in shown:
        if hasattr(part.task, "normal") and hasattr(part.task, "through"):
            own = t[part.first : part.last + 1] - part.since
            corners = _short(_plane(part.task, scenario, own))
            planes.append({"name": part.task.name, "corners": corners, **part.frames})
    return planes


def _plane(task: Any, scenario: Scenario, t: Array) -> Array:
    """Corners of a patch of the task's plane, nearest to the object's start, shape (f, 4, 3)."""
    start = _start_position(scenario)
    half = PLANE_SHARE * max(scenario.held.size)
    velocity, turn = np.array(getattr(task, "velocity", np.zeros(3))), getattr(task, "turn", None)
    corners = np.zeros((len(t), 4, 3))
    for k, instant in enumerate(t.tolist()):
        n = unit(task.normal)
        if turn:
            share, _ = turn.profile.at(instant)
            n = pin.exp3(unit(turn.axis) * turn.radians * share) @ n
        through = np.array(task.through) + velocity * instant
        middle = start - n * (n @ (start - through))
        side = unit(tuple(np.cross(n, np.eye(3)[np.abs(n).argmin()])))
        other = np.cross(n, side)
        for i, (a, b) in enumerate(((1, 1), (-1, 1), (-1, -1), (1, -1))):
            corners[k, i] = middle + half * (a * side + b * other)
    return corners


def _start_position(scenario: Scenario) -> Array:
    """Of the object [m]."""
    chain = scenario.chain
    data = chain.model.createData()
    pin.framesForwardKinematics(chain.model, data, chain.q_start)
    return np.array(data.oMf[chain.frames[0]].translation)


def _short(values: Array) -> Any:
    """Tenths of a millimetre are enough to look at."""
    return np.nan_to_num(values, posinf=0.0, neginf=0.0).round(4).tolist()
