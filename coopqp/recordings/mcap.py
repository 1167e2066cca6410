"""MCAP, for Foxglove and its like, in Foxglove's own schemas.

``/joint_states`` foxglove.JointStates, ``/tf`` foxglove.FrameTransforms, ``/object_pose``
foxglove.PoseInFrame, ``/log`` foxglove.Log where something has changed, and ``/coopqp/tick`` with
the whole row as JSON, of which every number can be plotted. The attachment ``scenario.yaml`` is
the scenario.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any, ClassVar

from coopqp import __version__
from coopqp.errors import CoopqpError
from coopqp.reading import open_bytes
from coopqp.recordings import column
from coopqp.recordings.format import Cells, ExportFormat, RecordedRun, needs, readable
from coopqp.recordings.messages import POSE, TF, TICK, WORLD, Instant, Joints, Placed
from coopqp.recordings.messages import instants as instants_of
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

    def write(self, run: RecordedRun, path: Path) -> None:
        with needs("MCAP"):
            import foxglove
            from foxglove.mcap import MCAPWriteOptions
        context = foxglove.Context()
        options = MCAPWriteOptions(chunk_size=CHUNK)
        with foxglove.open_mcap(path, context=context, writer_options=options) as writer:
            source = run.source.encode("utf-8")
            writer.attach(
                log_time=0, create_time=0, name=ATTACHED, media_type="text/yaml", data=source
            )
            about = {"version": __version__, "controller": run.controller}
            writer.write_metadata("coopqp", about)
            messages = _Messages(context, run.controller)
            for instant in instants_of(run):
                messages.log(instant)

    def rows(self, path: Path) -> Iterator[Cells]:
        with needs("MCAP"):
            from mcap.reader import make_reader
        with open_bytes(path) as stream, readable(path):
            found = make_reader(stream).iter_messages([TICK])
            for i, (_, _, message) in enumerate(found):
                yield column.flat(f"{path}: message {i}", json.loads(message.data))

    def scenario(self, path: Path, catalog: Catalog) -> Scenario:
        with needs("MCAP"):
            from mcap.reader import make_reader
        with open_bytes(path) as stream, readable(path):
            attached = {found.name: found.data for found in make_reader(stream).iter_attachments()}
        if ATTACHED not in attached:
            raise CoopqpError(f"{path}: holds no run of coopqp: has no attachment '{ATTACHED}'")
        return load_text(path, attached[ATTACHED].decode("utf-8", "replace"), catalog)


class _Messages:
    """Channels of one file, and how rows go into them."""

    def __init__(self, context: Any, controller: str) -> None:
        from foxglove import Channel, channels, messages

        self._new, self._context, self._controller = channels, context, controller
        self._of: Any = messages
        self._tf = channels.FrameTransformsChannel(TF, context=context)
        self._pose = channels.PoseInFrameChannel(POSE, context=context)
        self._log = channels.LogChannel(LOG, context=context)
        self._joints: dict[str, Any] = {}
        self._json, self._tick = Channel, None
        self._said: dict[str, tuple[int, str]] = {}

    def log(self, instant: Instant) -> None:
        """Write all messages of a row."""
        of, ns = self._of, instant.ns
        stamp = of.Timestamp(ns // NS, ns % NS)
        for topic, joints in instant.joints.items():
            if topic not in self._joints:
                new = self._new.JointStatesChannel(topic, context=self._context)
                self._joints[topic] = new
            states = of.JointStates(timestamp=stamp, joints=self._states(joints))
            self._joints[topic].log(states, log_time=ns)
        frames = [self._frame(stamp, placed) for placed in (*instant.frames, instant.held)]
        self._tf.log(of.FrameTransforms(transforms=frames), log_time=ns)
        p, q = self._vectors(instant.held)
        pose = of.Pose(position=p, orientation=q)
        self._pose.log(of.PoseInFrame(timestamp=stamp, frame_id=WORLD, pose=pose), log_time=ns)
        self._remark(instant, stamp)
        row = column.nested(instant.cells)
        if self._tick is None:
            schema = {"title": "coopqp.Tick", **_schema(row)}
            self._tick = self._json(TICK, schema=schema, context=self._context)
        self._tick.log(json.dumps(row).encode("utf-8"), log_time=ns)

    def _remark(self, instant: Instant, stamp: Any) -> None:
        """Log what is new."""
        levels = [getattr(self._of.LogLevel, name) for name in ("Info", "Warning", "Error")]
        for remark in instant.remarks:
            said = remark.level, remark.words
            if said == self._said.get(remark.about, (0, "")):
                continue
            self._said[remark.about] = said
            message = self._of.Log(
                timestamp=stamp,
                level=levels[remark.level],
                message=f"{remark.about}: {remark.words or 'free again'}",
                name=self._controller,
            )
            self._log.log(message, log_time=instant.ns)

    def _states(self, joints: Joints) -> list[Any]:
        values = (joints.position, joints.velocity, joints.effort)
        columns = [of or [None] * len(joints.names) for of in values]
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
        of = self._of
        return of.Vector3(**dict(zip("xyz", placed.p, strict=True))), of.Quaternion(
            **dict(zip("xyzw", placed.q, strict=True))
        )


def _schema(row: dict[str, Any]) -> dict[str, Any]:
    """JSON Schema of a row: whose columns there are; each may be null."""
    inside = {
        key: _schema(value)
        if isinstance(value, dict)
        else {"type": ["number", "string", "null"]}
        for key, value in row.items()
    }
    return {"type": "object", "properties": inside}
