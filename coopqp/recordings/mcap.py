"""MCAP, for Foxglove and its like, in Foxglove's own schemas.

``/joint_states`` foxglove.JointStates, ``/tf`` foxglove.FrameTransforms, ``/object_pose``
foxglove.PoseInFrame, ``/log`` foxglove.Log where something has changed, and ``/coopqp/tick`` with
the whole row as JSON, of which every number can be plotted. The attachment ``scenario.yaml`` is
the scenario.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, ClassVar

from coopqp import __version__
from coopqp.base.errors import CoopqpError
from coopqp.base.reading import open_bytes
from coopqp.recordings.messages import POSE, TF, TICK, WORLD, Instant, Joints, Placed, Remark, flat
from coopqp.recordings.messages import instants as instants_of
from coopqp.recordings.run import ExportFormat, Run, needs, read_rows, readable
from coopqp.scenario.catalog import Catalog
from coopqp.scenario.loader import load_text
from coopqp.scenario.scenario import Scenario

LOG, ATTACHED = "/log", "scenario.yaml"
CHUNK = 1 << 18  # bytes
NS = 1_000_000_000


class Mcap(ExportFormat):
    """One file a controller."""

    name: ClassVar[str] = "mcap"
    suffix: ClassVar[str] = ".mcap"

    def write(self, run: Run, scenario: Scenario, path: Path) -> None:
        # foxglove's own writer prints what goes wrong, and goes on; this one raises.
        with needs("MCAP"):
            from foxglove import messages
            from mcap.writer import Writer
        with open(path, "wb") as stream:
            writer = Writer(stream, chunk_size=CHUNK)
            writer.start(library=f"coopqp {__version__}")
            writer.add_attachment(0, 0, ATTACHED, "text/yaml", scenario.portable.encode("utf-8"))
            controller = run.controllers[0]
            writer.add_metadata("coopqp", {"controller": controller})
            file = _Messages(writer, messages, controller)
            for instant in instants_of(run, scenario):
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
    with needs("MCAP"):
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
