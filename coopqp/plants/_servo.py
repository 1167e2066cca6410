"""Joint servos: from velocity or torque commands to motor torques within the motors' limits.

A velocity command moves the desired angle, q_d += v dt, and each joint follows it:

    tau = K (q_d - q) + D (v_d - v) + gravity compensation,   |tau| <= effort
    K = effort / saturation_angle,   D = 2 damping_ratio sqrt(K min(1/W_jj, A_jj))

with 1/W_jj the inertia at the joint with the loops closed, W = N (N' A N)^-1 N'. (The tree's
A_jj, with all other joints locked, would overdamp the light motions of the closed chain; 1/W_jj
is unbounded where the loops fix a joint, and the little that a real grasp yields there would be
damped with the motor's whole torque.) A torque command goes to the motors as it is.

With a ``frequency`` w, all joints follow alike by the tree's inertia A (computed torque):

    tau = A (w^2 (q_d - q) + 2 damping_ratio w (v_d - v)) + gravity compensation

Each arm carries its own weight and its share alpha of the object's, so that the servos of arms
that hold one object do not squeeze it. Passive joints carry nothing: their weight torque is taken
by the smallest wrench between the hands that can.
"""

from __future__ import annotations

import numpy as np

from coopqp.base.rank import least_squares, null_space
from coopqp.base.spec import Array, Positive, spec
from coopqp.closed_loop.dynamics import ClosedLoopDynamics
from coopqp.controller import Command
from coopqp.model.closed_chain import ClosedChain


@spec
class Servo:
    """How the joints follow velocity commands; torque commands pass through."""

    saturation_angle: Positive = 0.05
    """Angle error at which a servo asks its full torque [rad]."""
    frequency: Positive | None = None
    """With which all joints follow, whatever they move [rad/s]; the angle does not count then."""
    damping_ratio: Positive = 1.0
    """With the inertia a joint sees; 1 is critical."""
    gravity_compensation: bool = True
    """Whether the torques that hold the modelled weight are added."""


class ServoLaw:
    """The servos of one chain.

    Attributes:
        tau, asked: torques as of the last :meth:`torque`, and before they were limited by
            ``effort``, which is zero for passive joints, shape (n,) [N m].
        stiffness: K, zero for passive joints, shape (n,) [N m/rad]; not used with a frequency.
        follows: whether the last command was a velocity, or there was none.
    """

    def __init__(self, chain: ClosedChain, servo: Servo) -> None:
        self._model = ClosedLoopDynamics(chain, shares=fair_shares(chain))
        motors = np.zeros(chain.n, bool)
        motors[self._model.actuated] = True
        self.effort = np.where(motors, chain.model.effortLimit, 0.0)
        self.stiffness = full_effort(chain) / servo.saturation_angle
        self._ratio, self._frequency = servo.damping_ratio, servo.frequency
        self._compensate = servo.gravity_compensation
        self._q_d, self.follows = chain.q_start.copy(), True
        self._rest, self._damping, self._v_d, self._forward = np.zeros((4, chain.n))
        self.tau, self.asked = np.zeros((2, chain.n))

    def resume(self, before: ServoLaw) -> None:
        """Keep the desired angles of the servos of the phase before."""
        self._q_d[:], self._v_d[:] = before._q_d, before._v_d
        self._forward[:], self.follows = before._forward, before.follows
        self._ask(self._forward)

    def hold(self, q: Array) -> None:
        """Hold these angles, from where velocity commands go on."""
        self._q_d[:] = q

    def begin(self, command: Command, q: Array) -> None:
        """Take a command for the next control period."""
        self.follows = command.tau is None
        if command.tau is not None:
            self._forward[:] = command.tau
            self._ask(self._forward)
            return
        self._v_d[:] = command.v
        self._model.update(q, self._rest)
        A = self._model.A
        inertia = np.minimum(inertia_seen(A, self._model.J), np.diag(A))
        self._damping = 2.0 * self._ratio * np.sqrt(self.stiffness * inertia)
        if self._compensate:
            self._forward[:] = self.weight(q)

    def weight(self, q: Array) -> Array:
        """Motor torques that hold the modelled arms and object at q, shape (n,) [N m]."""
        model, passive = self._model, self._model.passive
        Gamma = model.gravity(q)
        if len(passive):
            wrench = least_squares(model.J[:, passive].T, Gamma[passive])
            Gamma = Gamma - model.J.T @ wrench
            Gamma[passive] = 0.0
        return Gamma

    def advance(self, h: float) -> None:
        if self.follows:
            self._q_d += h * self._v_d

    def torque(self, q: Array, v: Array) -> Array:
        """Motor torques at a state, within their limits, shape (n,) [N m]."""
        if not self.follows:
            return self.tau
        behind, slower = self._q_d - q, self._v_d - v
        if (w := self._frequency) is not None:
            following = self._model.A @ (w**2 * behind + 2.0 * self._ratio * w * slower)
        else:
            following = self.stiffness * behind + self._damping * slower
        self._ask(following + self._forward)
        return self.tau

    def _ask(self, asked: Array) -> None:
        """Torques within the motors' limits; those of a command stay for its period."""
        self.asked[:] = asked
        np.maximum(asked, -self.effort, out=self.tau)
        np.minimum(self.tau, self.effort, out=self.tau)


#: Taken for the stiffness of a joint whose motor has no limit [N m].
UNLIMITED_EFFORT = 100.0


def fair_shares(chain: ClosedChain) -> dict[str, float]:
    """Share of the object's weight that each arm carries: its weight alpha in the pose."""
    return {arm.name: a for arm, a in zip(chain.arms, chain.alpha.tolist(), strict=True)}


def full_effort(chain: ClosedChain) -> Array:
    """The motors' limits as a basis of stiffness, zero at passive joints, shape (n,)."""
    effort = chain.model.effortLimit.copy()
    effort[chain.passive] = 0.0
    # A file that gives no limit means a motor without one.
    return np.where(np.isfinite(effort), effort, UNLIMITED_EFFORT)


def inertia_seen(A: Array, J: Array) -> Array:
    """Inertia at each joint, shape (n,), of a tree's A with the loops closed by rows J (m, n).

    Zero at a joint that the loops fix: it is infinitely heavy and needs no damping.
    """
    N = null_space(J)
    mobility = np.einsum("ij,ij->i", N @ np.linalg.inv(N.T @ A @ N), N)
    return np.where(mobility > 1e-9, 1.0 / np.maximum(mobility, 1e-9), 0.0)
