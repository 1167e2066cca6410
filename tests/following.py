"""Every task that has something to follow, with signals in its fields."""

from __future__ import annotations

from dataclasses import fields, replace
from typing import Any

import numpy as np
from example_signals import TIMES, near
from example_tasks import EXAMPLES

from coopqp.base.spec import Array
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.profile import Profile
from coopqp.model.state import State
from coopqp.scenario.catalog import Catalog
from coopqp.signal import DIRECTION, POINT, POSE, ROTATION, Kind, Signal, of_joints, of_twist
from coopqp.signals import Waypoints
from coopqp.task import Task
from coopqp.tasks import Twist

SMOOTH = Profile(duration=1.5, delay=0.2)
#: What each field that can move is.
MOVING: dict[str, Kind] = {
    "through": POINT, "to": POINT, "center": POINT, "direction": DIRECTION, "normal": DIRECTION,
}  # fmt: skip
#: By task, the kind of its goal.
GOALS = {
    "point_on_point": POINT, "pose": POSE, "impedance": POSE, "orientation": ROTATION,
    "relative_motion": POSE,
}  # fmt: skip


def moving_fields(task: Task, chain: ClosedChain) -> dict[str, Kind]:
    name = type(task).__module__.rsplit(".", 1)[-1]
    found = {f.name: MOVING[f.name] for f in fields(task) if f.name in MOVING}
    if name in GOALS:
        found["goal"] = GOALS[name]
    if name == "posture":
        found["goal"] = of_joints(chain.joint_names)
    if isinstance(task, Twist):
        found["velocity"] = of_twist(("rot_y", "x", "z"))
    return found


def one_of_each(chain: ClosedChain) -> dict[str, Task]:
    """An example of every task that has something to follow."""
    found: dict[str, Task] = {}
    for task in EXAMPLES.values():
        if moving_fields(task, chain):
            found.setdefault(type(task).__module__.rsplit(".", 1)[-1], task)
    return found


def place(kind: Kind, chain: ClosedChain) -> Array:
    """A value near the object or the joints."""
    value = kind.zero.copy()
    if kind in (POINT, POSE):
        value[:3] = State(chain).p_WO
    if kind.each:
        value[:] = chain.q_start
    return value


def following(task: Task, chain: ClosedChain, signal_of: Any) -> Task:
    """The task with a signal in every field that can have one."""
    changed: dict[str, Any] = {}
    for key, kind in moving_fields(task, chain).items():
        changed[key] = signal_of(key, kind)
    for key, nothing in (("velocity", (0.0, 0.0, 0.0)), ("turn", None), ("rpy_deg", None)):
        if hasattr(task, key) and key not in changed:
            changed[key] = nothing
    if isinstance(task, Twist):
        changed["components"] = ("rot_y", "x", "z")
    if hasattr(task, "rpy"):
        changed["rpy"] = None
    if type(task).__module__.endswith("orientation"):
        changed["goal"] = signal_of("goal", ROTATION)
    return replace(task, **changed, profile=SMOOTH)


def way(chain: ClosedChain, between: str, repeat: str) -> Any:
    def make(key: str, kind: Kind) -> Signal:
        rng = np.random.default_rng(len(key))
        values = near(kind, place(kind, chain), rng)
        return Waypoints(times=TIMES, values=values, between=between, repeat=repeat)  # type: ignore[arg-type]

    return make


NAMES = [
    name
    for name in Catalog().entries("tasks")
    if name
    not in (
        "internal_wrench",  # rows of forces: tests/tasks/test_internal_wrench.py
        "joint_centering",
        "joint_limit_barrier",
        "manipulability",
        "minimum_kinetic_energy",
        "minimum_velocity",
    )
]
