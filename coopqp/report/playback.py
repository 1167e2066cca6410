"""What the playback of the page draws: arms, object and goals in some tens of frames.

Letters: F frames, p points of an arm.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from coopqp.comparison import Comparison
from coopqp.report.cells import length
from coopqp.report.figures import margin
from coopqp.report.style import styles
from coopqp.scenario import Scenario
from coopqp.spec import unit
from coopqp.task import Task
from coopqp.trace import Trace

Array = NDArray[np.float64]
Json = dict[str, Any]

MOST_FRAMES = 80
AT_LIMIT = 1e-4  # distance to a limit that is drawn as being at it [rad, m]
WIDEST = 0.5  # times the size at the start; further out the view does not follow
PLANE_SHARE = 0.65  # half edge of the patch drawn for a plane, in longest edges of the object
INSIDE, AT, BEYOND = 0, 1, 2


def scene(comparison: Comparison) -> Json:
    """Everything that is drawn, for ``playback.js``."""
    scenario, traces = comparison.scenario, comparison.traces
    first = next(iter(traces.values()))
    frames = frame_indices(len(first.t))
    looks = styles(traces)
    return {
        "t": _short(first.t[frames]),
        "duration": float(first.t[-1]),
        "size": list(scenario.held.size),
        "view": _view(comparison),
        "goals": _goals(scenario.tasks),
        "planes": [
            {"name": task.name, "corners": _short(_plane(task, scenario, first.t[frames]))}
            for task in scenario.tasks
            if hasattr(task, "normal") and hasattr(task, "through")
        ],
        "controllers": [
            {"name": name, "color": looks[name].color, **_motion(trace, scenario, frames)}
            for name, trace in traces.items()
        ],
    }


def frame_indices(rows: int) -> NDArray[np.int64]:
    """Which instants are shown, evenly spread, first and last among them."""
    return np.unique(np.linspace(0, rows - 1, min(rows, MOST_FRAMES)).round().astype(np.int64))


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
        "tracked": [_short(_tracked(task, trace, frames)) for task in scenario.tasks],
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
            value, name = length(float(error), task.unit)
            lines.append(f"{task.name} {value:.3g} {name} off")
        if np.isfinite(room[k]):
            lines.append(f"limit margin {room[k]:.3g} rad")
        texts.append(lines)
    return texts


def _tracked(task: Task, trace: Trace, frames: NDArray[np.int64]) -> Array:
    """The point of the object that a task steers, shape (F, 3)."""
    given: Any = getattr(task, "point", ())
    point = np.array(given if np.shape(given) == (3,) else (0.0, 0.0, 0.0))
    moved: Array = trace.position[frames] + trace.rotation[frames] @ point
    return moved


def _goals(tasks: Sequence[Task]) -> list[Json]:
    goals = [(task.name, getattr(task, "goal", ())) for task in tasks]
    return [{"name": name, "at": list(goal)} for name, goal in goals if np.shape(goal) == (3,)]


def _plane(task: Any, scenario: Scenario, t: Array) -> Array:
    """Corners of a patch of the task's plane, nearest to the object's start, shape (F, 4, 3)."""
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


def _view(comparison: Comparison) -> Json:
    """Lowest and highest corner of what is shown: all that moves, unless something flies away."""
    scenario, half = comparison.scenario, 0.5 * max(comparison.scenario.held.size)
    moving = [points for trace in comparison.traces.values() for points in trace.points.values()]
    for trace in comparison.traces.values():
        moving += [trace.position[:, None] - half, trace.position[:, None] + half]
    starts = np.concatenate([points[0] for points in moving])
    reach = WIDEST * np.ptp(starts, axis=0).max()
    everything = np.concatenate([points.reshape(-1, 3) for points in moving])
    everything = everything[np.isfinite(everything).all(axis=1)]
    near = np.clip(everything, starts.min(axis=0) - reach, starts.max(axis=0) + reach)
    goals = np.array([goal["at"] for goal in _goals(scenario.tasks)]).reshape(-1, 3)
    shown = np.concatenate([near, goals])
    return {"low": _short(shown.min(axis=0)), "high": _short(shown.max(axis=0))}


def _short(values: Array) -> Any:
    """Tenths of a millimetre are enough to look at."""
    return np.nan_to_num(values, posinf=0.0, neginf=0.0).round(4).tolist()
