"""Every task with settings of an example, and how tests look at its rows."""

from __future__ import annotations

import math

import numpy as np
import pytest

from coopqp import tasks
from coopqp.base.spec import Array
from coopqp.base.spec import Pose as PoseValue
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.geometry import Turn
from coopqp.model.profile import Profile
from coopqp.model.state import State
from coopqp.task import Task, TaskStack

H = 1e-5  # step of the central differences [s]
POINT = (0.03, -0.02, 0.05)  # away from the object's origin [m]
SMOOTH = Profile(kind="quintic", duration=2.0, delay=0.3)
TURN = Turn(axis=(1, 2, -1), angle=0.8, profile=Profile(duration=1.5, delay=0.1))
MOVING = (0.02, -0.03, 0.01)  # [m/s]
THROUGH = (0.2, 0.01, 0.06)
AXIS = (2, -1, 0.5)  # of the object
TILTED = (1, -1, 3)  # direction of lines, normals
MOVES = {"point": POINT, "velocity": MOVING, "turn": TURN, "profile": SMOOTH}
#: At least one of every class; a new task needs a line here.
EXAMPLES: dict[str, Task] = {
    "pose": tasks.Pose(
        goal=PoseValue(position=(0.2, 0.02, 0.08), rpy_deg=(20, -10, 30)), profile=SMOOTH
    ),
    "impedance": tasks.Impedance(
        goal=PoseValue(position=(0.2, 0.02, 0.08), rpy_deg=(20, -10, 30)),
        stiffness={"rot_z": 5.0, "x": 300.0, "z": 500.0},
        profile=SMOOTH,
    ),
    "origin on point": tasks.PointOnPoint(goal=(0.2, 0.02, 0.08), profile=SMOOTH),
    "point on point": tasks.PointOnPoint(goal=(0.2, 0.02, 0.08), point=POINT, profile=SMOOTH),
    "step to a point": tasks.PointOnPoint(
        goal=(0.2, 0.02, 0.08), point=POINT, profile=Profile(kind="step")
    ),
    "origin on plane": tasks.PointOnPlane(normal=(0, 0, 2), through=THROUGH, profile=SMOOTH),
    "point on plane": tasks.PointOnPlane(
        normal=(1, -1, 3), through=THROUGH, point=POINT, profile=SMOOTH
    ),
    "plane turns": tasks.PointOnPlane(
        normal=(1, -1, 3), through=THROUGH, point=POINT, turn=TURN, profile=SMOOTH
    ),
    "plane moves": tasks.PointOnPlane(
        normal=(1, -1, 3), through=THROUGH, velocity=MOVING, profile=SMOOTH
    ),
    "plane moves and turns": tasks.PointOnPlane(
        normal=(1, -1, 3), through=THROUGH, point=POINT, velocity=MOVING, turn=TURN, profile=SMOOTH
    ),
    "point on line": tasks.PointOnLine(direction=TILTED, through=THROUGH, profile=SMOOTH),
    "line moves": tasks.PointOnLine(direction=TILTED, through=THROUGH, **MOVES),
    "point on circle": tasks.PointOnCircle(
        center=THROUGH, normal=TILTED, radius=0.03, profile=SMOOTH
    ),
    "circle moves": tasks.PointOnCircle(center=THROUGH, normal=TILTED, radius=0.03, **MOVES),
    "distance": tasks.Distance(to=THROUGH, length=0.1, profile=SMOOTH),
    "distance to what moves": tasks.Distance(
        to=THROUGH, length=0.1, point=POINT, velocity=MOVING, profile=SMOOTH
    ),
    "pointing": tasks.Pointing(direction=TILTED, axis=AXIS, profile=SMOOTH),
    "pointing at once": tasks.Pointing(direction=TILTED, axis=AXIS, profile=Profile(kind="step")),
    "pointing turns": tasks.Pointing(direction=TILTED, axis=AXIS, turn=TURN, profile=SMOOTH),
    "pointing the opposite way": tasks.Pointing(
        direction=(-1, 0, 0), axis=(1, 0, 0), profile=SMOOTH
    ),
    "orientation": tasks.Orientation(rpy_deg=(20, -10, 30), profile=SMOOTH),
    "orientation at once": tasks.Orientation(rpy=(2.0, -1.0, 1.5), profile=Profile(kind="step")),
    "line on plane": tasks.LineOnPlane(normal=TILTED, through=THROUGH, axis=AXIS, profile=SMOOTH),
    "line on plane that moves": tasks.LineOnPlane(
        normal=TILTED, through=THROUGH, axis=AXIS, **MOVES
    ),
    "plane on plane": tasks.PlaneOnPlane(normal=TILTED, through=THROUGH, axis=AXIS, profile=SMOOTH),
    "plane on plane that moves": tasks.PlaneOnPlane(
        normal=TILTED, through=THROUGH, axis=AXIS, **MOVES
    ),
    "line on line": tasks.LineOnLine(direction=TILTED, through=THROUGH, axis=AXIS, profile=SMOOTH),
    "line on line that moves": tasks.LineOnLine(
        direction=TILTED, through=THROUGH, axis=(-2, 1, 0), either_way=True, **MOVES
    ),
    "revolute": tasks.Revolute(direction=TILTED, through=THROUGH, axis=AXIS, profile=SMOOTH),
    "revolute that moves": tasks.Revolute(direction=TILTED, through=THROUGH, axis=AXIS, **MOVES),
    "prismatic": tasks.Prismatic(direction=TILTED, through=THROUGH, profile=SMOOTH),
    "prismatic that moves": tasks.Prismatic(
        direction=TILTED, through=THROUGH, rpy_deg=(20, -10, 30), **MOVES
    ),
    "relative motion": tasks.RelativeMotion(
        goal=PoseValue(position=(0.02, -0.05, 0.01), rpy_deg=(20, -10, 30)), profile=SMOOTH
    ),
    "twist": tasks.Twist(
        velocity={"rot_y": 0.2, "x": 0.01, "z": -0.02}, point=POINT, profile=SMOOTH
    ),
    "twist in the object's axes": tasks.Twist(
        velocity={"y": 0.01, "rot_z": 0.0}, axes="object", point=POINT, profile=SMOOTH
    ),
    "spin": tasks.Twist(velocity={"rot_x": 0.1}),
    "least energy": tasks.MinimumKineticEnergy(),
    "joints to the middle": tasks.JointCentering(),
    "joints off their limits": tasks.JointLimitBarrier(),
    "able to move": tasks.Manipulability(),
    "able to rise": tasks.Manipulability(axes=("z",)),
    "least velocity": tasks.MinimumVelocity(),
    "posture": tasks.Posture(goal={"right": [0.5, -0.3, 1.0, 0.8, 0.0], "LElbowRoll": -0.7}),
    "whole posture": tasks.Posture(goal=[0.1 * i for i in range(10)], profile=SMOOTH),
}
#: These ask for wrenches of the hands.
OF_FORCES: dict[str, Task] = {
    "squeeze": tasks.InternalWrench(squeeze=15.0),
    "squeeze alone": tasks.InternalWrench(
        squeeze=15.0, shear_up=0.0, shear_side=0.0, twist=0.1, bend_up=0.0, bend_side=0.0,
        mode="hard",
    ),
}  # fmt: skip
IN_SPACE = {name: task for name, task in EXAMPLES.items() if not task.joint_space}
IN_JOINTS = {name: task for name, task in EXAMPLES.items() if task.joint_space}
#: These wish a velocity and have no error that could change.
OF_VELOCITY = (tasks.Twist, tasks.MinimumKineticEnergy)
PLACED = {name: task for name, task in IN_SPACE.items() if not isinstance(task, OF_VELOCITY)}
AT_ONCE = [name for name in PLACED if name.endswith("at once") or name.startswith("step")]
TIMES = (0.05, 0.7, 1.2, 1.9, 2.2, 5.0)  # before, during and after the motions, off their corners


def over(tasks: dict[str, Task]) -> pytest.MarkDecorator:
    return pytest.mark.parametrize("task", tasks.values(), ids=tasks.keys())


def at(chain: ClosedChain, q: Array, t: float) -> State:
    return State(chain, q, t)


def rows(task: Task, state: State) -> TaskStack:
    """The task's rows at a state, its reference set out from the chain's start."""
    stack = TaskStack([task], State(state.chain))
    stack.update(state)
    return stack


def error(task: Task, state: State) -> Array:
    return rows(task, state).e


def object_point(state: State, point: tuple[float, float, float]) -> Array:
    return state.p_WO + state.R_WO @ np.array(point)


def plane_at(t: float, *, velocity: Array, turning: bool) -> tuple[Array, Array]:
    """A point and the unit normal of the example's plane, the turn by Rodrigues' formula."""
    n = np.array([1, -1, 3]) / math.sqrt(11)
    k = np.array([1, 2, -1]) / math.sqrt(6)
    x = min(max((t - 0.1) / 1.5, 0.0), 1.0)
    angle = 0.8 * (10 * x**3 - 15 * x**4 + 6 * x**5) if turning else 0.0
    c, s = math.cos(angle), math.sin(angle)
    return np.array(THROUGH) + velocity * t, n * c + np.cross(k, n) * s + k * (k @ n) * (1 - c)
