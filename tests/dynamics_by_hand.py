"""Dynamics of closed chains, written out by projection, by multipliers and by pinocchio."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import scipy.linalg
from chains import Closed, with_mass

from coopqp.base.spec import Array
from coopqp.closed_loop.dynamics import ClosedLoopDynamics
from coopqp.model.closed_chain import ClosedChain

#: Of the object's mass, by arm.
SHARES = ((1.0, 0.0), (0.0, 1.0), (0.5, 0.5))  # of the right and the left arm


class Oracle:
    """The terms of the closed chain from pinocchio's local Jacobians and their time variation."""

    def __init__(self, chain: ClosedChain, arm: int = 0) -> None:
        self.frames, self.model = chain.frames, with_mass(chain, {arm: 1.0})
        self.data = self.model.createData()

    def update(self, q: Array, v: Array) -> None:
        """A, H, J and Jdot v with the rows in the object's own axes."""
        model, data, local = self.model, self.data, pin.LOCAL
        self.H = pin.rnea(model, data, q, v, np.zeros_like(v))
        self.A = pin.crba(model, data, q).copy()
        pin.computeJointJacobiansTimeVariation(model, data, q, v)
        pin.updateFramePlacements(model, data)
        J = [pin.getFrameJacobian(model, data, f, local) for f in self.frames]
        dJ = [pin.getFrameJacobianTimeVariation(model, data, f, local) for f in self.frames]
        self.J = np.vstack([J_i - J[0] for J_i in J[1:]])
        self.drift = np.concatenate([(dJ_i - dJ[0]) @ v for dJ_i in dJ[1:]])

    def by_projection(self, tau: Array) -> Array:
        """Accelerations N y + a_0 with N' A N y = N' (tau - H - A a_0)."""
        N = scipy.linalg.null_space(self.J, rcond=1e-8)
        a_0 = -np.linalg.lstsq(self.J, self.drift, rcond=1e-8)[0]
        rest = tau - self.H - self.A @ a_0
        return a_0 + N @ np.linalg.solve(N.T @ self.A @ N, N.T @ rest)

    def by_kkt(self, tau: Array) -> Array:
        """Accelerations from the whole system with multipliers."""
        rows = len(self.drift)
        K = np.block([[self.A, self.J.T], [self.J, np.zeros((rows, rows))]])
        x = np.linalg.solve(K, np.concatenate([tau - self.H, -self.drift]))
        return np.asarray(x[: len(tau)])


class PinocchioOracle:
    """pinocchio's own constrained forward dynamics, one 6D contact between the arms' objects."""

    def __init__(self, chain: ClosedChain) -> None:
        self.model = with_mass(chain, {0: 1.0})
        self.data = self.model.createData()
        first, second = (chain.model.frames[f] for f in chain.frames)
        contact = pin.RigidConstraintModel(
            pin.ContactType.CONTACT_6D, self.model, first.parentJoint, first.placement,
            second.parentJoint, second.placement, pin.LOCAL,
        )  # fmt: skip
        self.contacts, self.contact_data = (
            pin.StdVec_RigidConstraintModel([contact]),
            pin.StdVec_RigidConstraintData([contact.createData()]),
        )
        self.settings = pin.ProximalSettings(1e-14, 0.0, 10)
        pin.initConstraintDynamics(self.model, self.data, self.contacts, self.contact_data)

    def acceleration(self, q: Array, v: Array, tau: Array) -> Array:
        a = pin.constraintDynamics(
            self.model, self.data, q, v, tau, self.contacts, self.contact_data, self.settings
        )
        return np.array(a)


def relative(found: Array, true: Array) -> float:
    return float(np.linalg.norm(found - true) / np.linalg.norm(true))


def accelerations(
    dynamics: ClosedLoopDynamics, states: list[Closed], seed: int = 5
) -> list[tuple[Array, Array]]:
    """Random torques of the actuated joints and the accelerations they cause, in each state."""
    rng, found = np.random.default_rng(seed), []
    for q, v in states:
        tau = np.zeros(len(q))
        tau[dynamics.actuated] = rng.normal(size=len(dynamics.actuated))
        dynamics.update(q, v)
        found.append((tau, dynamics.direct(tau).a.copy()))
    return found
