"""What the object's weight makes the joint servos sag by, and the loops open by.

Springs of stiffness K hold the joints, and the hands' forces h_i on the object carry its weight,

    u = -K^-1 sum_i J_i' h_i / load,     d = J_c u load

with the h_i as grips alike share them, forces at the hands' points and as little torque as can be:
h = W G' (G W G')^-1 w, W = diag(1, (0.03 m)^2). Grips that yield transmit no more.
"""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin

from coopqp.base.spec import Array
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.state import State

#: Size of a grip: its rotational stiffness over the other is (this)^2 [m].
GRIP_SIZE = 0.03
#: An object that is commanded to move faster does not rest: the servos' lag would count as a sag
#: [m/s]; a rotation counts by 0.1 m.
REST, SPEEDS = 0.005, np.array([1.0, 1.0, 1.0, 0.1, 0.1, 0.1])

#: Sags below this are rounding.
TINY = 1e-15


class WeightSag:
    """The sag for one newton of weight.

    ``compliance`` is 1/K by joint, shape (n,) [rad/(N m)].

    Attributes:
        sag: u, shape (n,) [rad/N].
        opened: by which the loops open for one newton, shape (6 L,) [m/N, rad/N].
    """

    def __init__(self, chain: ClosedChain, compliance: Array) -> None:
        self._compliance, self._torque = compliance, np.zeros(chain.n)
        self.sag, self.opened = np.zeros(chain.n), np.zeros(6 * (len(chain.arms) - 1))
        self._squeeze = self._bent = np.zeros(chain.n)
        self._up = -chain.model.gravity.linear
        self._up = self._up / max(float(np.linalg.norm(self._up)), 1e-12)
        com = pin.skew(np.array(chain.held.com))
        at_origin = np.zeros((6 * len(chain.arms), 3))  # of each arm, for a load along x, y, z
        at_origin[: 6 * chain.holding] = _shares(_points(chain)) @ np.vstack([np.eye(3), com])
        # Of J_ext = M [J_0; J_1; ...], so that sum_i J_i' h_i = J_ext' M^-T h.
        self._to_rows = np.linalg.solve(chain.mixing.T, at_origin)

    def update(self, state: State, along: Array | None = None) -> None:
        """Follow an up-to-date state, in which the hands may squeeze ``along`` a loop direction."""
        R = state.R_WO
        rows = self._to_rows.dot(self._up.dot(R)).reshape(-1, 3).dot(R.T)
        rows.ravel().dot(state.J_ext, self._torque)
        np.multiply(self._compliance, self._torque, self.sag)
        np.negative(self.sag, self.sag)
        if along is not None:
            self._squeeze = along.dot(state.J_rel)
            self._bent = self._compliance * self._squeeze
            self._bent /= max(float(self._bent.dot(self._squeeze)), TINY)
            self.straighten(self.sag)
        state.J_rel.dot(self.sag, self.opened)

    def straighten(self, sag: Array) -> None:
        """Take out of a sag, shape (n,) [rad], what a squeeze along that direction does to it."""
        sag -= self._squeeze.dot(sag) * self._bent

    def load(self, state: State, sag: Array) -> float:
        """The load that a sag, shape (n,) [rad], tells of, by least squares [N]; NaN in motion."""
        twist, size = state.J_task.dot(state.v) * SPEEDS, -self._torque.dot(self.sag)
        if not twist.dot(twist) < REST * REST or not size > TINY:
            return math.nan
        return max(0.0, float(-self._torque.dot(sag) / size))


def _points(chain: ClosedChain) -> list[Array]:
    """Where each hand that holds the object touches it, in the object [m]."""
    model, data = chain.model, chain.model.createData()
    pin.framesForwardKinematics(model, data, chain.q_start)
    found = []
    for arm, frame in zip(chain.arms[: chain.holding], chain.frames, strict=False):
        contact = chain.grasps[arm.name].contact
        tip = data.oMf[frame].actInv(data.oMf[model.getFrameId(arm.tip)])
        found.append((tip * contact.placement if contact else tip).translation.copy())
    return found


def _shares(points: list[Array]) -> Array:
    """Each hand's wrench at the object's origin for one there, shape (6 N, 6), object axes."""
    each, grips = [], np.diag([1.0, 1.0, 1.0, *[GRIP_SIZE**2] * 3])
    for p in points:
        G = np.eye(6)
        G[3:, :3] = pin.skew(p)
        each.append(G @ grips @ G.T)
    return np.asarray(np.vstack(each) @ np.linalg.inv(sum(each)), float)
