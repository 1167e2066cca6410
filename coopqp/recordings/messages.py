"""A row of a recorded run as what Foxglove and ROS 2 have messages for.

Frames are in the world, all of them directly under it: those of the robot's links where its file
names links, else of its joints and hands. The object's pose is that of the row, not a new sum.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from coopqp.checked import Array
from coopqp.closed_chain import ClosedChain
from coopqp.errors import CoopqpError
from coopqp.recordings import column
from coopqp.recordings.format import Cells, RecordedRun
from coopqp.solver import Status, causes_of

WORLD, OBJECT = "world", "object"

#: Topics, the same in MCAP and rosbag2. ``TICK`` has the whole row.
JOINTS, TF, POSE, TICK = "/joint_states", "/tf", "/object_pose", "/coopqp/tick"
#: Columns of joints that have a topic of their own below ``JOINTS``.
OTHER_JOINTS = ("commanded", "measured")

#: A margin up to which a limit holds something back, and below which it is broken [its unit].
AT, BROKEN = 1e-6, -1e-6


@dataclass(frozen=True, kw_only=True)
class Joints:
    """Values of joints, all by name and in one order; empty where nothing is known.

    Attributes:
        position: [rad, m]. velocity: [rad/s, m/s]. effort: [N m, N].
    """

    names: tuple[str, ...]
    position: list[float]
    velocity: list[float]
    effort: list[float]


@dataclass(frozen=True)
class Placed:
    """A frame in the world.

    Attributes:
        name: of the frame.
        p: its origin [m]. q: its orientation as a quaternion (x, y, z, w).
    """

    name: str
    p: list[float]
    q: list[float]


@dataclass(frozen=True)
class Remark:
    """What is to be said of the law, the loops, a task or a limit.

    Attributes:
        about: such as "limit position".
        level: 0 all is well, 1 something is held back or given up, 2 not usable or broken.
        words: a sentence, or a short one.
        values: further numbers and texts, by name with unit.
    """

    about: str
    level: int
    words: str
    values: Mapping[str, str]


@dataclass(frozen=True, kw_only=True)
class Instant:
    """A row.

    Attributes:
        ns: its time [ns].
        joints: by topic.
        frames: of the robot. held: the object.
        remarks: in a fixed order.
        cells: all of it.
    """

    ns: int
    joints: Mapping[str, Joints]
    frames: tuple[Placed, ...]
    held: Placed
    remarks: tuple[Remark, ...]
    cells: Cells


def instants(run: RecordedRun) -> Iterator[Instant]:
    """The rows of a run.

    Raises:
        CoopqpError: a damaged row.
    """
    chain, unit = run.scenario.chain, column.unit_of(run.scenario)
    data = chain.model.createData()
    frames = _frames(chain)
    for cells in run.rows():
        row = _Row(cells, unit)
        q = row.by_joint("q", chain.joint_names)
        if len(q) != chain.n:
            words = "the trace is of another scenario than the one with it"
            raise CoopqpError(f"{cells.place}: has no joint of every column q; {words}")
        pin.framesForwardKinematics(chain.model, data, np.array(q))
        yield Instant(
            ns=round(1e9 * row.number("t")),
            joints=row.joints(chain),
            frames=tuple(
                _placed(name, data.oMf[i].rotation, data.oMf[i].translation) for name, i in frames
            ),
            held=row.held(),
            remarks=tuple(row.remarks()),
            cells=cells,
        )


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


class _Row:
    """A row, asked by what its columns mean."""

    def __init__(self, cells: Cells, unit: column.UnitOf) -> None:
        self._cells, self._unit = cells, unit

    def number(self, name: str) -> float:
        """A number that must be there.

        Raises:
            CoopqpError: it is not.
        """
        found = column.value(self._cells, name) if name in self._cells.texts else None
        if not isinstance(found, float | int) or not np.isfinite(found):
            words = "needs a finite number; the trace is damaged"
            raise CoopqpError(f"{self._cells.place}: {name}: {words}")
        return float(found)

    def by_joint(self, key: str, names: tuple[str, ...]) -> list[float]:
        """A number a joint; nothing where the row does not have them all."""
        columns = [f"{key}[{name}]" for name in names]
        if not all(self._cells.texts.get(name) for name in columns):
            return []
        return [float(column.value(self._cells, name) or 0.0) for name in columns]

    def joints(self, chain: ClosedChain) -> dict[str, Joints]:
        """By topic, those of which something is known."""
        names = chain.joint_names
        effort = [
            float(column.value(self._cells, f"tau[{name}]") or 0.0)
            for name in names
            if self._cells.texts.get(f"tau[{name}]")
        ]
        found = {
            JOINTS: Joints(
                names=names,
                position=self.by_joint("q", names),
                velocity=self.by_joint("v", names),
                effort=effort if len(effort) == len(names) else [],
            )
        }
        for key in OTHER_JOINTS:
            if position := self.by_joint(key, names):
                topic = f"{JOINTS}/{key}"
                found[topic] = Joints(names=names, position=position, velocity=[], effort=[])
        return found

    def held(self) -> Placed:
        """Where the object is."""
        R = [[self.number(f"R{i}{j}") for j in (1, 2, 3)] for i in (1, 2, 3)]
        return _placed(OBJECT, np.array(R), np.array([self.number(axis) for axis in "xyz"]))

    def remarks(self) -> Iterator[Remark]:
        """Of the law, the loops, each task and each limit, as far as the row has them."""
        texts = self._cells.texts
        yield self._law()
        yield Remark("loops", 0, "", self._values(["loop_position", "loop_orientation"]))
        tasks: list[str] = []
        limits: dict[str, list[str]] = {}
        for name in texts:
            parts = column.split(name)
            if parts[0] in ("error", "e", "rate"):
                tasks.append(name)
            elif parts[0] == "margin" and texts[name]:
                limits.setdefault(parts[1], []).append(name)
        yield Remark("tasks", 0, "", self._values(tasks))
        for owner, names in limits.items():
            yield self._limit(owner, names)

    def _law(self) -> Remark:
        """What became of the tick."""
        word = self._cells.texts["status"]
        try:
            causes = causes_of(word) if word else ()
        except KeyError:
            words = f"status: no status '{word[:40]}'; the trace is damaged"
            raise CoopqpError(f"{self._cells.place}: {words}") from None
        level = max((level_of(cause) for cause in causes), default=0)
        said = "; ".join(cause.value for cause in causes) or "the end"
        return Remark("law", level, said, self._values(["status", "scale", "tick_us"]))

    def _limit(self, owner: str, names: list[str]) -> Remark:
        """The least margin of a limit, in each of its units."""
        level, said = 0, []
        shown = list(names)
        for name in names:
            left = self.number(name)
            where = f"nearest{name.removeprefix('margin')}"
            at = self._cells.texts.get(where, "")
            shown.append(where)
            level = max(level, 2 if left < BROKEN else int(left <= AT))
            if left <= AT:
                said.append(f"{'beyond' if left < BROKEN else 'at'} {at}")
        return Remark(f"limit {owner}", level, "; ".join(said), self._values(shown))

    def _values(self, names: list[str]) -> dict[str, str]:
        """Values with their units in their names, empty ones left out."""
        found = {}
        for name in names:
            if self._cells.texts.get(name):
                unit = self._unit(name)
                shown = name if unit in ("", "1") else f"{name} [{unit}]"
                found[shown] = self._cells.texts[name]
        return found


def level_of(cause: Status) -> int:
    """0 all is well, 1 something was given up or is to be known, 2 the arms stood still."""
    if not cause.usable:
        return 2
    return 0 if cause is Status.OPTIMAL else 1
