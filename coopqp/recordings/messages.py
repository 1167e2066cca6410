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
from types import SimpleNamespace as Message
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

ABOUT_TASKS = (column.TASK, column.ROW)  # shapes of what is said of tasks

#: A margin up to which a limit holds something back, and below which it is broken [its unit].
AT, BROKEN = 1e-6, -1e-6


class Joints(NamedTuple):
    """Values of joints, all by name and in one order; empty where nothing is known."""

    names: tuple[str, ...]
    position: list[float]  # [rad, m]
    velocity: list[float]  # [rad/s, m/s]
    effort: list[float]  # [N m, N]


class Placed(NamedTuple):
    """A frame in the world: its origin [m] and its orientation as a quaternion, by x, y, z, w."""

    name: str
    p: dict[str, float]
    q: dict[str, float]


class Remark(NamedTuple):
    """What is to be said of the law, the loops, a task or a limit, such as "limit position"."""

    about: str
    level: int  # 0 all is well, 1 something is held back or given up, 2 not usable or broken
    message: str
    values: Mapping[str, str]  # by name with unit


class Instant(NamedTuple):
    """What is said of a row."""

    ns: int  # its time [ns]
    joints: Mapping[str, Joints]  # by topic
    frames: tuple[Placed, ...]  # of the robot, and then of the object
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
        links = (_placed(name, data.oMf[i].rotation, data.oMf[i].translation) for name, i in frames)
        yield Instant(
            ns=round(1e9 * t[k]),
            joints={topic: of for topic, own in joints.items() if (of := own[k]).position},
            frames=(*links, _placed(OBJECT, R[k], p[k])),
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
    frames = enumerate(chain.model.frames)
    return [(f.name, i) for i, f in frames if f.type in links and i not in chain.frames]


def _placed(name: str, R: Array, p: Array) -> Placed:
    turned = pin.Quaternion(R).normalized().coeffs().tolist()
    by_axis = (dict(zip("xyzw", numbers, strict=False)) for numbers in (p.tolist(), turned))
    return Placed(name, *by_axis)


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
        causes = causes_of(self._status[k]) if self._status[k] else ()
        level = max(map(level_of, causes), default=0)
        words = "; ".join(cause.value for cause in causes) or "the end"
        yield Remark("law", level, words, self._values(k, ["status", "scale", "tick_us"]))
        yield Remark("loops", 0, "", self._values(k, ["loop_position", "loop_orientation"]))
        yield Remark("tasks", 0, "", self._values(k, self._of_tasks))
        for owner, names in self._limits.items():
            if known := [name for name in names if self._cells[name][k] is not None]:
                yield self._limit(k, owner, known)

    def _limit(self, k: int, owner: str, names: list[str]) -> Remark:
        """The least margin of a limit, in each of its units."""
        level, texts, shown = 0, list[str](), list(names)
        for name in names:
            left = self._cells[name][k]
            shown.append(where := column.joined(("nearest", *column.split(name)[1:])))
            if left <= AT:
                level = max(level, 1 + (left < BROKEN))
                at = self._cells[where][k] if where in self._cells else None
                texts.append(f"{'beyond' if left < BROKEN else 'at'} {at or ''}")
        return Remark(f"limit {owner}", level, "; ".join(texts), self._values(k, shown))

    def _values(self, k: int, names: list[str]) -> dict[str, str]:
        """Values with their units in their names, empty ones left out."""
        cells = ((name, self._cells[name][k]) for name in names if name in self._cells)
        return {self._shown[name]: str(value) for name, value in cells if value is not None}


def level_of(cause: Status) -> int:
    """0 all is well, 1 something was given up or is to be known, 2 the arms stood still."""
    return 2 if not cause.usable else int(cause is not Status.OPTIMAL)


LOG, ATTACHED = "/log", "scenario.yaml"
CHUNK = 1 << 18  # bytes


class Mcap(ExportFormat):
    """One file a controller."""

    name: ClassVar[str] = "mcap"

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
        self._writer, self._of, self._name = writer, messages, controller
        self._channels: dict[str, int] = {}
        self._logged: dict[str, tuple[int, str]] = {}  # level and message, by what they are about

    def log(self, instant: Instant) -> None:
        of, ns = self._of, instant.ns
        stamp = of.Timestamp(ns // NS, ns % NS)
        for topic, (names, *values) in instant.joints.items():
            columns: list[list[Any]] = [list(own) or [None] * len(names) for own in values]
            rows = zip(names, *columns, strict=True)
            keys = "name", "position", "velocity", "effort"
            states = [of.JointState(**dict(zip(keys, row, strict=True))) for row in rows]
            self._write(topic, ns, of.JointStates(timestamp=stamp, joints=states))
        frames = []
        for placed in instant.frames:
            p, R = of.Vector3(**placed.p), of.Quaternion(**placed.q)
            between = {"parent_frame_id": WORLD, "child_frame_id": placed.name}
            frames.append(of.FrameTransform(timestamp=stamp, translation=p, rotation=R, **between))
        self._write(TF, ns, of.FrameTransforms(transforms=frames))
        pose = of.Pose(position=p, orientation=R)  # of the last, the object
        self._write(POSE, ns, of.PoseInFrame(timestamp=stamp, frame_id=WORLD, pose=pose))
        levels = of.LogLevel.Info, of.LogLevel.Warning, of.LogLevel.Error
        for about, level, words, _ in instant.remarks:
            if (level, words) != self._logged.get(about, (0, "")):
                self._logged[about] = level, words
                text = {"message": f"{about}: {words or 'free again'}", "name": self._name}
                self._write(LOG, ns, of.Log(timestamp=stamp, level=levels[level], **text))
        if TICK not in self._channels:
            schema = json.dumps({"title": "coopqp.Tick", **_schema(instant.row)}).encode("utf-8")
            self._open(TICK, "json", "coopqp.Tick", "jsonschema", schema)
        row = json.dumps(instant.row).encode("utf-8")
        self._writer.add_message(self._channels[TICK], ns, row, ns)

    def _write(self, topic: str, ns: int, message: Any) -> None:
        if topic not in self._channels:
            schema = type(message).get_schema()
            self._open(topic, "protobuf", schema.name, schema.encoding, schema.data)
        self._writer.add_message(self._channels[topic], ns, message.encode(), ns)

    def _open(self, topic: str, encoding: str, *schema: Any) -> None:
        known = self._writer.register_schema(*schema)
        self._channels[topic] = self._writer.register_channel(topic, encoding, known)


def _schema(row: Mapping[str, Any]) -> dict[str, Any]:
    cell = {"type": ["number", "string", "null"]}
    inside = {k: _schema(x) if isinstance(x, dict) else cell for k, x in row.items()}
    return {"type": "object", "properties": inside}


DIAGNOSTICS, SCENARIO = "/diagnostics", "/coopqp/scenario"
STRING = "std_msgs/msg/String"
VERSION = 8  # of a bag's metadata; the older one that rosbags writes, for older readers


class Rosbag2(ExportFormat):
    """One folder a controller."""

    name: ClassVar[str] = "rosbag2"

    def holds(self, path: Path) -> bool:
        return super().holds(path) or (path / "metadata.yaml").is_file()

    def write(self, run: Run, scenario: Scenario, path: Path) -> None:
        with needs("rosbag2", "recordings"):
            from rosbags.rosbag2 import Writer
        try:
            with Writer(path, version=VERSION) as writer:
                bag = _Bag(writer, run.controllers[0])
                for i, instant in enumerate(instants(run, scenario)):
                    if not i:
                        bag.write(SCENARIO, STRING, instant.ns, data=scenario.portable)
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
        own = [connection for connection in reader.connections if connection.topic == topic]
        for connection, _, data in reader.messages(own) if own else ():
            yield types.deserialize_cdr(data, connection.msgtype).data


class _Bag:
    """Topics of a bag; messages are any objects with the fields of their kind."""

    def __init__(self, writer: Any, controller: str) -> None:
        self._writer, self._controller, self._store = writer, controller, _types()
        self._topics: dict[str, Any] = {}

    def write(self, topic: str, kind: str, ns: int, **fields: Any) -> None:
        if topic not in self._topics:
            self._topics[topic] = self._writer.add_connection(topic, kind, typestore=self._store)
        data = self._store.serialize_cdr(Message(**fields), kind)
        self._writer.write(self._topics[topic], ns, data)

    def log(self, instant: Instant) -> None:
        ns, stamp = instant.ns, Message(sec=instant.ns // NS, nanosec=instant.ns % NS)
        head, nameless = (Message(stamp=stamp, frame_id=frame) for frame in (WORLD, ""))
        for topic, (names, *values) in instant.joints.items():
            fields = zip(("position", "velocity", "effort"), map(np.array, values), strict=True)
            kind = "sensor_msgs/msg/JointState"
            self.write(topic, kind, ns, header=nameless, name=list(names), **dict(fields))
        frames = []
        for placed in instant.frames:
            p, R = Message(**placed.p), Message(**placed.q)
            way = Message(translation=p, rotation=R)
            frames.append(Message(header=head, child_frame_id=placed.name, transform=way))
        self.write(TF, "tf2_msgs/msg/TFMessage", ns, transforms=frames)
        pose = Message(position=p, orientation=R)  # of the last, the object
        self.write(POSE, "geometry_msgs/msg/PoseStamped", ns, header=head, pose=pose)
        statuses = [
            Message(
                level=remark.level,
                name=f"{self._controller}: {remark.about}",
                message=remark.message,
                hardware_id="",
                values=[Message(key=key, value=value) for key, value in remark.values.items()],
            )
            for remark in instant.remarks
        ]
        kind = "diagnostic_msgs/msg/DiagnosticArray"
        self.write(DIAGNOSTICS, kind, ns, header=head, status=statuses)
        self.write(TICK, STRING, ns, data=json.dumps(instant.row))
