"""A row of a recorded run as what Foxglove and ROS 2 have messages for.

Frames are in the world, all of them directly under it: those of the robot's links where its file
names links, else of its joints and hands. The object's pose is that of the row, not a new sum.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from coopqp.base.spec import Array
from coopqp.model.closed_chain import ClosedChain
from coopqp.recordings import column
from coopqp.recordings.run import Run
from coopqp.scenario.scenario import Scenario
from coopqp.solver import Status, causes_of

WORLD, OBJECT = "world", "object"

#: Topics, the same in MCAP and rosbag2. ``TICK`` has the whole row.
JOINTS, TF, POSE, TICK = "/joint_states", "/tf", "/object_pose", "/coopqp/tick"
#: Columns of joints that have a topic of their own below ``JOINTS``.
OTHER_JOINTS = ("commanded", "measured")

#: Shapes of what is said of tasks.
ABOUT_TASKS = (column.TASK, column.ROW)

#: A margin up to which a limit holds something back, and below which it is broken [its unit].
AT, BROKEN = 1e-6, -1e-6


class Joints(NamedTuple):
    """Values of joints, all by name and in one order; empty where nothing is known."""

    names: tuple[str, ...]
    position: list[float]  # [rad, m]
    velocity: list[float]  # [rad/s, m/s]
    effort: list[float]  # [N m, N]


class Placed(NamedTuple):
    """A frame in the world: its origin [m] and its orientation as a quaternion (x, y, z, w)."""

    name: str
    p: list[float]
    q: list[float]


class Remark(NamedTuple):
    """What is to be said of the law, the loops, a task or a limit, such as "limit position"."""

    about: str
    level: int  # 0 all is well, 1 something is held back or given up, 2 not usable or broken
    words: str
    values: Mapping[str, str]  # by name with unit


class Instant(NamedTuple):
    """A row: its time [ns], joints by topic, frames of the robot, the object, remarks.

    All of it is in ``row``, as objects inside each other, :func:`nested`.
    """

    ns: int
    joints: Mapping[str, Joints]
    frames: tuple[Placed, ...]
    held: Placed
    remarks: tuple[Remark, ...]
    row: Mapping[str, Any]


def instants(run: Run, scenario: Scenario) -> Iterator[Instant]:
    """The rows of a run."""
    chain = scenario.chain
    data, frames = chain.model.createData(), _frames(chain)
    t, q = run.numbers(["t"])[:, 0].tolist(), run.joints("q", chain.joint_names)
    layout = column.Layout(joints=chain.joint_names)
    p = run.numbers(column.of_field("position", layout))
    R = run.numbers(column.of_field("rotation", layout)).reshape(-1, 3, 3)
    joints, remarks = _joints(run, chain.joint_names), _Remarks(run, scenario)
    for k, row in enumerate(nested(run.columns)):
        pin.framesForwardKinematics(chain.model, data, q[k])
        yield Instant(
            ns=round(1e9 * t[k]),
            joints={topic: of for topic, own in joints.items() if (of := own[k]).position},
            frames=tuple(
                _placed(name, data.oMf[i].rotation, data.oMf[i].translation) for name, i in frames
            ),
            held=_placed(OBJECT, R[k], p[k]),
            remarks=tuple(remarks.of(k)),
            row=row,
        )


def nested(columns: column.Columns) -> Iterator[dict[str, Any]]:
    """Rows as JSON objects inside each other: ``{"q": {"RElbowRoll": 0.9}}``."""
    paths = [column.split(name) for name in columns]
    for row in zip(*map(column.cells, columns.values()), strict=True):
        found: dict[str, Any] = {}
        for (*into, last), value in zip(paths, row, strict=True):
            inside = found
            for part in into:
                inside = inside.setdefault(part, {})
            inside[last] = value
        yield found


def flat(found: Any, parts: tuple[str, ...] = ()) -> dict[str, Any]:
    """The row that :func:`nested` gave, by column."""
    row: dict[str, Any] = {}
    for key, inner in found.items():
        deep = isinstance(inner, dict) and len(parts) < 2
        row |= flat(inner, (*parts, key)) if deep else {column.joined((*parts, key)): inner}
    return row


def _frames(chain: ClosedChain) -> list[tuple[str, int]]:
    """Names and ids of the robot's links; of its joints and tips where no link has a name."""
    kinds = [frame.type for frame in chain.model.frames]
    links = [pin.FrameType.BODY] if pin.FrameType.BODY in kinds else [
        pin.FrameType.JOINT, pin.FrameType.OP_FRAME
    ]  # fmt: skip
    return [
        (frame.name, i)
        for i, frame in enumerate(chain.model.frames)
        if frame.type in links and i not in chain.frames
    ]


def _placed(name: str, R: Array, p: Array) -> Placed:
    return Placed(name, p.tolist(), pin.Quaternion(R).normalized().coeffs().tolist())


def _joints(run: Run, names: tuple[str, ...]) -> dict[str, list[Joints]]:
    """By topic, row by row; a field counts where the row has it for all joints."""

    def of(name: str) -> list[list[float]]:
        values = run.joints(name, names, empty=True)
        return [row.tolist() if np.isfinite(row).all() else [] for row in values]

    found = {JOINTS: [Joints(names, *row) for row in zip(of("q"), of("v"), of("tau"), strict=True)]}
    for name in OTHER_JOINTS:
        found[f"{JOINTS}/{name}"] = [Joints(names, q, [], []) for q in of(name)]
    return found


class _Remarks:
    """What is to be said of the rows of a run: of the law, the loops, tasks and each limit."""

    def __init__(self, run: Run, scenario: Scenario) -> None:
        unit = column.unit_of(scenario)
        self._status = run.columns["status"].tolist()
        self._shown, self._cells = {}, {}
        self._of_tasks: list[str] = []
        self._limits: dict[str, list[str]] = {}
        for name, values in run.columns.items():
            line = column.field_of(name)
            if line is None or line.shape not in (column.PLAIN, *ABOUT_TASKS, column.LIMIT):
                continue
            own = unit(name)
            self._shown[name] = name if own in ("", "1") else f"{name} [{own}]"
            self._cells[name] = column.cells(values)
            if line.shape in ABOUT_TASKS:
                self._of_tasks.append(name)
            elif line.name == "margin":
                self._limits.setdefault(column.split(name)[1], []).append(name)

    def of(self, k: int) -> Iterator[Remark]:
        """Of a row, as far as it has them."""
        causes = causes_of(self._status[k]) if self._status[k] else ()
        level = max((level_of(cause) for cause in causes), default=0)
        said = "; ".join(cause.value for cause in causes) or "the end"
        yield Remark("law", level, said, self._values(k, ["status", "scale", "tick_us"]))
        yield Remark("loops", 0, "", self._values(k, ["loop_position", "loop_orientation"]))
        yield Remark("tasks", 0, "", self._values(k, self._of_tasks))
        for owner, names in self._limits.items():
            if known := [name for name in names if self._cells[name][k] is not None]:
                yield self._limit(k, owner, known)

    def _limit(self, k: int, owner: str, names: list[str]) -> Remark:
        """The least margin of a limit, in each of its units."""
        level, said = 0, []
        shown = list(names)
        for name in names:
            left = self._cells[name][k]
            where = column.joined(("nearest", *column.split(name)[1:]))
            shown.append(where)
            level = max(level, 2 if left < BROKEN else int(left <= AT))
            if left <= AT:
                at = self._cells[where][k] if where in self._cells else None
                said.append(f"{'beyond' if left < BROKEN else 'at'} {at or ''}")
        return Remark(f"limit {owner}", level, "; ".join(said), self._values(k, shown))

    def _values(self, k: int, names: list[str]) -> dict[str, str]:
        """Values with their units in their names, empty ones left out."""
        cells = ((name, self._cells[name][k]) for name in names if name in self._cells)
        return {self._shown[name]: str(value) for name, value in cells if value is not None}


def level_of(cause: Status) -> int:
    """0 all is well, 1 something was given up or is to be known, 2 the arms stood still."""
    if not cause.usable:
        return 2
    return 0 if cause is Status.OPTIMAL else 1
