"""How an arm holds the object: which motions between hand and object stay free.

A grasp adds its passive joints between the hand's tip frame and the object. The loop rows are
always the six of "the object is in one place", so they follow from the grasp by themselves.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from coopqp.base.errors import InvalidValueError
from coopqp.base.spec import Array, Pose, Vector3, spec

#: Default safety factor on friction.
SAFETY = 1.5
#: Default share of a pad's half-lengths that is counted on: beyond its edge no friction holds, and
#: torques are held for a tick in which the arms move on.
REACH = 0.95
#: A hand that presses with less does not hold anything, whatever the ratio says [N].
NO_CONTACT = 1e-6
#: A pad tips over its edge where the normal force is beyond it by more than this share.
BEYOND = 1e-5


@dataclass(frozen=True)
class ForceRows:
    """What a contact wrench has to keep, rows @ w <= upper [N], shapes (r, 6) and (r,).

    The labels are such as "friction[3]", "edge[2]", "least" and "most".
    """

    rows: Array
    upper: Array
    labels: tuple[str, ...]


@dataclass(frozen=True, kw_only=True)
class Contact(ABC):
    """A hand's contact with the object."""

    placement: Any  # pose of the contact frame in the hand's tip frame, a pinocchio SE3
    friction: float  # coefficient mu
    half_lengths: tuple[float, float] = (0.0, 0.0)  # of the pad along x and y [m]; 0 for a point
    reach: float = 1.0  # share of these that is counted on; what holds is the whole pad
    min_force: float = 0.0  # min_force, max_force: bounds on the normal force [N]
    max_force: float = np.inf

    @abstractmethod
    def rows(self, friction: float) -> Array:
        """A cone inside Coulomb's for friction mu / safety, rows @ w <= 0, shape (r, 6)."""

    @abstractmethod
    def friction_needed(self, wrench: ArrayLike) -> float:
        """The friction coefficient that a wrench needs, tipping aside; inf without pressure."""

    @abstractmethod
    def edge_use(self, wrench: ArrayLike) -> float:
        """Where the normal force is, over the half-lengths: 1 at an edge, NaN without one."""

    def force_rows(self, safety: float) -> ForceRows:
        """All that a wrench has to keep: the cone for friction / safety, and the normal force."""
        cone = self.counted_on.rows(self.friction / safety)
        # Rows without friction say where the normal force is: beyond the edge nothing helps.
        tilts = ~cone[:, [0, 1, 5]].any(axis=1)
        kinds = np.where(tilts, "edge", "friction")
        normal = np.zeros((2, 6))
        normal[:, 2] = -1.0, 1.0
        bounds, labels = [-self.min_force, self.max_force], ["least", "most"]
        ends = 1 if np.isinf(self.max_force) else 2
        return ForceRows(
            np.vstack([cone, normal[:ends]]),
            np.concatenate([self.min_force * cone[:, 2] * tilts, bounds[:ends]]),
            tuple([f"{kind}[{i}]" for i, kind in enumerate(kinds)] + labels[:ends]),
        )

    @property
    def counted_on(self) -> Contact:
        """The contact with the pad that is counted on, about the same middle."""
        X, Y = self.half_lengths
        return replace(self, half_lengths=(self.reach * X, self.reach * Y), reach=1.0)


@dataclass(frozen=True, kw_only=True)
class PassiveJoint:
    """One free motion of the object in the hand."""

    name: str  #: Without the arm's name, such as "hinge".
    joint: Any  #: Pinocchio joint model with one coordinate.
    placement: pin.SE3  #: Pose of the joint frame in the one before it, the tip's for the first.
    lower: float = -math.inf  #: Lower limit [rad or m].
    upper: float = math.inf  #: Upper limit [rad or m].

    def __post_init__(self) -> None:
        if wrong := range_fault(self.lower, self.upper):
            raise InvalidValueError(f"passive joint {self.name}: {wrong}")


def range_fault(lower: float | None, upper: float | None) -> str:
    """What is wrong with two limits, None for none; empty if nothing is."""
    if lower is None or upper is None or lower < upper:
        return ""
    return f"lower: found {lower:g}, needs less than upper, {upper:g}"


@spec
class Grasp(ABC):
    """A plug-in in ``grasps/``: one arm's hold on the object."""

    object_in_hand: Pose | None = None
    """Pose of the object in the arm's tip frame when it is known; else the start tells, eq. (1)."""

    @abstractmethod
    def passive_joints(self, R_WT: Array) -> tuple[PassiveJoint, ...]:
        """The joints after the tip, hand first; R_WT is how the tip starts, for world axes."""

    @property
    def contact(self) -> Contact | None:
        """How it presses where it holds by that; None where it is fastened to the object."""
        return None


def pose_matrix(pose: Pose) -> pin.SE3:
    """The pose as a pinocchio transform."""
    return pin.SE3(pin.rpy.rpyToMatrix(np.array(pose.angles)), np.array(pose.position))


def ball(point: Vector3, cone: float) -> tuple[PassiveJoint, ...]:
    """Hinges about x, y and z through a point of the hand [m], each within +-cone [rad]."""
    centre = pin.SE3(np.eye(3), np.array(point))
    kinds = (pin.JointModelRX(), pin.JointModelRY(), pin.JointModelRZ())
    places = (centre, pin.SE3.Identity(), pin.SE3.Identity())
    return tuple(
        PassiveJoint(name=f"ball_{axis}", joint=joint, placement=place, lower=-cone, upper=cone)
        for axis, joint, place in zip("xyz", kinds, places, strict=True)
    )
