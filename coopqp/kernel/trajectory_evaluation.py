"""Task errors, object and loop errors along a recorded motion, compiled."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from coopqp.base.spec import Array
from coopqp.kernel import native
from coopqp.kernel.flat import Flat, Group, Levels, flat_model, turned
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.state import State
from coopqp.task import Programs, Task


@dataclass(frozen=True)
class TrajectoryValues:
    """Values at I instants."""

    e: Array  # of each row of the tasks, shape (I, R), as in TaskRows
    rate: Array  # the same
    moved: Array | None  # J v of each row in the ticks between, shape (I - 1, R); None without v
    position: Array  # of the object, shape (I, 3) [m]
    rotation: Array  # of the object, shape (I, 3, 3)
    loop_error: Array  # as ``State.loop_error``, shape (I, 6 L) [m, rad]
    points: Array  # positions, shape (I, P, 3) [m]


class TrajectoryEvaluation:
    """Evaluates all instants of a motion at once; made by :func:`survey`.

    The tasks are in one level; ``points`` are ids of joints, 0 for the world, and points there [m].
    """

    def __init__(
        self, chain: ClosedChain, levels: Levels, points: Sequence[tuple[int, Array]]
    ) -> None:
        found = native.module()
        assert found is not None  # as survey() has asked
        self._chain, self._rows, self._points = chain, len(levels.flat[0]["gain"]), len(points)
        axes = chain.once(turned)
        places = [axes[joint].T @ p for joint, p in points]
        self._look = found.TrajectoryEvaluation({
            "model": chain.once(flat_model),
            "levels": levels.flat,
            "primitives": levels.primitives,
            "joints": np.array([joint - 1 for joint, _ in points], float),
            "places": np.concatenate([np.zeros(0), *places]),
        }).look  # fmt: skip

    def look(self, t: Array, q: Array, v: Array | None = None) -> TrajectoryValues:
        """Evaluate at t, shape (I,) [s], q, shape (I, n), and v in between, shape (I - 1, n)."""
        instants, rows = len(t), self._rows
        moved = None if v is None else np.zeros((max(instants - 1, 0), rows))
        out = TrajectoryValues(
            np.zeros((instants, rows)),
            np.zeros((instants, rows)),
            moved,
            np.zeros((instants, 3)),
            np.zeros((instants, 3, 3)),
            np.zeros((instants, 6 * (len(self._chain.arms) - 1))),
            np.zeros((instants, self._points, 3)),
        )
        nothing = np.zeros(0)
        self._look(
            t, q, nothing if v is None else v, out.e, out.rate,
            nothing if moved is None else moved,
            out.position, out.rotation, out.loop_error, out.points,
        )  # fmt: skip
        return out


def survey(
    chain: ClosedChain, tasks: Sequence[Task], start: State, points: Sequence[tuple[int, Array]]
) -> TrajectoryEvaluation | None:
    """The evaluation of motions; None where tasks have rows in Python, or follow signals.

    References start in the state ``start``; ``points`` are ids of joints in chain.model, and points
    in their frames [m].
    """
    model: Flat | None = chain.once(flat_model)
    if native.module() is None or model is None:
        return None
    levels = Levels([Group((), hard=tasks)], Programs(start))
    rows = sum(len(task.rows(chain)) for task in tasks)
    if not levels.compiled or levels.arriving or levels.followed:
        return None
    if len(levels.flat[0]["gain"]) != rows:  # a posture of some joints has no rows for the others
        return None
    return TrajectoryEvaluation(chain, levels, points)


def joint_points(chain: ClosedChain) -> dict[str, list[tuple[int, Array]]]:
    """Joint origins and hand of each arm, base first, as :func:`survey` takes them."""
    found: dict[str, list[tuple[int, Any]]] = {}
    for arm in chain.arms[chain.standing :]:
        joints = [chain.model.getJointId(name) for name in chain.robot.arm_joints(arm)]
        tip = chain.model.frames[chain.model.getFrameId(arm.tip)]
        hand = int(tip.parentJoint), tip.placement.translation.copy()
        found[arm.name] = [*((joint, np.zeros(3)) for joint in joints), hand]
    return found
