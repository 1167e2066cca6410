"""Hands that hold an object: contacts, measured wrenches, and rows of tasks on these.

C is the contact frame of a hand, fixed to the object: a pad moves with it, and a fingertip stays at
its place while the object turns. Where a hand is fastened, C is where its tip is at the start;
behind a hinge the tip moves on, and C stays.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin

from coopqp.base.spec import Array, real
from coopqp.base.wording import message_of
from coopqp.closed_loop.screw import LENGTH
from coopqp.grasp import Contact
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.state import State
from coopqp.task import Task, TaskStack

#: Larger measured values are refused [N, N m].
MAX_WRENCH = 1e6
NEEDS = "force and torque of each of the robot's arms [N, N m]"


@dataclass(frozen=True)
class Hand:
    """A hand that holds the object."""

    arm: str  # its name
    X_OC: pin.SE3  # pose of the contact frame in the object
    contact: Contact | None  # how it presses; None where it is fastened


def hands(chain: ClosedChain) -> tuple[Hand, ...]:
    """The hands that hold the object, in the order of ``chain.arms``."""
    found = zip(chain.hold.holders, chain.hand_poses(), strict=True)
    return tuple(Hand(arm, X_OC, chain.grasps[arm].contact) for arm, X_OC in found)


def robot_indices(chain: ClosedChain) -> list[int]:
    """Indices of the arms that hold the object, in the robot's order of arms."""
    names = [arm.name for arm in chain.robot.arms]
    return [names.index(arm) for arm in chain.hold.holders]


def points(hands: Sequence[Hand], p_WO: Array, R_WO: Array) -> Array:
    """Contact points in the world for the object's position and rotation, shape (N, 3) [m]."""
    return np.reshape([p_WO + R_WO @ hand.X_OC.translation for hand in hands], (-1, 3))


def into_contacts(hands: Sequence[Hand], R_WO: Array) -> Array:
    """Each hand's contact axes: R_CW, shape (N, 3, 3)."""
    return np.array([(R_WO @ hand.X_OC.rotation).T for hand in hands])


def in_axes(wrench: Array, R: Array) -> Array:
    """A wrench, shape (6,), in other axes at the same point, R from its axes into these."""
    return np.concatenate([R @ wrench[:3], R @ wrench[3:]])


def friction_needed(
    hands: Sequence[Hand], wrenches: Array, R_WO: Array
) -> Iterator[tuple[str, Contact, float]]:
    """Arms that press, and the friction that their wrenches need: world axes, shape (N, 6)."""
    for hand, w in zip(hands, wrenches, strict=True):
        if hand.contact:
            w_C = in_axes(w, (R_WO @ hand.X_OC.rotation).T)
            yield hand.arm, hand.contact, hand.contact.friction_needed(w_C)


class WrenchReadings:
    """Checks readings of force sensors; ``fault`` says why the last is not usable, else empty."""

    def __init__(self, chain: ClosedChain) -> None:
        self._size, self._at, self.fault = 6 * len(chain.robot.arms), robot_indices(chain), ""

    def read(self, reading: Any) -> Array | None:
        """Those of ``State.hand_wrench`` that hold, shape (N, 6); None where not usable."""
        self.fault = self._wrong(reading)
        return None if self.fault else real(reading).reshape(-1, 6)[self._at]

    def _wrong(self, reading: Any) -> str:
        if reading is None:
            return f"no hand_wrench has come; needs {self._size} numbers: {NEEDS}"
        try:
            given = real(reading)
        except Exception as error:  # noqa: BLE001 - anything can come from a driver
            message = message_of(error) or f"found {type(reading).__name__}, needs numbers"
            return f"hand_wrench: {message}"
        if given.shape != (self._size,):
            return f"hand_wrench: found shape {given.shape}, needs {(self._size,)}: {NEEDS}"
        bad = np.flatnonzero(~np.isfinite(given))
        if len(bad):
            return f"hand_wrench: found no finite number at {', '.join(map(str, bad[:6]))}"
        largest = float(np.abs(given).max())
        return "" if largest < MAX_WRENCH else f"hand_wrench: found {largest:.3g}, beyond any hand"


class WrenchStack(TaskStack):
    """The rows of several tasks with ``of_forces``, whose references begin at a state.

    J has the shape (r, 6 N), on wrenches of the hands that hold, each at its point, in world axes.
    In the weights torques count as forces at LENGTH.
    """

    def __init__(self, tasks: Sequence[Task], start: State) -> None:
        super().__init__(tasks, start, 6 * start.chain.holding)
        self.gains[:] = 0.0  # forces do not decay
        self.weights[np.array([row.unit == "N m" for row in self.rows], bool)] /= LENGTH**2

    def error(self, h: Array) -> Array:
        """J h - wanted, shape (r,), for wrenches of the hands that hold, shape (N, 6) [N, N m]."""
        return np.asarray(self.J @ np.ravel(h) - self.wanted, float)
