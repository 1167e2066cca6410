"""Signals of the hands in plants with masses: wrenches, friction, slip, and whether it is held."""

from __future__ import annotations

import numpy as np

from coopqp.base.spec import Array
from coopqp.closed_loop.hands import Hand, hands, robot_indices
from coopqp.grasp import BEYOND, NO_CONTACT
from coopqp.model.closed_chain import ClosedChain

#: A hand that presses and has not touched the object for so long has lost it [s].
LOST = 0.02
#: Friction beyond what there is by less than this share is rounding.
ROUNDING = 1e-3


class HandSignals:
    """Signals of the hands, in the robot's order of arms; zero for those that hold nothing.

    ``chain`` is the true one, and ``friction`` that of real contacts over the modelled one.

    Attributes:
        hands: those that hold, in the chain's order. at: their indices in the robot's.
        signals: ``hand_wrench`` (6 N,), of each hand on the object at its point, world axes [N,
            N m]; ``hand_point`` (3 N,), where that is [m]; and where any hand presses
            ``normal_force`` (N,) and ``tangential_force`` (N,) [N], ``friction_use`` (N,), required
            over available friction, at most ``MAX_USE``, ``edge_use`` (N,), how far out on the pad
            the pressure is, 1 at its edge, ``slip`` (N,), how far the object has moved along the
            contact [m], and ``held`` (1,), 1 until the object is lost. Both uses are NaN while a
            hand presses on nothing, and ``edge_use`` of a point always is.
        lost: which hand lost it and why; empty while it is held.
    """

    def __init__(self, chain: ClosedChain, friction: float) -> None:
        arms = len(chain.robot.arms)
        self.signals = {"hand_wrench": np.zeros(6 * arms), "hand_point": np.zeros(3 * arms)}
        self.lost, self._friction, self._apart = "", friction, np.zeros(arms)
        if any(grasp.contact for grasp in chain.grasps.values()):
            for name in ("normal_force", "tangential_force", "friction_use", "edge_use", "slip"):
                self.signals[name] = np.zeros(arms)
            self.signals["held"] = np.ones(1)
        self.follow(chain)

    def follow(self, chain: ClosedChain) -> None:
        """Take another chain of the same robot, in which other arms hold the object."""
        self.hands: tuple[Hand, ...] = hands(chain)
        self.at = robot_indices(chain)

    @property
    def pressing(self) -> bool:
        """Whether a hand holds by pressing."""
        return any(hand.contact for hand in self.hands)

    def write(
        self, wrenches: Array, points: Array, in_contacts: Array, borne: Array | None = None
    ) -> None:
        """Write the signals.

        Args:
            wrenches: on the object, each at its point, world axes, shape (holding, 6).
            points: in the world, shape (holding, 3) [m].
            in_contacts: the same wrenches in the contacts' frames, shape (holding, 6).
            borne: sum of the friction forces' sizes over all points of each contact, shape
                (holding,) [N]; by the contact's own model of friction if omitted.
        """
        for name, signal in self.signals.items():
            if name not in ("held", "slip"):
                signal[:] = 0.0
        by_arm = self.signals["hand_wrench"].reshape(-1, 6)
        by_arm[self.at] = wrenches
        self.signals["hand_point"].reshape(-1, 3)[self.at] = points
        for k, (hand, i, w) in enumerate(zip(self.hands, self.at, in_contacts, strict=True)):
            if hand.contact:
                self.signals["normal_force"][i] = w[2]
                self.signals["tangential_force"][i] = np.hypot(w[0], w[1])
                self.signals["edge_use"][i] = hand.contact.edge_use(w)
                self.signals["friction_use"][i] = np.nan
                if w[2] > NO_CONTACT:
                    needed = hand.contact.friction_needed(w) if borne is None else borne[k] / w[2]
                    use = needed / (self._friction * hand.contact.friction)
                    self.signals["friction_use"][i] = min(use, MAX_USE)

    def touch(self, dt: float) -> None:
        """Count how long hands have not pressed, by dt [s]; the object is lost after some time."""
        for hand, i in zip(self.hands, self.at, strict=True):
            if hand.contact:
                touches = self.signals["normal_force"][i] > 0.0
                self._apart[i] = 0.0 if touches else self._apart[i] + dt
                if self._apart[i] > LOST:
                    self.lose(f"{hand.arm} no longer touches it")

    def bear(self) -> None:
        """Declare the object lost where friction cannot bear the hands' wrenches."""
        for hand, i in zip(self.hands, self.at, strict=True):
            if not hand.contact:
                continue
            if np.isnan(self.signals["friction_use"][i]):
                self.lose(f"{hand.arm} would have to pull it")
            elif self.signals["edge_use"][i] > 1.0 + BEYOND:
                self.lose(f"{hand.arm} tips over its pad's edge")
            elif self.signals["friction_use"][i] > 1.0 + ROUNDING:
                self.lose(f"{hand.arm} needs more friction than there is")

    def lose(self, why: str) -> None:
        """Declare the object lost from now on."""
        if not self.lost:
            self.lost = why
        self.signals["held"][0] = 0.0


#: Largest reported use of friction.
MAX_USE = 10.0
