"""How an arm holds the object: which motions between hand and object stay free.

A grasp adds its passive joints between the hand's tip frame and the object. The loop rows are
always the six of "the object is in one place", so they follow from the grasp by themselves.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import pinocchio as pin

from coopqp.checked import Array, Pose, spec, unit
from coopqp.contact import Contact
from coopqp.errors import InvalidValueError


@dataclass(frozen=True, kw_only=True)
class PassiveJoint:
    """One free motion of the object in the hand.

    Attributes:
        name: without the arm's name, such as "hinge".
        joint: pinocchio joint model with one coordinate.
        placement: pose of the joint frame in the one before it (the tip frame for the first).
        lower, upper: limits [rad or m].
    """

    name: str
    joint: Any
    placement: pin.SE3
    lower: float = -math.inf
    upper: float = math.inf

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
        """The joints this grasp adds after the tip, hand first.

        Args:
            R_WT: orientation of the tip frame at the start, shape (3, 3), for axes that are given
                in the world.
        """

    @property
    def contact(self) -> Contact | None:
        """How it presses where it holds by that; None where it is fastened to the object."""
        return None


def axis_frame(
    axis: tuple[float, float, float],
    axis_in: Literal["hand", "world"],
    point: tuple[float, float, float],
    R_WT: Array,
) -> pin.SE3:
    """Frame in the hand with z along an axis and its origin on it.

    Args:
        axis: direction, in the hand or in the world.
        axis_in: which of the two.
        point: in the hand [m].
        R_WT: orientation of the hand at the start.
    """
    z = unit(axis) if axis_in == "hand" else R_WT.T @ unit(axis)
    turn = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), z)
    return pin.SE3(turn.toRotationMatrix(), np.array(point))


def pose_matrix(pose: Pose) -> pin.SE3:
    """The pose as a pinocchio transform."""
    return pin.SE3(pin.rpy.rpyToMatrix(np.array(pose.angles)), np.array(pose.position))
