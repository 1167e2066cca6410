"""Messages of targets as values of inputs: which message an input takes, and what it says."""

from __future__ import annotations

from typing import Any

from coopqp.base.errors import InvalidValueError
from coopqp.model.closed_chain import AXES
from coopqp.ros.settings import ros_name
from coopqp.signal import Kind

JOINT_STATE = "sensor_msgs/msg/JointState"
POSE = "geometry_msgs/msg/PoseStamped"
TWIST = "geometry_msgs/msg/TwistStamped"


def message_of(kind: Kind) -> str:
    """The message that such an input takes."""
    if kind.each:
        return JOINT_STATE
    return TWIST if kind.velocity else POSE


def value_of(kind: Kind, message: Any, frame: str) -> list[float]:
    """What a message says.

    Of a pose a point takes the place, a rotation and a direction (its third axis) the orientation.

    Args:
        kind: of the input.
        message: as :func:`message_of` says.
        frame: the only one in which it may be, or in none.

    Raises:
        InvalidValueError: it is in another frame, or lacks a joint.
    """
    if kind.each:
        return _joints(kind, message)
    found = str(message.header.frame_id)
    if found not in ("", frame):
        raise InvalidValueError(f"is in frame '{found}', needs '{frame}'; transform it before")
    if kind.velocity:
        linear, angular = message.twist.linear, message.twist.angular
        each = (linear.x, linear.y, linear.z, angular.x, angular.y, angular.z)
        by_axis = dict(zip(AXES, each, strict=True))
        return [float(by_axis[axis]) for axis in kind.columns]
    p, q = message.pose.position, message.pose.orientation
    place, turned = [p.x, p.y, p.z], [q.x, q.y, q.z, q.w]
    return [float(x) for x in (place if kind.numbers else []) + (turned if kind.turns else [])]


def _joints(kind: Kind, message: Any) -> list[float]:
    names, positions = list(message.name), list(message.position)
    told = dict(zip(names, positions, strict=False))
    if missing := [name for name in map(ros_name, kind.columns) if name not in told]:
        has = ", ".join(names) or "none"
        raise InvalidValueError(f"has no position of {', '.join(missing)}; has {has}")
    return [float(told[ros_name(name)]) for name in kind.columns]
