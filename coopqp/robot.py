"""What a robot is: a pinocchio model and the arms that can hold an object."""

from __future__ import annotations

import itertools
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import coal
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from coopqp.base.errors import InvalidValueError, UnknownNameError, require_known
from coopqp.base.spec import Array, array, near
from coopqp.base.wording import counted


class Robot(ABC):
    """A plug-in in ``robots/``: fields say which robot, ``build`` makes it."""

    @abstractmethod
    def build(self) -> RobotModel:
        """Make the model; CoopqpError where the description cannot be turned into one."""


@dataclass(frozen=True, kw_only=True)
class Arm:
    """A serial chain, named as in scenarios, that ends in a hand with the frame ``tip``."""

    name: str
    tip: str


@dataclass(frozen=True, kw_only=True)
class Shape:
    """A part of a link, for drawing or for collisions."""

    frame: str  # the model's frame that it is fixed to
    placement: pin.SE3  # pose in that frame
    kind: Literal["mesh", "box", "cylinder", "capsule", "sphere", "ellipsoid"]
    # box: edges; cylinder and capsule: radius, length along z (without the capsule's caps); sphere:
    # radius; ellipsoid: radii along x, y, z [m]; mesh: scale along x, y, z
    size: tuple[float, ...]
    mesh: Path | None = None  # file of a mesh


class Form(IntEnum):
    """What bounds a convex body, from which ``kernel/core/shared.hpp`` is made."""

    HULL = 0  # of points
    BOX = 1
    CYLINDER = 2  # along z
    ELLIPSOID = 3


@dataclass(frozen=True, eq=False)
class Convex:
    """A convex body."""

    geometry: coal.CollisionGeometry
    placement: pin.SE3  # of the middle of the box round it, in the frame it was given in
    half: Array  # half the edges of that box, shape (3,) [m]
    radius: float  # of the ball round it, about the same middle [m]
    # points, rim: it is the hull of the points, shape (k, 3), thickened by the rim [m]; round ends
    # of a cylinder have a few of their points, what is round all over has one
    points: Array
    rim: float = 0.0
    form: Form = Form.HULL  # hull of the points, or which other body
    # which points those of a mesh's hull lie between, shape (e, 2)
    edges: NDArray[np.int64] = field(default_factory=lambda: np.zeros((0, 2), np.int64))


@dataclass(frozen=True, kw_only=True)
class Capsule:
    """A collision body: all points within a radius of a segment, start to end (3,) [m].

    It is fixed to a joint's frame, None for the base, and named as used in limits: "RForearm".
    """

    name: str
    joint: str | None
    start: tuple[float, float, float]
    end: tuple[float, float, float]
    radius: float

    @property
    def placed(self) -> tuple[pin.SE3, float]:
        """Where its middle is in the joint's frame, with z along it, and its length [m]."""
        start, end = np.array(self.start), np.array(self.end)
        along = end - start
        turn = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), along).toRotationMatrix()
        R = turn if along.any() else np.eye(3)
        return pin.SE3(R, 0.5 * (start + end)), float(np.linalg.norm(along))


@dataclass(frozen=True, kw_only=True)
class RobotModel:
    """A robot ready to grasp something."""

    name: str
    #: Pinocchio model with one coordinate per joint (nq = nv), position limits [rad, m], velocity
    #: limits [rad/s, m/s] and effort limits [N m, N].
    model: pin.Model
    arms: tuple[Arm, ...]  #: In the order of the loops; the first is the reference of the others.
    shapes: tuple[Shape, ...] = ()  #: How links look; one without shapes is drawn as a capsule.
    #: Collision bodies, base first on each arm; see :class:`coopqp.limits.SelfCollision`.
    capsules: tuple[Capsule, ...] = ()
    #: The same from a robot's file, where it gives no capsules; a mesh counts as its convex hull.
    collision_shapes: tuple[Shape, ...] = ()
    #: What of these cannot be used, one sentence each, which begins with the link's name.
    unseen: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()  #: What was left out when it was read, one sentence each.

    def __post_init__(self) -> None:
        if self.model.nq != self.model.nv:
            raise InvalidValueError(
                f"robot {self.name}: nq = {self.model.nq} but nv = {self.model.nv}; "
                "floating and continuous joints must be locked or made revolute"
            )
        _hold_both_ways(self.model)
        shapes = (*self.shapes, *self.collision_shapes)
        frames = [(arm.tip, f"arm {arm.name}: ") for arm in self.arms]
        for name, where in (*frames, *((s.frame, f"shape {s.kind}: ") for s in shapes)):
            if not self.model.existFrame(name):
                raise UnknownNameError("frame", name, [f.name for f in self.model.frames], where)
        for capsule in self.capsules:
            if capsule.joint not in (None, *self.joint_names):
                where = f"capsule {capsule.name}: "
                raise UnknownNameError("joint", str(capsule.joint), self.joint_names, where)

    @cached_property
    def joint_names(self) -> tuple[str, ...]:
        """Names in the order of q."""
        return tuple(self.model.names[1:])

    @cached_property
    def joint_units(self) -> tuple[str, ...]:
        return joint_units(self.model)

    def arm_joints(self, arm: Arm) -> tuple[str, ...]:
        """Names of the joints between the base and the arm's tip, base first."""
        tip = self.model.frames[self.model.getFrameId(arm.tip)]
        return tuple(self.model.names[j] for j in self.model.supports[tip.parentJoint] if j > 0)

    def configuration(self, values: Mapping[str, float | Sequence[float]]) -> Array:
        """Configuration, shape (nq,), by arm or joint name; joints not named stay at neutral.

        A value is a number per joint of an arm, base first, or one number [rad or m].
        UnknownNameError: a key is neither an arm nor a joint. InvalidValueError: wrong number of
        values, one that is not finite, or arms that give a joint they share different values.
        """
        q = np.array(pin.neutral(self.model))
        by_arm: dict[str, tuple[str, float]] = {}
        arms = {arm.name: self.arm_joints(arm) for arm in self.arms}
        require_known("arm or joint", map(str, values), [*arms, *self.joint_names], at=())
        for key, value in values.items():
            joints = arms.get(key, (key,))
            numbers = np.atleast_1d(near(key, array(key, value)))
            if numbers.shape != (len(joints),):
                raise InvalidValueError(
                    f"{key}: found {counted(numbers.size, 'number')}, needs {len(joints)}: "
                    f"{', '.join(joints)}"
                ).at(key)
            for joint, number in zip(joints, numbers, strict=True):
                other, same = by_arm.get(joint, (key, number))
                if number != same:
                    raise InvalidValueError(
                        f"{key}: found {number:g} for {joint}, which {other} shares and puts at "
                        f"{same:g}; give both the same value"
                    ).at(key)
                if key in arms:
                    by_arm[joint] = (key, number)
                q[self.model.idx_qs[self.model.getJointId(joint)]] = number
        return q


def joint_units(model: pin.Model) -> tuple[str, ...]:
    """Unit of each joint's coordinate, in the order of q."""
    return tuple(unit_of(joint) for joint in itertools.islice(model.joints, 1, None))


def unit_of(joint: Any) -> str:
    """Unit of the coordinate of a pinocchio joint model: "m" where it slides, else "rad"."""
    return "m" if joint.shortname().startswith("JointModelP") else "rad"


def axis_of(joint: Any) -> Array | None:
    """(v; omega) for a unit rate of a joint, in its own axes; None if it has more coordinates."""
    if joint.nq != 1 or joint.nv != 1:
        return None
    data = joint.createData()
    joint.calc(data, np.zeros(joint.idx_q + 1))
    return np.asarray(data.S, float).ravel()


#: Data of a pinocchio model with one number per velocity coordinate.
PER_VELOCITY = (
    "velocityLimit", "effortLimit", "armature", "damping", "rotorInertia", "rotorGearRatio"
)  # fmt: skip


def _hold_both_ways(model: pin.Model) -> None:
    """Make speed and effort limits symmetric: pinocchio 4's lower defaults exceed the upper."""
    for key in ("Velocity", "Effort"):
        if hasattr(model, f"lower{key}Limit"):
            setattr(model, f"lower{key}Limit", -np.array(getattr(model, f"upper{key}Limit")))


def copy_per_velocity(source: pin.Model, target: pin.Model) -> None:
    """Copy limits, friction and rotors of joints, by name."""
    at = [target.idx_vs[target.getJointId(name)] for name in list(source.names)[1:]]
    for key in PER_VELOCITY:
        values = np.array(getattr(target, key))
        values[at] = getattr(source, key)
        setattr(target, key, values)
