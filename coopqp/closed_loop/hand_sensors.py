"""The wrench of the surroundings on the object, from sensors in the hands.

What the object's motion and weight need and the hands do not bring, w = M a_o + b - G h, with h as
measured and a_o by the difference of the object's velocity over a tick; a low pass of first order
takes the noise of that. Only the object's mass has to be known, not the arms'.
"""

from __future__ import annotations

import math

import numpy as np

from coopqp.base.spec import Array
from coopqp.closed_loop.dynamics import ClosedLoopDynamics
from coopqp.closed_loop.felt import Felt
from coopqp.closed_loop.grasp_matrix import grasp_matrix
from coopqp.closed_loop.hands import hands, points
from coopqp.model.state import Memory, State


class HandSensors:
    """Of one chain; what it remembers from tick to tick is in the law's memory.

    Args:
        dynamics: of arms and modelled object, up to date whenever this is updated.
        gain: one over the low pass's time constant [1/s].
        dt: time between updates [s].

    Attributes:
        wrench: force and torque on the object at its origin, world axes, as of the last
            update, shape (6,) [N, N m].
        memory_sizes: what to remember.
    """

    def __init__(self, dynamics: ClosedLoopDynamics, *, gain: float, dt: float) -> None:
        chain = dynamics.chain
        robot = [arm.name for arm in chain.robot.arms]
        self._dynamics, self._dt, self._share = dynamics, dt, 1.0 - math.exp(-gain * dt)
        self._hands = hands(chain)
        self._at = [robot.index(hand.arm) for hand in self._hands]
        self._felt = Felt(len(robot))
        self.wrench = np.zeros(6)
        self.memory_sizes = {"sensors.begun": 1, "sensors.twist": 6, "sensors.wrench": 6}

    @property
    def fault(self) -> str:
        """Why what was measured last cannot be used; empty if it can."""
        return self._felt.fault

    def update(self, memory: Memory, state: State) -> Array:
        """The wrench at the end of a period; zero at first, the last where nothing is measured.

        Args:
            memory: written.
            state: up to date, with ``hand_wrench``.

        Returns:
            ``wrench``.
        """
        dynamics, twist = self._dynamics, self._dynamics.J_object.dot(state.v)
        kept = memory["sensors.wrench"]
        found = self._felt.read(state.hand_wrench)
        if memory["sensors.begun"][0] and found is not None:
            M, b, _ = dynamics.object_inertia()
            G = grasp_matrix(points(self._hands, state.p_WO, state.R_WO), state.p_WO)
            h = found[self._at].ravel()
            a = (twist - memory["sensors.twist"]) / self._dt
            kept += self._share * (M.dot(a) + b - G.dot(h) - kept)
        memory["sensors.begun"][0], memory["sensors.twist"][:] = 1.0, twist
        self.wrench[:] = kept
        return self.wrench
