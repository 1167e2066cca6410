"""Closed-loop inverse and direct dynamics: section 4 of the paper, for N arms.

Letters: n joints, m independent loop rows, f = n - m degrees of freedom, k actuated joints.

    A a + H = S' tau + J_c' lambda,   J_c a + Jdot_c v = 0          tree plus loops, eq. (13), (22)

A (n, n) is the tree's inertia matrix with the object on the arms, H (n,) Coriolis, centrifugal,
gravity and friction forces, S the rows of the actuated joints, lambda (m,) the wrench at the cut.
With N (n, f) a basis of the null space of J_c the loops drop out, N' A a + N' H = N' S' tau; that
is eq. (24), whose [I; G] is one such basis.

Both models are solved as one saddle-point system: no independent coordinates are chosen, no inertia
matrix is inverted (with a massless link behind a passive joint A is singular, only N' A N is not),
and a singular actuation scheme is noticed by its condition.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike
from scipy.linalg import lapack

from coopqp.base.errors import GraspError, InvalidValueError
from coopqp.base.rank import independent_rows, least_squares, null_space
from coopqp.base.spec import Array, NonNegative, Positive, spec
from coopqp.closed_loop.constraint_equations import motor_indices
from coopqp.model.closed_chain import ClosedChain


@spec
class Friction:
    """Joint friction: viscous v + coulomb tanh(v / smoothing)."""

    viscous: NonNegative = 0.0
    """[N m s/rad]"""
    coulomb: NonNegative = 0.0
    """[N m]"""
    smoothing: Positive = 0.01
    """Speed at which Coulomb friction is three quarters of its full value [rad/s]."""


class DirectResult(NamedTuple):  # made at every step of a plant, in a third of a dataclass's time
    """Result of the direct model; arrays are reused by the next call."""

    a: Array  # joint accelerations, shape (n,) [rad/s2]
    # lambda on all loop rows, shape (6 L,): force [N] and torque [N m] on arm i's side of the cut,
    # world axes, at the object's origin; the opposite acts on arm 0's side
    wrench: Array
    singular: bool  # whether the loops were singular, so that this is a least-squares solution


@dataclass(frozen=True)
class InverseResult:
    """Result of the inverse model; arrays are reused by the next call."""

    tau: Array  # torques of all joints, zero where a joint is not actuated, shape (n,) [N m]
    wrench: Array  # as in DirectResult
    # whether the scheme cannot produce every motion here; tau is then the least-squares solution
    singular: bool
    residual: float  # largest generalised force that tau does not produce [N m]


@dataclass(frozen=True)
class ObjectWrenches:
    """Wrenches on the object: force [N] and torque [N m] at its origin, world axes."""

    needed: Array  # by its motion and weight, shape (6,)
    by_arm: Array  # of each hand, shape (N, 6); they sum to ``needed``
    internal: Array  # the part that cancels between the hands, shape (N, 6); sums to zero


class ClosedLoopDynamics:
    """Inverse and direct dynamic model of a closed chain.

    Args:
        shares: share of the object's mass on each arm's last body, shape (N,), with sum 1; all on
            the first arm if omitted. It changes the wrench at the cut, nothing else.
        actuated: names of the actuated joints; all but the passive ones if omitted.
        mass_scale: of the object's mass and inertia over the chain's.

    Attributes:
        model: the tree with the object's mass.
        A, H, J, drift: the terms above as of the last :meth:`update`; drift is Jdot_c v, (m,).
        J_arms: Jacobian of the object as carried by each arm, shape (6 N, n).
        drift_arms: the object's acceleration at a = 0 by each arm, shape (6 N,).
        J_object: the first six rows of J_arms.
        kept: which of the 6 L loop rows J has, shape (m,).
        actuated: indices of the actuated joints, shape (k,).

    InvalidValueError: shares that do not sum to one, too few or repeated actuated joints, or a
    passive joint among them. UnknownNameError: an unknown joint. GraspError: a released arm has
    passive joints, which nothing would hold.
    """

    def __init__(
        self,
        chain: ClosedChain,
        *,
        shares: ArrayLike | None = None,
        friction: Friction | None = None,
        actuated: Sequence[str] | None = None,
        mass_scale: float = 1.0,
    ) -> None:
        self.chain = chain
        for arm in chain.arms[chain.holding :]:
            if chain.grasps[arm.name].passive_joints(np.eye(3)):
                raise GraspError(
                    f"arm {arm.name}, when it lets go, would leave the joints of its passive grasp "
                    "swinging without mass; use plant: kinematic, or a rigid grasp"
                )
        body = chain.held.body()
        # Kept, because pinocchio makes these arrays anew whenever it is asked.
        self._mass, self._lever = mass_scale * body.mass, body.lever.copy()
        self._inertia = mass_scale * body.inertia
        self._each_way, self._falls = self._mass * np.eye(3), chain.model.gravity.linear.copy()
        self.shares = a = np.eye(len(chain.arms))[0] if shares is None else np.array(shares, float)
        if len(a) != len(chain.arms) or not a.min() >= 0.0 or not abs(a.sum() - 1.0) <= 1e-9:
            words = f"needs {len(chain.arms)}, one an arm, of at least 0 that sum to 1"
            raise InvalidValueError(f"shares: found {a.tolist()}, {words}")
        self.model = chain.model.copy()
        for index, share in zip(chain.frames, self.shares, strict=True):
            if share > 0.0:
                frame = chain.model.frames[index]
                part = pin.Inertia(share * self._mass, body.lever, share * self._inertia)
                self.model.appendBodyToJoint(frame.parentJoint, part, frame.placement)
        self.actuated = np.setdiff1d(np.arange(chain.n), chain.passive)
        if actuated is not None:
            motors, freedom = motor_indices(chain, actuated), chain.n - chain.loops.rank
            if len(motors) < freedom:
                raise InvalidValueError(
                    f"actuated: {len(motors)} joints cannot drive {freedom} degrees of freedom; "
                    f"name at least {freedom}"
                )
            self.actuated = np.array(motors, np.intp)
        self._data = self.model.createData()
        self._friction = friction if friction and (friction.viscous or friction.coulomb) else None
        self._allocate()

    def _allocate(self) -> None:
        chain, n = self.chain, self.chain.n
        rows = len(chain.loops.names)
        self.kept = np.array(chain.loops.kept, int)[: chain.loops.rank]
        m, k = len(self.kept), len(self.actuated)
        self.A, self.H = np.zeros((n, n)), np.zeros(n)
        self.J_arms, self.drift_arms = np.zeros((rows + 6, n)), np.zeros(rows + 6)
        self.J_object = self.J_arms[:6]
        by_arm = self.J_arms.reshape(-1, 6, n), self.drift_arms.reshape(-1, 6)
        self._of_arms = list(zip(chain.frames, *by_arm, strict=True))
        self._J_rel, self._drift_rel = np.zeros((rows, n)), np.zeros(rows)
        whole = m == rows
        self.J = self._J_rel if whole else np.zeros((m, n))
        self.drift = self._drift_rel if whole else np.zeros(m)
        self._zero = np.zeros(n)
        # The relative rows follow from those of the arms as in eq. (30).
        self._relative = np.ascontiguousarray(chain.mixing[6:])
        self._direct, self._direct_rhs = Saddle(n, m), np.zeros(n + m)
        self.passive = np.setdiff1d(np.arange(n), self.actuated)
        self._scheme, self._scheme_rhs = Saddle(m, n - k), np.zeros(m + n - k)
        self._tau, self._a = np.zeros(n), np.zeros(n)
        self._wrench = np.zeros(rows)

    def update(self, q: Array, v: Array) -> None:
        """Compute every term at q, v of shape (n,) with the loops closed, J_c v = 0."""
        model, data = self.model, self._data
        self.A[:] = pin.crba(model, data, q)
        self.H[:] = pin.nonLinearEffects(model, data, q, v)
        if f := self._friction:
            self.H += f.viscous * v + f.coulomb * np.tanh(v / f.smoothing)
        pin.forwardKinematics(model, data, q, v, self._zero)
        pin.computeJointJacobians(model, data)
        world = pin.LOCAL_WORLD_ALIGNED
        for frame, J, drift in self._of_arms:
            pin.updateFramePlacement(model, data, frame)
            J[:] = pin.getFrameJacobian(model, data, frame, world)
            drift[:] = pin.getFrameClassicalAcceleration(model, data, frame, world).vector
        self._relative.dot(self.J_arms, self._J_rel)
        self._relative.dot(self.drift_arms, self._drift_rel)
        if self.chain.loops.varying:
            kept = np.array(self.chain.loops.kept, int)
            chosen = kept[independent_rows(self._J_rel[kept], max_rows=len(self.drift))]
            # At a singular pose fewer rows are independent; any others fill up.
            self.kept = np.concatenate([chosen, np.setdiff1d(kept, chosen)])[: len(self.drift)]
        if self.J is not self._J_rel:
            np.take(self._J_rel, self.kept, axis=0, out=self.J)
            np.take(self._drift_rel, self.kept, out=self.drift)

    def direct(self, tau: Array) -> DirectResult:
        """Accelerations from torques, shape (n,) [N m]: the DDM of section 4.3.

        Solves [A J'; J 0] [a; -lambda] = [tau - H; -Jdot v]; tau of passive joints should be 0.
        """
        n, saddle, rhs = self.chain.n, self._direct, self._direct_rhs
        saddle.top[:], saddle.right[:], saddle.left[:] = self.A, self.J.T, self.J
        np.subtract(tau, self.H, rhs[:n])
        np.negative(self.drift, rhs[n:])
        x, singular = saddle.solve(rhs)
        self._a[:] = x[:n]
        if self.J is self._J_rel:
            np.negative(x[n:], self._wrench)
        else:
            self._wrench[:] = 0.0
            self._wrench[self.kept] = -x[n:]
        return DirectResult(self._a, self._wrench, singular)

    def impact(self, v: Array) -> Array:
        """Velocity, shape (n,), after loops have closed inelastically on a velocity v.

        Solves [A J'; J 0] [v+; -impulse] = [A v; 0]: the nearest motion in kinetic energy.
        """
        n, saddle, rhs = self.chain.n, self._direct, self._direct_rhs
        saddle.top[:], saddle.right[:], saddle.left[:] = self.A, self.J.T, self.J
        self.A.dot(v, rhs[:n])
        rhs[n:] = 0.0
        x, _ = saddle.solve(rhs)
        return np.array(x[:n])

    def inverse(self, a: Array) -> InverseResult:
        """Torques for accelerations a with J_c a = -Jdot_c v: the CLIDM, eq. (21)-(24).

        With more actuators than degrees of freedom the torques of least norm, eq. (25)-(27). The
        Gamma of the tree is A a + H; the cut wrench lambda makes the passive rows free of torque,
        J_p' lambda = Gamma_p, and minimises the remaining tau = Gamma_a - J_a' lambda.
        """
        return self.distribute(self.A.dot(a) + self.H)

    def distribute(self, Gamma: Array) -> InverseResult:
        """Motor torques equivalent to the tree's torques Gamma, shape (n,), eq. (23), (27)."""
        m, act, pas = len(self.drift), self.actuated, self.passive
        Gamma_a, Gamma_p = Gamma[act], Gamma[pas]
        J_a, J_p = np.take(self.J, act, axis=1), np.take(self.J, pas, axis=1)
        saddle, rhs = self._scheme, self._scheme_rhs
        saddle.top[:], saddle.right[:], saddle.left[:] = J_a.dot(J_a.T), J_p, J_p.T
        rhs[:m], rhs[m:] = J_a.dot(Gamma_a), Gamma_p
        x, singular = saddle.solve(rhs)
        wrench = x[:m]
        self._wrench[:] = 0.0
        self._wrench[self.kept] = wrench
        self._tau[act] = Gamma_a - wrench.dot(J_a)
        undone = np.abs(Gamma_p - wrench.dot(J_p)) if singular else np.zeros(1)
        return InverseResult(self._tau, self._wrench, singular, float(undone.max(initial=0.0)))

    def null_space(self) -> Array:
        """Orthonormal basis N of the null space of J_c as of the last update, shape (n, f)."""
        return null_space(self.J)

    def gravity(self, q: Array) -> Array:
        """Torques of the tree that hold it at rest, shape (n,) [N m]."""
        return np.asarray(pin.computeGeneralizedGravity(self.model, self._data, q), float)

    def object_wrenches(self, a: Array, wrench: Array, push: Array | None = None) -> ObjectWrenches:
        """Split the hands' wrenches on the object into what moves it and what is internal.

        ``wrench`` is at the cut, from :meth:`direct` or :meth:`inverse` in the same state;
        ``push``, an external one on the object, shape (6,), acts on the tree through arm 0 as
        ``J_object' push``.
        """
        M, b = self.object_inertia()
        carried = M @ (self.drift_arms[:6] + self.J_arms[:6] @ a) + b
        needed = carried if push is None else carried - push
        loops = wrench.reshape(-1, 6)
        by_arm = np.outer(self.shares, carried)
        by_arm[0] += loops.sum(axis=0) + (needed - carried)
        by_arm[1:] -= loops
        internal = by_arm - np.outer(self.chain.alpha, needed)
        return ObjectWrenches(needed, by_arm, internal)

    def object_inertia(self) -> tuple[Array, Array]:
        """M, (6, 6), and b, (6,), of the object's wrench at its origin M a_o + b, world axes."""
        model, data, frame = self.model, self._data, self.chain.frames[0]
        omega = pin.getFrameVelocity(model, data, frame, pin.LOCAL_WORLD_ALIGNED).angular
        R = data.oMf[frame].rotation.copy()
        mass, lever = self._mass, R @ self._lever
        r, I = pin.skew(lever), R @ self._inertia @ R.T  # noqa: E741
        turn = pin.skew(omega)  # whose product with a vector is a tenth of np.cross's time
        M, b = np.zeros((6, 6)), np.zeros(6)
        M[:3, :3] = self._each_way
        M[:3, 3:] = -mass * r
        M[3:, :3] = mass * r
        M[3:, 3:] = I - mass * r @ r
        b[:3] = mass * (turn @ (turn @ lever) - self._falls)
        b[3:] = turn @ (I @ omega) + r @ b[:3]
        return M, b

    def kinetic_energy(self, q: Array, v: Array) -> float:
        """Kinetic energy [J]."""
        return float(pin.computeKineticEnergy(self.model, self._data, q, v))

    def potential_energy(self, q: Array) -> float:
        """Potential energy [J]."""
        return float(pin.computePotentialEnergy(self.model, self._data, q))


#: Reciprocal condition number below which a system counts as singular.
SINGULAR = 1e-12
#: With all pivots above this share of the norm it is far from that; of a singular system the least
#: one is left by rounding. LAPACK's estimate takes twice as long as all the rest.
PIVOT = 1e-6


class Saddle:
    """A saddle-point matrix [top right; left corner], factored by LAPACK in preallocated arrays.

    top is (n, n), corner (m, m); all blocks are zero until written.
    """

    def __init__(self, n: int, m: int) -> None:
        self._K = np.zeros((n + m, n + m), order="F")
        self._flat = self._K.reshape(-1, order="F")
        self.top, self.right, self.left = self._K[:n, :n], self._K[:n, n:], self._K[n:, :n]
        self.corner = self._K[n:, n:]

    def solve(self, rhs: Array) -> tuple[Array, bool]:
        """Solution, and whether the matrix is singular, so that it is one of least squares."""
        if not len(rhs):  # one arm alone has no wrenches to tell; LAPACK minds
            return rhs, False
        lu, pivots, info = lapack.dgetrf(self._K)
        if info == 0 and self._regular(lu):
            return lapack.dgetrs(lu, pivots, rhs)[0], False
        return least_squares(self._K, rhs), True

    def _regular(self, lu: Array) -> bool:
        # The Frobenius norm stands for the 1-norm: a factor, not a magnitude.
        norm = math.sqrt(self._flat.dot(self._flat))
        if np.abs(lu.diagonal()).min() > PIVOT * norm:
            return True
        return bool(lapack.dgecon(lu, norm)[0] > SINGULAR)
