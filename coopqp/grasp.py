"""How an arm holds the object: which motions between hand and object stay free.

A grasp adds its passive joints between the hand's tip frame and the object. The loop rows are
always the six of "the object is in one place", so they follow from the grasp by themselves.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin

from coopqp.spec import Pose, spec


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


@spec
class Grasp:
    """A plug-in in ``grasps/``: one arm's hold on the object."""

    object_in_hand: Pose | None = None
    """Pose of the object in the arm's tip frame when it is known; else the start tells, eq. (1)."""

    @abstractmethod
    def passive_joints(self) -> tuple[PassiveJoint, ...]:
        """The joints this grasp adds after the tip, hand first."""
        raise NotImplementedError


def pose_matrix(pose: Pose) -> pin.SE3:
    """The pose as a pinocchio transform."""
    return pin.SE3(pin.rpy.rpyToMatrix(np.array(pose.angles)), np.array(pose.position))
