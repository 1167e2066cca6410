"""Feetech STS3215 on a bus, as far as a position loop shows: lag, backlash, sag and a stall torque.

Counts as on the bus, 4096 a turn. A motor goes to its goal at a speed that grows with how far it is
off, less what its load takes of its torque; the joint follows by a gear with backlash, and hangs in
the direction of its load. The encoder sits on the joint.
"""

from __future__ import annotations

import numpy as np

from coopqp.base.spec import Array

TURN = 4096
#: Speed without load [counts/s], torque at stall [N m], of the 12 V servo.
FASTEST, STALL = 4.7 / (2 * np.pi) * TURN, 2.94
#: Share of the way that is left it goes in a second [1/s]; LeRobot's P of 16, no I.
GAIN = 12.0


class Servos:
    """So many motors.

    Args:
        counts: where the joints are at first.
        load: torque that each carries at rest [N m].
        backlash: between motor and joint [counts]; a degree is 11.4.
        stiffness: standing error per load [counts/(N m)]; I = 0.
    """

    def __init__(
        self, counts: Array, load: Array, *, backlash: float = 11.4, stiffness: float = 12.0
    ) -> None:
        self.goal = np.asarray(counts, float).copy()
        self.load, self.backlash, self.stiffness = load, backlash, stiffness
        self.motor = self.goal - stiffness * load
        self.joint = self.motor - 0.5 * backlash * np.sign(load)

    def read(self) -> Array:
        """What the encoders say."""
        return np.round(self.joint)

    def write(self, goal: Array) -> None:
        """Where to go; whole counts."""
        self.goal = np.trunc(goal)

    def step(self, dt: float) -> None:
        """Some time passes."""
        for _ in range(max(1, round(dt / 1e-3))):
            left = self.goal - self.stiffness * self.load - self.motor
            share = np.clip(1.0 - np.sign(left) * self.load / STALL, 0.0, 2.0)
            self.motor += np.clip(GAIN * left, -FASTEST, FASTEST) * share * 1e-3
            half = 0.5 * self.backlash
            hangs = self.motor - half * np.sign(self.load)
            loose = np.clip(self.joint, self.motor - half, self.motor + half)
            self.joint = np.where(self.load != 0.0, hangs, loose)
