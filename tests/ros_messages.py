"""Messages of ROS 2 as they come from a wire or a bag: made, written as CDR and read by rosbags."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from rosbags.typesys import Stores, get_typestore

STORE = get_typestore(Stores.ROS2_JAZZY)
JOINT_STATE, POSE = "sensor_msgs/msg/JointState", "geometry_msgs/msg/PoseStamped"
TWIST = "geometry_msgs/msg/TwistStamped"


def sent(kind: str, **fields: Any) -> Any:
    """A message that has gone through its bytes."""
    raw = STORE.serialize_cdr(new(kind, **fields), kind)
    return STORE.deserialize_cdr(bytes(raw), kind)


def new(kind: str, **fields: Any) -> Any:
    """A message."""
    return STORE.types[kind](**fields)


def header(ns: int, frame: str = "") -> Any:
    """A header stamped at a time [ns]."""
    stamp = new("builtin_interfaces/msg/Time", sec=ns // 10**9, nanosec=ns % 10**9)
    return new("std_msgs/msg/Header", stamp=stamp, frame_id=frame)


def joint_state(ns: int, names: Sequence[str], position: Any) -> Any:
    """Where joints are."""
    nothing = np.zeros(0)
    where = np.array(position, float)
    of = {"header": header(ns), "name": list(names), "velocity": nothing, "effort": nothing}
    return sent(JOINT_STATE, position=where, **of)


def pose(ns: int, p: Sequence[float], q: Sequence[float] = (0, 0, 0, 1), frame: str = "") -> Any:
    """A place and an orientation, x, y, z, w."""
    where = new("geometry_msgs/msg/Point", **dict(zip("xyz", map(float, p), strict=True)))
    turned = new("geometry_msgs/msg/Quaternion", **dict(zip("xyzw", map(float, q), strict=True)))
    both = new("geometry_msgs/msg/Pose", position=where, orientation=turned)
    return sent(POSE, header=header(ns, frame), pose=both)


def twist(ns: int, linear: Sequence[float], angular: Sequence[float]) -> Any:
    """A velocity."""
    parts = [
        new("geometry_msgs/msg/Vector3", **dict(zip("xyz", map(float, part), strict=True)))
        for part in (linear, angular)
    ]
    both = new("geometry_msgs/msg/Twist", linear=parts[0], angular=parts[1])
    return sent(TWIST, header=header(ns), twist=both)
