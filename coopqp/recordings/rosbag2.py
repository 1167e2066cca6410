"""rosbag2, for ROS 2 and PlotJuggler, in ROS 2's own messages; no ROS is needed.

``/joint_states`` sensor_msgs/JointState, ``/tf`` tf2_msgs/TFMessage, ``/object_pose``
geometry_msgs/PoseStamped, ``/diagnostics`` diagnostic_msgs/DiagnosticArray with statuses, errors,
references and margins; and as std_msgs/String ``/coopqp/tick`` with the whole row as JSON, and
``/coopqp/scenario`` with the scenario, once.
"""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Iterator
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from coopqp.base.errors import CoopqpError
from coopqp.recordings.messages import POSE, TF, TICK, WORLD, Instant, Placed, Remark, flat
from coopqp.recordings.messages import instants as instants_of
from coopqp.recordings.run import ExportFormat, Run, needs, read_rows, readable
from coopqp.scenario.catalog import Catalog
from coopqp.scenario.loader import load_text
from coopqp.scenario.scenario import Scenario

DIAGNOSTICS, SCENARIO = "/diagnostics", "/coopqp/scenario"
STRING = "std_msgs/msg/String"
NS = 1_000_000_000
VERSION = 8  # of a bag's metadata; the older one that rosbags writes, for older readers


class Rosbag2(ExportFormat):
    """One folder a controller."""

    name: ClassVar[str] = "rosbag2"
    suffix: ClassVar[str] = ".rosbag2"

    def holds(self, path: Path) -> bool:
        return path.suffix == self.suffix or (path / "metadata.yaml").is_file()

    def write(self, run: Run, scenario: Scenario, path: Path) -> None:
        with needs("rosbag2"):
            from rosbags.rosbag2 import Writer
        try:
            with Writer(path, version=VERSION) as writer:
                bag = _Bag(writer, run.controllers[0])
                for i, instant in enumerate(instants_of(run, scenario)):
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
    with needs("rosbag2"):
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
