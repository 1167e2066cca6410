"""Where a scenario starts: joints by arm or name, and what is wrong with them."""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from coopqp.base.errors import InvalidValueError
from coopqp.base.spec import Array, Pose, array, near
from coopqp.base.wording import Location
from coopqp.grasp import Grasp
from coopqp.model.closed_chain import ClosedChain
from coopqp.robot import RobotModel, unit_of
from coopqp.scenario.yaml import SMALLEST, Wrong
from coopqp.signal import POSE

Start = Mapping[str, float | Sequence[float]]

#: A place this many times the arms' reach from where the object starts cannot be meant [-].
FAR = 3.0


def pose_of(where: Pose | ArrayLike, chain: ClosedChain) -> Pose:
    """A pose, or what else an input of poses takes (:meth:`coopqp.signal.Kind.read`).

    InvalidValueError: it is none, or :data:`FAR` away.
    """
    try:
        numbers = POSE.read(where)
    except InvalidValueError as error:
        raise InvalidValueError(f"object_pose: {error}") from None
    far = float(np.linalg.norm(numbers[:3] - chain.start_position))
    if words := too_far(far, chain):
        raise InvalidValueError(f"object_pose: {far:.3g} m from where the file has it, {words}")
    return where if isinstance(where, Pose) else pose_at(pin.XYZQUATToSE3(numbers))


def too_far(far: float, chain: ClosedChain) -> str:
    """What to say of a place so far from the start [m]; empty where arms may reach it."""
    if far <= FAR * chain.reach:
        return ""
    meant = ": are these millimetres?" if 1e-3 * far <= FAR * chain.reach else ""
    return f"but the arms reach {chain.reach:.2g} m; lengths are metres{meant}"


def pose_at(X: pin.SE3) -> Pose:
    """The pose that a scenario file says of it."""
    place, angles = without_tiny(X.translation), without_tiny(pin.rpy.matrixToRpy(X.rotation))
    return Pose(position=tuple(place.tolist()), rpy=tuple(angles.tolist()))


def without_tiny(numbers: Array) -> Array:
    """With zero where a scenario file could not have a number."""
    return np.where(np.abs(numbers) < SMALLEST, 0.0, numbers)


def start_of(robot: RobotModel, start: Start) -> tuple[Start, dict[str, float]]:
    """The start of the robot's joints, and of the grasps' passive joints ("right.hinge")."""
    arms = {arm.name for arm in robot.arms}
    own, passive = dict(start), {}
    for key, value in start.items():
        arm, dot, _ = str(key).rpartition(".")
        if dot and arm in arms and key not in robot.joint_names:
            numbers = np.atleast_1d(near(key, array(key, own.pop(key))))
            if numbers.shape != (1,):
                raise InvalidValueError(f"{key}: found {value}, needs one number").at(key)
            passive[key] = float(numbers[0])
    return own, passive


def by_arm(robot: RobotModel, value: Mapping[str, float]) -> dict[str, float | list[float]]:
    """A start by arm, and by name for joints of no arm and passive ones, from one by joint."""
    start: dict[str, float | list[float]] = {
        arm.name: [value[joint] for joint in robot.arm_joints(arm)] for arm in robot.arms
    }
    moved = {joint for arm in robot.arms for joint in robot.arm_joints(arm)}
    return start | {name: x for name, x in value.items() if name not in moved}


def from_degrees(robot: RobotModel, grasps: Grasp | Mapping[str, Grasp], start: Start) -> Start:
    """A start in radians and metres from one in degrees, metres where a joint slides."""
    units = dict(zip(robot.joint_names, robot.joint_units, strict=True))
    for arm in robot.arms:
        grasp = grasps.get(arm.name) if isinstance(grasps, Mapping) else grasps
        for passive in grasp.passive_joints(np.eye(3)) if grasp else ():
            units[f"{arm.name}.{passive.name}"] = unit_of(passive.joint)
    joints = {arm.name: robot.arm_joints(arm) for arm in robot.arms}
    converted: dict[str, float | list[float]] = {}
    for key, value in start.items():
        # Names and counts that are wrong are refused where the start is used.
        slides = [units.get(joint) == "m" for joint in joints.get(key, (key,))]
        kept = np.reshape(slides, np.shape(value)) if np.size(value) == len(slides) else False
        converted[key] = np.where(kept, value, np.radians(value)).tolist()
    return converted


def joints_outside(robot: RobotModel, start: Start, q: Array, key: str) -> Iterator[Wrong]:
    """Where a start leaves the robot's position limits, and by how much."""
    lower, upper = robot.model.lowerPositionLimit, robot.model.upperPositionLimit
    arms = {arm.name: robot.arm_joints(arm) for arm in robot.arms}
    values = zip(robot.joint_names, robot.joint_units, q, lower, upper, strict=True)
    given = {name: arms.get(name, (name,)) for name in start} if key == "start" else {}
    like = [name for name, joints in given.items() if _like_degrees(robot, q, joints)]
    words = "found angles of more than a turn, which are inside the limits in degrees"
    if like and _like_degrees(robot, q, robot.joint_names) and arms.keys() & start <= {*like}:
        yield Wrong([key], f"{words}; did you mean start_deg?")
        return
    for name in like:
        yield Wrong([key, name], f"{words}; start is in radians, start_deg all in degrees")
    in_degrees = {joint for name in like for joint in given[name]}
    of_arm = {joint: (arm, i) for arm in arms if arm in start for i, joint in enumerate(arms[arm])}
    for joint, *value in (value for value in values if value[0] not in in_degrees):
        place = (joint,) if joint in start else of_arm.get(joint, (joint,))
        yield from _outside((key, *place), joint, *value)


def passive_outside(chain: ClosedChain, passive: Iterable[str], key: str) -> Iterator[Wrong]:
    """Where it leaves the limits of the grasps' passive joints."""
    values = (chain.joint_units, chain.q_start, chain.lower, chain.upper)
    joints = dict(zip(chain.joint_names, zip(*values, strict=True), strict=True))
    for name in passive:
        yield from _outside([key, name], name, *joints[name])


def _outside(
    place: Location, joint: str, unit: str, value: float, low: float, high: float
) -> Iterator[Wrong]:
    if low <= value <= high:
        return
    if unit == "rad" and place[0] == "start_deg":
        unit, (value, low, high) = "degrees", np.degrees((value, low, high)).tolist()
    words = f"{joint} starts at {value:.6g} {unit}, outside its limits {low:.6g} to {high:.6g}"
    yield Wrong(place, f"{words}; or say start_outside: true to see it recover")


def _like_degrees(robot: RobotModel, q: Array, joints: Sequence[str]) -> bool:
    lower, upper = robot.model.lowerPositionLimit, robot.model.upperPositionLimit
    units = zip(robot.joint_units, robot.joint_names, strict=True)
    turns = np.array([unit == "rad" and joint in joints for unit, joint in units])
    outside = turns & ((q < lower) | (q > upper))
    inside = (lower <= np.radians(q)) & (np.radians(q) <= upper)
    return bool((np.abs(q[outside]) > 2.0 * math.pi).any() and inside[turns].all())
