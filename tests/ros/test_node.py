"""What the node publishes, written as CDR and read back, and its launch file, without ROS."""

from __future__ import annotations

import importlib.util
import sys
from functools import partial
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest
from command_line import refused_in_one_line
from ros_messages import STORE, new

import coopqp
from coopqp.ros import node
from coopqp.ros.bridge import RosSettings, joints_of

LAUNCH = Path(__file__).parents[2] / "examples" / "ros" / "coopqp.launch.py"
DEFAULTS = {"string": "", "float64": 0.0}
STAMP = 1_790_000_000_123_456_789


def message(kind: str, **fields: Any) -> Any:
    """As rclpy makes it: with defaults, arrays from lists, and no field that it does not know."""

    def default(what: Any) -> Any:
        nodetype, of = what
        if nodetype.name == "NAME":
            return message(of)
        if nodetype.name == "BASE":
            return DEFAULTS.get(of[0], 0)
        return np.zeros(0) if of[0][1][0] == "float64" else []

    made = new(kind, **{name: default(what) for name, what in STORE.fielddefs[kind][1]})
    for name, value in fields.items():
        assert hasattr(made, name)
        setattr(
            made, name, np.array(value) if isinstance(getattr(made, name), np.ndarray) else value
        )
    return made


class Node:
    """Keeps what is published, as those read it who listen."""

    def __init__(self) -> None:
        self.heard: dict[str, Any] = {}

    def get_parameter(self, name: str) -> Any:
        return SimpleNamespace(value=False)

    def create_publisher(self, made: Any, topic: str, depth: int) -> Any:
        (kind,) = made.args

        def publish(sent: Any) -> None:
            raw = STORE.serialize_cdr(sent, kind)
            self.heard[topic] = STORE.deserialize_cdr(bytes(raw), kind)

        return SimpleNamespace(publish=publish)

    def get_clock(self) -> Any:
        seconds, rest = divmod(STAMP, 10**9)
        stamp = new("builtin_interfaces/msg/Time", sec=seconds, nanosec=rest)
        return SimpleNamespace(now=lambda: SimpleNamespace(to_msg=lambda: stamp, nanoseconds=STAMP))


@pytest.fixture
def listening(monkeypatch: pytest.MonkeyPatch) -> Node:
    monkeypatch.setattr(node, "_type", lambda kind: partial(message, kind))
    return Node()


def _topics(listening: Node, **settings: Any) -> tuple[node.Topics, tuple[str, ...]]:
    chain = coopqp.load("point_on_point").chain
    given = RosSettings(controllers=["arms"], **settings)
    joints = joints_of(chain, given.controllers, {})
    return node.Topics(listening, given, joints, 0.01), joints.names


def test_the_object_is_told_in_its_frame_with_a_stamp(listening: Node) -> None:
    topics, _ = _topics(listening, object_frame="box", frame="table")
    topics.place([0.1, -0.2, 0.3], [0.0, 0.6, 0.0, 0.8])
    (found,) = listening.heard["/tf"].transforms
    assert (found.header.frame_id, found.child_frame_id) == ("table", "box")
    assert found.header.stamp.sec * 10**9 + found.header.stamp.nanosec == STAMP
    p, turned = found.transform.translation, found.transform.rotation
    assert (p.x, p.y, p.z) == (0.1, -0.2, 0.3)
    assert (turned.x, turned.y, turned.z, turned.w) == (0.0, 0.6, 0.0, 0.8)


@pytest.mark.parametrize("command", ["velocity", "position", "trajectory"])
def test_commands_say_what_the_controllers_of_their_kind_read(
    listening: Node, command: str
) -> None:
    topics, names = _topics(listening, command=command)
    q, v = (np.linspace(a, 1.0, len(names)).tolist() for a in (0.0, -1.0))
    topics.command("arms", q, v)
    if command != "trajectory":
        assert listening.heard["/arms/commands"].data.tolist() == (v if command[0] == "v" else q)
        return
    found = listening.heard["/arms/joint_trajectory"]
    (point,) = found.points
    assert tuple(found.joint_names) == names
    assert (point.positions.tolist(), point.velocities.tolist()) == (q, v)
    assert (point.time_from_start.sec, point.time_from_start.nanosec) == (0, 10_000_000)
    assert (found.header.stamp.sec, found.header.stamp.nanosec) == (0, 0)


def test_the_launch_file_starts_a_command_that_there_is(monkeypatch: pytest.MonkeyPatch) -> None:
    """With stand-ins for launch that keep what they are given."""

    def kept(*given: Any, **named: Any) -> Any:
        return SimpleNamespace(given=given, **named)

    names = ("LaunchDescription", "DeclareLaunchArgument", "ExecuteProcess", "LaunchConfiguration")
    for module in ("launch", "launch.actions", "launch.substitutions"):
        stand_in = ModuleType(module)
        vars(stand_in).update(dict.fromkeys(names, kept))
        monkeypatch.setitem(sys.modules, module, stand_in)
    spec = importlib.util.spec_from_file_location("launched", LAUNCH)
    assert spec
    assert spec.loader
    launched = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(launched)
    (actions,) = launched.generate_launch_description().given
    *declared, process = actions
    arguments = {"scenario": "point_on_point", "params": "params.yaml"}
    arguments |= {a.given[0]: a.default_value for a in declared if hasattr(a, "default_value")}
    assert {a.given[0] for a in declared} == set(arguments)

    def text(part: Any) -> str:
        if isinstance(part, list):
            return "".join(map(text, part))
        return part if isinstance(part, str) else arguments[part.given[0]]

    program, *rest = map(text, process.cmd)
    assert program == "coopqp"
    assert rest[2:] == ["--ros-args", "--params-file", "params.yaml", "-p", "use_sim_time:=false"]
    monkeypatch.setitem(sys.modules, "rclpy", None)
    assert refused_in_one_line(*rest).startswith("error: 'coopqp ros' needs: rclpy;")
