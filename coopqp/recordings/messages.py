"""A row of a recorded run as what Foxglove and ROS 2 have messages for: MCAP and rosbag2.

Frames are in the world, all of them directly under it: those of the robot's links where its file
names links, else of its joints and hands. The object's pose is that of the row, not a new sum.

                       MCAP, in Foxglove's schemas     rosbag2, in ROS 2's own; no ROS is needed
    /joint_states      foxglove.JointStates            sensor_msgs/JointState
    /tf                foxglove.FrameTransforms        tf2_msgs/TFMessage
    /object_pose       foxglove.PoseInFrame            geometry_msgs/PoseStamped
    remarks            /log foxglove.Log, of changes   /diagnostics diagnostic_msgs/DiagnosticArray
    /coopqp/tick       the whole row as JSON           the same as std_msgs/String
    the scenario       attachment scenario.yaml        /coopqp/scenario std_msgs/String, once
"""

import json
import sqlite3
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import numpy as np
import pinocchio as pin

from coopqp import __version__
from coopqp.base.errors import CoopqpError, needs
from coopqp.base.reading import open_bytes
from coopqp.base.spec import Array
from coopqp.model.closed_chain import ClosedChain
from coopqp.recordings import column
from coopqp.recordings.run import ExportFormat, Run, read_rows, readable
from coopqp.scenario.catalog import Catalog
from coopqp.scenario.loader import load_text
from coopqp.scenario.scenario import Scenario
from coopqp.solver import Status, causes_of

WORLD, OBJECT = "world", "object"
NS = 1_000_000_000  # in a second

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
    """What is said of a row."""

    ns: int  # its time [ns]
    joints: Mapping[str, Joints]  # by topic
    frames: tuple[Placed, ...]  # of the robot
    held: Placed  # the object
    remarks: tuple[Remark, ...]
    row: Mapping[str, Any]  # all of it, as objects inside each other, :func:`nested`


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


LOG, ATTACHED = "/log", "scenario.yaml"
CHUNK = 1 << 18  # bytes


class Mcap(ExportFormat):
    """One file a controller."""

    name: ClassVar[str] = "mcap"
    suffix: ClassVar[str] = ".mcap"

    def write(self, run: Run, scenario: Scenario, path: Path) -> None:
        # foxglove's own writer prints what goes wrong, and goes on; this one raises.
        with needs("MCAP", "recordings"):
            from foxglove import messages
            from mcap.writer import Writer
        with open(path, "wb") as stream:
            writer = Writer(stream, chunk_size=CHUNK)
            writer.start(library=f"coopqp {__version__}")
            writer.add_attachment(0, 0, ATTACHED, "text/yaml", scenario.portable.encode("utf-8"))
            controller = run.controllers[0]
            writer.add_metadata("coopqp", {"controller": controller})
            file = _Messages(writer, messages, controller)
            for instant in instants(run, scenario):
                file.log(instant)
            writer.finish()

    def read(self, path: Path) -> Run:
        with _reader(path) as reader:
            found = reader.iter_messages([TICK])
            rows = (flat(json.loads(message.data)) for _, _, message in found)
            return read_rows(path, f"{path}: message ", rows)

    def scenario(self, path: Path, catalog: Catalog) -> Scenario:
        with _reader(path) as reader:
            attached = {found.name: found.data for found in reader.iter_attachments()}
        if ATTACHED not in attached:
            raise CoopqpError(f"{path}: holds no run of coopqp: has no attachment '{ATTACHED}'")
        return load_text(path, attached[ATTACHED].decode("utf-8", "replace"), catalog)


@contextmanager
def _reader(path: Path) -> Iterator[Any]:
    with needs("MCAP", "recordings"):
        from mcap.reader import make_reader
    with open_bytes(path) as stream, readable(path):
        yield make_reader(stream)


class _Messages:
    """The topics of one file, and how rows go into them."""

    def __init__(self, writer: Any, messages: Any, controller: str) -> None:
        self._writer, self._of, self._controller = writer, messages, controller
        self._channels: dict[str, int] = {}
        self._said: dict[str, tuple[int, str]] = {}

    def log(self, instant: Instant) -> None:
        of, ns = self._of, instant.ns
        stamp = of.Timestamp(ns // NS, ns % NS)
        for topic, joints in instant.joints.items():
            self._write(topic, ns, of.JointStates(timestamp=stamp, joints=self._states(joints)))
        frames = [self._frame(stamp, placed) for placed in (*instant.frames, instant.held)]
        self._write(TF, ns, of.FrameTransforms(transforms=frames))
        p, q = self._vectors(instant.held)
        pose = of.Pose(position=p, orientation=q)
        self._write(POSE, ns, of.PoseInFrame(timestamp=stamp, frame_id=WORLD, pose=pose))
        for remark in instant.remarks:
            said = remark.level, remark.words
            if said != self._said.get(remark.about, (0, "")):
                self._said[remark.about] = said
                self._write(LOG, ns, self._log(stamp, remark))
        self._write_row(ns, instant.row)

    def _write(self, topic: str, ns: int, message: Any) -> None:
        if topic not in self._channels:
            schema = type(message).get_schema()
            self._open(topic, "protobuf", schema.name, schema.encoding, schema.data)
        self._writer.add_message(self._channels[topic], ns, message.encode(), ns)

    def _write_row(self, ns: int, row: Mapping[str, Any]) -> None:
        if TICK not in self._channels:
            schema = json.dumps({"title": "coopqp.Tick", **_schema(row)}).encode("utf-8")
            self._open(TICK, "json", "coopqp.Tick", "jsonschema", schema)
        self._writer.add_message(self._channels[TICK], ns, json.dumps(row).encode("utf-8"), ns)

    def _open(self, topic: str, encoding: str, *schema: Any) -> None:
        known = self._writer.register_schema(*schema)
        self._channels[topic] = self._writer.register_channel(topic, encoding, known)

    def _log(self, stamp: Any, remark: Remark) -> Any:
        level = (self._of.LogLevel.Info, self._of.LogLevel.Warning, self._of.LogLevel.Error)
        return self._of.Log(
            timestamp=stamp,
            level=level[remark.level],
            message=f"{remark.about}: {remark.words or 'free again'}",
            name=self._controller,
        )

    def _states(self, joints: Joints) -> list[Any]:
        values = (joints.position, joints.velocity, joints.effort)
        columns: list[list[Any]] = [list(of) or [None] * len(joints.names) for of in values]
        return [
            self._of.JointState(name=name, position=q, velocity=v, effort=tau)
            for name, q, v, tau in zip(joints.names, *columns, strict=True)
        ]

    def _frame(self, stamp: Any, placed: Placed) -> Any:
        p, q = self._vectors(placed)
        return self._of.FrameTransform(
            timestamp=stamp,
            parent_frame_id=WORLD,
            child_frame_id=placed.name,
            translation=p,
            rotation=q,
        )

    def _vectors(self, placed: Placed) -> tuple[Any, Any]:
        (x, y, z), (qx, qy, qz, qw) = placed.p, placed.q
        return self._of.Vector3(x=x, y=y, z=z), self._of.Quaternion(x=qx, y=qy, z=qz, w=qw)


def _schema(row: Mapping[str, Any]) -> dict[str, Any]:
    """JSON Schema of a row: whose columns there are; each may be null."""
    inside = {
        key: _schema(value) if isinstance(value, dict) else {"type": ["number", "string", "null"]}
        for key, value in row.items()
    }
    return {"type": "object", "properties": inside}


DIAGNOSTICS, SCENARIO = "/diagnostics", "/coopqp/scenario"
STRING = "std_msgs/msg/String"
VERSION = 8  # of a bag's metadata; the older one that rosbags writes, for older readers


class Rosbag2(ExportFormat):
    """One folder a controller."""

    name: ClassVar[str] = "rosbag2"
    suffix: ClassVar[str] = ".rosbag2"

    def holds(self, path: Path) -> bool:
        return path.suffix == self.suffix or (path / "metadata.yaml").is_file()

    def write(self, run: Run, scenario: Scenario, path: Path) -> None:
        with needs("rosbag2", "recordings"):
            from rosbags.rosbag2 import Writer
        try:
            with Writer(path, version=VERSION) as writer:
                bag = _Bag(writer, run.controllers[0])
                for i, instant in enumerate(instants(run, scenario)):
                    if not i:
                        text = bag.new(STRING, data=scenario.portable)
                        bag.write(SCENARIO, STRING, instant.ns, text)
                    bag.log(instant)
        except sqlite3.Error as error:  # as of a full disk
            raise OSError(str(error)) from error

    def read(self, path: Path) -> Run:
        with readable(path):
            rows = (flat(json.loads(text)) for text in _strings(path, TICK))
            return read_rows(path, f"{path}: message ", rows)

    def scenario(self, path: Path, catalog: Catalog) -> Scenario:
        for text in _strings(path, SCENARIO):
            return load_text(path, text, catalog)
        raise CoopqpError(f"{path}: holds no run of coopqp: has no message on '{SCENARIO}'")


def _types() -> Any:
    """The messages of ROS 2, the same in all its releases so far."""
    from rosbags.typesys import Stores, get_typestore

    return get_typestore(Stores.ROS2_HUMBLE)


def _strings(path: Path, topic: str) -> Iterator[str]:
    with needs("rosbag2", "recordings"):
        from rosbags.rosbag2 import Reader
    types = _types()
    with readable(path), Reader(path) as reader:
        asked = [found for found in reader.connections if found.topic == topic]
        if not asked:
            return
        for connection, _, data in reader.messages(asked):
            yield types.deserialize_cdr(data, connection.msgtype).data


class _Bag:
    def __init__(self, writer: Any, controller: str) -> None:
        self._writer, self._controller, self._store = writer, controller, _types()
        self._topics: dict[str, Any] = {}

    def new(self, kind: str, **values: Any) -> Any:
        return self._store.types[kind](**values)

    def write(self, topic: str, kind: str, ns: int, message: Any) -> None:
        if topic not in self._topics:
            added = self._writer.add_connection(topic, kind, typestore=self._store)
            self._topics[topic] = added
        self._writer.write(self._topics[topic], ns, self._store.serialize_cdr(message, kind))

    def log(self, instant: Instant) -> None:
        ns = instant.ns
        stamp = self.new("builtin_interfaces/msg/Time", sec=ns // NS, nanosec=ns % NS)
        head = self._head(stamp, WORLD)
        for topic, joints in instant.joints.items():
            kind, head_of_joints = "sensor_msgs/msg/JointState", self._head(stamp, "")
            names, *values = joints
            fields = zip(("position", "velocity", "effort"), map(np.array, values), strict=True)
            own = self.new(kind, header=head_of_joints, name=list(names), **dict(fields))
            self.write(topic, kind, ns, own)
        frames = [self._frame(head, placed) for placed in (*instant.frames, instant.held)]
        kind = "tf2_msgs/msg/TFMessage"
        self.write(TF, kind, ns, self.new(kind, transforms=frames))
        kind, held = "geometry_msgs/msg/PoseStamped", instant.held
        position = self._xyz("geometry_msgs/msg/Point", held)
        pose = self.new("geometry_msgs/msg/Pose", position=position, orientation=self._xyzw(held))
        self.write(POSE, kind, ns, self.new(kind, header=head, pose=pose))
        kind = "diagnostic_msgs/msg/DiagnosticArray"
        said = [self._status(remark) for remark in instant.remarks]
        self.write(DIAGNOSTICS, kind, ns, self.new(kind, header=head, status=said))
        self.write(TICK, STRING, ns, self.new(STRING, data=json.dumps(instant.row)))

    def _head(self, stamp: Any, frame: str) -> Any:
        return self.new("std_msgs/msg/Header", stamp=stamp, frame_id=frame)

    def _frame(self, head: Any, placed: Placed) -> Any:
        moved = self.new(
            "geometry_msgs/msg/Transform",
            translation=self._xyz("geometry_msgs/msg/Vector3", placed),
            rotation=self._xyzw(placed),
        )
        kind = "geometry_msgs/msg/TransformStamped"
        return self.new(kind, header=head, child_frame_id=placed.name, transform=moved)

    def _xyz(self, kind: str, placed: Placed) -> Any:
        return self.new(kind, **dict(zip("xyz", placed.p, strict=True)))

    def _xyzw(self, placed: Placed) -> Any:
        kind = "geometry_msgs/msg/Quaternion"
        return self.new(kind, **dict(zip("xyzw", placed.q, strict=True)))

    def _status(self, remark: Remark) -> Any:
        pair = "diagnostic_msgs/msg/KeyValue"
        return self.new(
            "diagnostic_msgs/msg/DiagnosticStatus",
            level=remark.level,
            name=f"{self._controller}: {remark.about}",
            message=remark.words,
            hardware_id="",
            values=[self.new(pair, key=key, value=value) for key, value in remark.values.items()],
        )
