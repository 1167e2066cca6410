"""Where the hands that hold an object touch it: their points and, by contact, their normals.

C is the contact frame of a hand. It is fixed to the object: a pad moves with it, and a fingertip
stays at its place while the object turns. Where a hand is fastened, C is where its tip is at the
start; behind a hinge the tip moves on, and C stays.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin

from coopqp.base.spec import Array, real
from coopqp.base.wording import said
from coopqp.grasp import Contact
from coopqp.model.closed_chain import ClosedChain

#: Larger measured values are refused [N, N m].
MAX_WRENCH = 1e6
NEEDS = "force and torque of each of the robot's arms [N, N m]"


@dataclass(frozen=True)
class Hand:
    """A hand that holds the object.

    Attributes:
        arm: its name.
        X_OC: pose of the contact frame in the object.
        contact: how it presses; None where it is fastened.
    """

    arm: str
    X_OC: pin.SE3
    contact: Contact | None


def hands(chain: ClosedChain) -> tuple[Hand, ...]:
    """The hands that hold the object, in the order of ``chain.arms``."""
    model, data = chain.model, chain.model.createData()
    pin.framesForwardKinematics(model, data, chain.q_start)
    found = []
    for arm, frame in zip(chain.arms[: chain.holding], chain.frames, strict=False):
        contact = chain.grasps[arm.name].contact
        X_OC = data.oMf[frame].actInv(data.oMf[model.getFrameId(arm.tip)])
        found.append(Hand(arm.name, X_OC * contact.placement if contact else X_OC, contact))
    return tuple(found)


def points(hands: Sequence[Hand], p_WO: Array, R_WO: Array) -> Array:
    """Where the hands are in the world, shape (N, 3) [m].

    Args:
        hands: of :func:`hands`.
        p_WO: where the object is, shape (3,) [m].
        R_WO: how it is turned, shape (3, 3).
    """
    return np.array([p_WO + R_WO @ hand.X_OC.translation for hand in hands])


def into_contacts(hands: Sequence[Hand], R_WO: Array) -> Array:
    """Each hand's contact axes: R_CW, shape (N, 3, 3)."""
    return np.array([(R_WO @ hand.X_OC.rotation).T for hand in hands])


def in_axes(wrench: Array, R: Array) -> Array:
    """A wrench in other axes, at the same point, shape (6,).

    Args:
        wrench: force and torque, shape (6,).
        R: from its axes into the others, shape (3, 3).
    """
    return np.concatenate([R @ wrench[:3], R @ wrench[3:]])


class Felt:
    """The last reading that was looked at.

    Args:
        arms: how many the robot has, N.

    Attributes:
        fault: why it cannot be used; empty if it can.
    """

    def __init__(self, arms: int) -> None:
        self._size, self.fault = 6 * arms, ""

    def read(self, found: Any) -> Array | None:
        """The wrenches by arm, shape (N, 6); None where they cannot be used.

        Args:
            found: ``State.hand_wrench``; anything can come from a driver.
        """
        self.fault = self._wrong(found)
        return None if self.fault else real(found).reshape(-1, 6)

    def _wrong(self, found: Any) -> str:
        if found is None:
            return f"no hand_wrench has come; needs {self._size} numbers: {NEEDS}"
        try:
            given = real(found)
        except Exception as error:  # noqa: BLE001 - anything can come from a driver
            return f"hand_wrench: {said(error) or f'found {type(found).__name__}, needs numbers'}"
        if given.shape != (self._size,):
            return f"hand_wrench: found shape {given.shape}, needs {(self._size,)}: {NEEDS}"
        bad = np.flatnonzero(~np.isfinite(given))
        if len(bad):
            return f"hand_wrench: found no finite number at {', '.join(map(str, bad[:6]))}"
        most = float(np.abs(given).max())
        return "" if most < MAX_WRENCH else f"hand_wrench: found {most:.3g}, which no hand does"
