"""What speeds, accelerations, motors and contacts allow along a path, as rows on (u, x, lambda).

With q' and q'' by s, x = sdot^2 and u = sddot,

    qd  = q' sqrt(x),   qdd = q' u + q'' x
    tau = a u + b x + c - J_c' lambda
    a = A q',   b = A q'' + H(q, q') - H(q, 0),   c = H(q, 0)

The object's mass is on all hands alike, so lambda is Walker's internal wrench: with w the wrench
that moves the object, h_0 = w/N + sum lambda_i, h_i = w/N - lambda_i at the object's origin. w is
linear in u and x as tau is, and so are the cones of hands that press. Joints' friction is left out.

    lo <= Ru u + Rx x + Rl lambda <= up,   x <= x_max

The bounds of lambda are rows, too.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from coopqp.base.errors import InvalidValueError
from coopqp.base.spec import Array
from coopqp.closed_loop.dynamics import ClosedLoopDynamics
from coopqp.closed_loop.hands import hands
from coopqp.controller import ControlProblem
from coopqp.limit import Bounded, JointBounds, TwistBounds
from coopqp.model.closed_chain import ClosedChain
from coopqp.planning.closed_path import Along, ClosedPath, Loops, relative, times
from coopqp.scenario.scenario import Scenario

#: What components of the object's speed and of wrenches are called.
AXES = ("x", "y", "z", "about x", "about y", "about z")
#: Above so much of the median x is bounded where nothing else does it: where joints stand still.
FASTEST = 1e4


@dataclass(frozen=True)
class Bounds:
    """The limits of a motion; infinite where there is none."""

    speed: Array  # of joints, shape (n,) [rad/s, m/s]
    acceleration: Array  # of joints, shape (n,) [rad/s2, m/s2]
    torque: Array  # of motors, shape (n,), 0 at passive joints [N m, N]
    twist: Array  # of the object's components in world axes, shape (6,) [m/s, rad/s]
    wrench: Array  # largest component of the internal wrench of each hand, shape (6,) [N, N m]
    safety: float = 1.0  # by which friction is divided
    forces: bool = True  # False where speeds and accelerations alone are looked at
    load: float = 1.0  # share of the object's mass


def motion_limits(of: Scenario | ControlProblem) -> tuple[Array, Array, Array]:
    """What limits allow: joints' speeds and accelerations, (n,), the object's speeds, (6,)."""
    speed, acceleration = of.chain.velocity.copy(), np.full(of.chain.n, np.inf)
    twist = np.full(6, np.inf)
    for limit in of.limits:
        program = limit.program(of.chain, of.dt)
        if isinstance(program, JointBounds) and program.of == Bounded.VELOCITY:
            speed = np.minimum(speed, np.minimum(-program.lower, program.upper))
        elif isinstance(program, JointBounds) and program.step is not None:
            acceleration = np.minimum(acceleration, program.step / of.dt)
        elif isinstance(program, TwistBounds):
            at = list(program.components)
            twist[at] = np.minimum(twist[at], program.bounds)
    return speed, acceleration, twist


def motion_bounds(limits: tuple[Array, Array, Array], share: float) -> Bounds:
    """A share of :func:`motion_limits`, whatever forces it takes."""
    speed, push, twist = (share * limit for limit in limits)
    return Bounds(speed, push, np.full(len(speed), np.inf), twist, np.zeros(6), forces=False)


def bounds_of(
    problem: ControlProblem, torque: float, wrench: tuple[float, float], safety: float
) -> Bounds:
    """The bounds of a robot and of limits, of which motors use a share."""
    chain = problem.chain
    speed, acceleration, twist = motion_limits(problem)
    effort = torque * np.array(chain.model.effortLimit)
    effort[chain.passive] = 0.0
    return Bounds(speed, acceleration, effort, twist, np.repeat(np.array(wrench, float), 3), safety)


@dataclass(frozen=True)
class Rows:
    """The rows at N places."""

    maker: RowMaker  # of what is the same at all of them
    s: Array  # the places, shape (N,)
    along: Along  # the path there
    R: Array  # by u, by x and at rest, shape (3, N, r)
    Rl: Array  # by lambda, shape (N, r, m)
    rates: Array  # of joints and of the object by s, (N, n + 6), which speeds bound

    def values(self, u: Array, x: Array) -> Array:
        """The rows' left sides without lambda, shape (N, r), for u and x of shape (N,)."""
        return np.asarray(self.R[0] * u[:, None] + self.R[1] * x[:, None] + self.R[2])

    @property
    def x_max(self) -> Array:
        """Largest x that the speeds allow, shape (N,); finite where a joint stands still, too."""
        with np.errstate(divide="ignore", invalid="ignore"):
            most = np.square(self.maker.speeds / np.abs(self.rates)).min(axis=1)
        finite = most[np.isfinite(most)]
        usual = float(np.median(finite)) if len(finite) else 1.0
        return np.asarray(np.fmin(most, FASTEST * usual), float)

    def lo_up(self, share: Array) -> tuple[Array, Array]:
        """Lower and upper ends, shape (N, r), with the bounds times a share."""
        made = self.maker
        size = made.size - (1.0 - share) * made.unit
        return np.where(made.two_sided, -size, -np.inf) - self.R[2], size - self.R[2]


class RowMaker:
    """Makes the rows of one path at any places.

    Attributes:
        names: such as "torque of elbow".
        kinds: "acceleration", "torque", "wrench" or "contact", by row.
        size: of what bounds a row, shape (r,): it is in +- size, at contacts below it.
        unit: what a row's use is counted in, shape (r,): its size, at contacts the weight [N].
        speeds: largest rates of joints and of the object, shape (n + 6,).
        kept: rows of the loops whose wrench is free; none where its box is of no size.

    Raises:
        InvalidValueError: nothing bounds the speed of a motor.
    """

    def __init__(self, path: ClosedPath, bounds: Bounds) -> None:
        chain = path.chain
        self.path, self.bounds, self.chain = path, bounds, chain
        holders = [arm.name for arm in chain.arms[: chain.holding]]
        self.arms = len(holders)
        shares = (np.arange(len(chain.arms)) < self.arms) / self.arms
        self.dynamics = ClosedLoopDynamics(chain, shares=shares, mass_scale=bounds.load)
        self.kept = np.array(chain.loops.kept, int)
        if not bounds.wrench.any():
            self.kept = self.kept[:0]
        self.loops = Loops(chain, self.dynamics.model)
        self._limited = np.flatnonzero(np.isfinite(bounds.torque))
        self._quick = np.flatnonzero(np.isfinite(bounds.acceleration))
        names = chain.joint_names
        self._cones = _Cones(chain, bounds)
        self.names = (
            *(f"acceleration of {names[j]}" for j in self._quick),
            *(f"torque of {names[j]}" for j in self._limited),
            *(f"internal wrench of {holders[1 + k // 6]} ({AXES[k % 6]})" for k in self.kept),
            *self._cones.names,
        )
        counts = (len(self._quick), len(self._limited), len(self.kept), len(self._cones.names))
        self.kinds = np.repeat(["acceleration", "torque", "wrench", "contact"], counts)
        self.size = np.concatenate([
            bounds.acceleration[self._quick], bounds.torque[self._limited],
            bounds.wrench[self.kept % 6], self._cones.upper,
        ])  # fmt: skip
        body = chain.held.body()
        mass, inertia = bounds.load * body.mass, bounds.load * body.inertia
        self._body = pin.Inertia(mass, body.lever, inertia)
        self.two_sided = self.kinds != "contact"
        weight = self._body.mass * float(np.linalg.norm(chain.model.gravity.linear))
        self.unit = np.where(self.kinds == "contact", max(weight, 1.0), self.size)
        self.speeds = np.concatenate([bounds.speed, bounds.twist])
        if not (np.isfinite(self.speeds).any() or counts[0] or counts[1] > len(chain.passive)):
            raise InvalidValueError(
                "nothing limits the motion: the robot has no limits of speed or torque; give it "
                "some, or limits: joint_acceleration"
            )

    def at(self, s: Array) -> Rows:
        """The rows at places of shape (N,)."""
        along = self.path.at(s, self.loops)
        J = relative(along.moved.J)[:, self.kept]
        N, m, at, quick = len(s), J.shape[1], self._limited, self._quick
        nothing, free = np.zeros_like(along.q), np.zeros((N, m))
        cones, cones_by_wrench = self._cones.at(self.loads, along, self.kept)
        twist = times(along.moved.J[:, 0], along.dq)
        parts = zip((along.dq, along.ddq, nothing), self.torques(along), cones, strict=True)
        R = [np.hstack([rate[:, quick], tau[:, at], free, cone]) for rate, tau, cone in parts]
        by_wrench = [
            np.zeros((N, len(quick), m)), -J.transpose(0, 2, 1)[:, at],
            np.tile(np.eye(m), (N, 1, 1)), cones_by_wrench,
        ]  # fmt: skip
        Rl, rates = np.concatenate(by_wrench, axis=1), np.hstack([along.dq, twist])
        return Rows(self, s, along, np.array(R), Rl, rates)

    def torques(self, along: Along) -> Array:
        """a, b and c of the tree's torques, shape (3, N, n)."""
        found = np.zeros((3, *along.q.shape))
        if not self.bounds.forces:
            return found
        model, data, nothing = self.dynamics.model, self.loops.data, np.zeros(along.q.shape[1])
        for k, (q, dq, ddq) in enumerate(zip(along.q, along.dq, along.ddq, strict=True)):
            found[2, k] = pin.rnea(model, data, q, nothing, nothing)
            found[0, k] = pin.rnea(model, data, q, nothing, dq)
            found[1, k] = pin.rnea(model, data, q, dq, ddq)
        found[:2] -= found[2]
        return found

    def loads(self, along: Along) -> Array:
        """What moves the object for u, for x and at rest, at its origin, shape (3, N, 6)."""
        found, still = np.empty((3, len(along.q), 6)), pin.Motion.Zero()
        for k, (R, J) in enumerate(zip(along.moved.R[:, 0], along.moved.J[:, 0], strict=True)):
            body = pin.SE3(R, np.zeros(3)).act(self._body)
            spin, turning = still.copy(), J @ along.ddq[k] + along.drift[k, 0]
            spin.angular = J[3:] @ along.dq[k]
            found[0, k] = (body * pin.Motion(J @ along.dq[k])).vector
            found[1, k] = (body * pin.Motion(turning) + spin.cross(body * spin)).vector
            found[2, k] = (body * -self.dynamics.model.gravity).vector
        return found


class _Cones:
    """What hands that press keep, as rows on (u, x, lambda)."""

    def __init__(self, chain: ClosedChain, bounds: Bounds) -> None:
        self._each: list[tuple[int, Array]] = []
        names: list[str] = []
        upper: list[Array] = [np.zeros(0)]
        self._hands = hands(chain)
        for i, hand in enumerate(self._hands):
            if not (hand.contact and bounds.forces):
                continue
            found = hand.contact.force_rows(bounds.safety)
            R, p = hand.X_OC.rotation, hand.X_OC.translation
            turn = np.zeros((6, 6))  # from the wrench at the origin, O's axes, to the contact's
            turn[:3, :3], turn[3:, 3:], turn[3:, :3] = R.T, R.T, -R.T @ pin.skew(p)
            self._each.append((i, found.rows @ turn))
            names += [f"{label.partition('[')[0]} of {hand.arm}" for label in found.labels]
            upper.append(found.upper)
        self.names, self.upper = tuple(names), np.concatenate(upper)

    def at(self, loads: Callable[[Along], Array], along: Along, kept: Array) -> tuple[Array, Array]:
        """R, shape (3, N, r), and Rl, shape (N, r, m)."""
        N, m, count = len(along.q), len(kept), len(self._hands)
        if not self._each:
            return np.zeros((3, N, 0)), np.zeros((N, 0, m))
        w, R_OW = loads(along), along.moved.R[:, 0].transpose(0, 2, 1)
        R, Rl = [], []
        for i, rows in self._each:
            turned = np.concatenate([rows[:, :3] @ R_OW, rows[:, 3:] @ R_OW], axis=2)
            R.append(times(turned, w) / count)
            signs = 1.0 * (i == 0) - (np.arange(1, count) == i)  # of each lambda in h_i
            Rl.append(turned @ np.kron(signs, np.eye(6))[:, kept])
        return np.concatenate(R, axis=2), np.concatenate(Rl, axis=1)
