"""What other tools find in exported files, read by the libraries of those formats."""

from __future__ import annotations

from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import typed
from scipy.spatial.transform import Rotation

from coopqp.base.spec import Array
from coopqp.trace import Trace

QUATERNION, EXACT = "xyzw", 1e-12


@pytest.fixture(scope="module")
def trace(written: Any) -> Trace:
    found: Trace = written.comparison.traces["qp"]
    return found


def numbers(of: Any, names: str) -> list[float]:
    return [getattr(of, name) for name in names]


@pytest.fixture(scope="module")
def messages(written: Any) -> dict[str, list[tuple[int, str, Any]]]:
    """Of the MCAP, by topic: time, schema and message."""
    from mcap.reader import make_reader
    from mcap_protobuf.decoder import DecoderFactory

    found: dict[str, list[tuple[int, str, Any]]] = defaultdict(list)
    with written.exported["mcap"].open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        for schema, channel, message, decoded in reader.iter_decoded_messages(
            ["/joint_states", "/joint_states/measured", "/tf", "/object_pose", "/log"]
        ):
            found[channel.topic].append((message.log_time, schema.name, decoded))
    return found


def test_mcap_has_the_joints_exactly(messages: Any, trace: Trace) -> None:
    found = messages["/joint_states"]
    assert {schema for _, schema, _ in found} == {"foxglove.JointStates"}
    assert [ns for ns, _, _ in found] == [round(1e9 * t) for t in trace.t.tolist()]
    states = [message.joints for _, _, message in found]
    assert all(tuple(j.name for j in joints) == trace.joints for joints in states)
    np.testing.assert_array_equal([[j.position for j in joints] for joints in states], trace.q)
    np.testing.assert_array_equal([[j.velocity for j in joints] for joints in states[:-1]], trace.v)
    assert not states[-1][0].HasField("velocity")
    sensed = [[j.position for j in m.joints] for _, _, m in messages["/joint_states/measured"]]
    np.testing.assert_array_equal(sensed, trace.measured)


def test_mcap_has_object_and_hands_where_they_were(messages: Any, trace: Trace) -> None:
    poses = [message.pose for _, _, message in messages["/object_pose"]]
    found = np.array([numbers(pose.position, "xyz") for pose in poses])
    np.testing.assert_array_equal(found, trace.position)
    turned = Rotation.from_quat([numbers(pose.orientation, QUATERNION) for pose in poses])
    np.testing.assert_allclose(turned.as_matrix(), trace.rotation, atol=EXACT)
    for arm, frame in (("right", "RHand"), ("left", "LHand")):
        placed = [
            numbers(moved.translation, "xyz")
            for _, _, message in messages["/tf"]
            for moved in message.transforms
            if moved.child_frame_id == frame and moved.parent_frame_id == "world"
        ]
        np.testing.assert_allclose(placed, trace.points[arm][:, -1], atol=EXACT)


def test_bag_has_the_same(written: Any, trace: Trace) -> None:
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    found: dict[str, list[Any]] = defaultdict(list)
    store = get_typestore(Stores.ROS2_JAZZY)  # as a newer ROS would
    with AnyReader([written.exported["rosbag2"]], default_typestore=store) as reader:
        types = {c.topic: c.msgtype for c in reader.connections}
        for connection, _, raw in reader.messages():
            found[connection.topic].append(reader.deserialize(raw, connection.msgtype))
    assert types["/tf"] == "tf2_msgs/msg/TFMessage"
    joints = found["/joint_states"]
    np.testing.assert_array_equal([m.position for m in joints], trace.q)
    np.testing.assert_array_equal([m.velocity for m in joints[:-1]], trace.v)
    np.testing.assert_array_equal([m.effort for m in joints[:-1]], trace.signals["tau"])
    stamps = [m.header.stamp.sec + 1e-9 * m.header.stamp.nanosec for m in joints]
    np.testing.assert_allclose(stamps, trace.t, atol=1e-9)
    places = [numbers(m.pose.position, "xyz") for m in found["/object_pose"]]
    np.testing.assert_array_equal(places, trace.position)
    frames = {moved.child_frame_id for moved in found["/tf"][0].transforms}
    assert {"RHand", "LHand", "object"} <= frames
    _diagnostics_tell_the_trace(found["/diagnostics"], trace)


def _diagnostics_tell_the_trace(found: list[Any], trace: Trace) -> None:
    for k in (0, 30, 100):
        by_name = {status.name: status for status in found[k].status}
        law = {pair.key: pair.value for pair in by_name["qp: law"].values}
        assert law["status"] == trace.status[k]
        assert by_name["qp: law"].level == (0 if trace.status[k] == "OPTIMAL" else 1)
        tasks = {pair.key: pair.value for pair in by_name["qp: tasks"].values}
        name = "carry.reach" if k < 60 else "alone.stay"
        task = [task.name for task in trace.tasks].index(name)
        assert float(tasks[f"error[{name}] [m]"]) == trace.task_error[k, task]
        loops = {pair.key: pair.value for pair in by_name["qp: loops"].values}
        assert float(loops["loop_position [m]"]) == trace.loop_position[k]


def test_parquet_has_columns_with_units(written: Any, trace: Trace) -> None:
    import pyarrow.parquet as pq

    table = pq.read_table(written.exported["parquet"])
    q = np.stack([table[f"q[{joint}]"].to_numpy() for joint in trace.joints], axis=1)
    np.testing.assert_array_equal(q, trace.q)
    assert tuple(table["status"].to_pylist()[:-1]) == trace.status
    units = {
        "t": "s", "x": "m", "R11": "1", "tick_us": "us", "v[RElbowRoll]": "rad/s",
        "tau[RElbowRoll]": "N m", "loop_offset[1].rot_x": "rad", "error[alone.away]": "rad",
        "rate[again.up.z]": "m/s", "margin[velocity].rad/s": "rad/s",
    }  # fmt: skip
    for name, unit in units.items():
        assert table.schema.field(name).metadata[b"unit"].decode() == unit


def test_limits_that_hold_back_are_logged(tmp_path: Path) -> None:
    """joint_limit_stress ends at joint limits; the pseudoinverse goes beyond them."""
    from mcap.reader import make_reader
    from mcap_protobuf.decoder import DecoderFactory

    chosen = ["--controllers", "qp,pseudoinverse"]
    assert typed("compare", "joint_limit_stress", *chosen, "--out", tmp_path).exit_code == 0
    assert typed("export", tmp_path, "--to", "mcap").exit_code == 0
    said: dict[str, list[Any]] = {}
    for name in ("qp", "pseudoinverse"):
        with (tmp_path / f"{name}.mcap").open("rb") as stream:
            reader = make_reader(stream, decoder_factories=[DecoderFactory()])
            said[name] = [found[3] for found in reader.iter_decoded_messages(["/log"])]
    worst = {name: max(log.level for log in logs) for name, logs in said.items()}
    assert worst == {"qp": 3, "pseudoinverse": 4}  # a warning, an error
    at = {log.message for log in said["qp"] if "limit position" in log.message}
    assert any(message.startswith("limit position: at ") for message in at)
    assert any("limit position: beyond " in log.message for log in said["pseudoinverse"])


def matching(trace: Trace, start: str) -> Array:
    """The columns of tasks' rows whose names start so."""
    return trace.e[:, [row.startswith(start) for row in trace.task_rows]]


def test_rows_of_tasks_have_the_norms_of_their_errors(trace: Trace) -> None:
    for name in ("carry.reach", "alone.away", "again.up"):
        task = [task.name for task in trace.tasks].index(name)
        size = np.linalg.norm(matching(trace, name), axis=1)
        np.testing.assert_allclose(size, trace.task_error[:, task], rtol=1e-12)
