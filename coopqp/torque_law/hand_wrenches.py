"""Hand wrenches as variables of a QP: dynamics, friction cones and cost.

h (6 N,) are the wrenches of the hands that hold the object, each at its point, in world axes. With
J_i the object's Jacobian by arm i, G_i from hand i to the object's origin, and the object's mass on
arm 0 of the tree,

    A a + H = S' tau - sum_i (J_i - J_0)' G_i h_i        dynamics of the tree
    G h = M (J_0 a + drift_0) + b                         dynamics of the object
    C_i R_i h_i <= sigma,  f_z >= least - sigma           hands that press; sigma = 0

Internal wrenches cost |(1 - X G) h - t|^2, torques divided by a hand's size, with X of the named
split and t the smallest internal wrench that tasks ask for. The part that moves the object has no
further cost, so that a mass is not carried lower to save force.

The wrench w of the surroundings on the object is measured, or observed from joint torques.
:class:`MomentumObserver` needs joints and torques alone. The generalised momentum p = A v of the
tree changes by motors, gravity, loops and surroundings (De Luca and Mattone 2005):

    p_dot = S' tau + C' v - g + J_c' lambda + J_o' w
    r = K (p - p_0 - integral of (S' tau + C' v - g + r) dt)

so r follows J_c' lambda + J_o' w with the time constant 1/K. With N a basis of the null space of
J_c the loops drop out, N' r = N' J_o' w, solved for w in least squares; what the structure bears
is zero in w. As N moves, a change of J_c' lambda within 1/K would show as a push, so the modelled
lambda of tau and the last w is subtracted before the integration. The estimate is as good as the
model: an object that is lighter than modelled by a fifth of 10 N shows as 2 N.

:class:`HandSensors` uses force sensors in the hands, which measure h: w = M a_o + b - G h, with a_o
from the difference of the object's velocity over a tick, after a first-order low-pass filter. Only
the object's mass has to be known, not the arms'.
"""

import math
from collections.abc import Iterator, Mapping
from typing import Literal

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from coopqp.base.errors import GraspError, InvalidValueError, require_known
from coopqp.base.qp import Row
from coopqp.base.rank import least_squares
from coopqp.base.spec import Array
from coopqp.closed_loop.dynamics import ClosedLoopDynamics
from coopqp.closed_loop.forces import StaticHold, cannot_carry
from coopqp.closed_loop.grasp_matrix import UNITS, Split, grasp_matrix, virtual_inertia, walker
from coopqp.closed_loop.hands import WrenchReadings, WrenchStack, hands, into_contacts, points
from coopqp.closed_loop.screw import LENGTH
from coopqp.controller import ControlProblem
from coopqp.model.closed_chain import AXES, ClosedChain
from coopqp.model.state import State

SplitName = Literal["virtual_inertia", "walker", "minimum_norm"]
Shares = Mapping[str, float] | Literal["weights", "motors"]

#: Radius of gyration of a virtual hand. With a small one hands of hinges trade torques that weigh
#: much for forces that grow, and torques held for a tick err more; cones need no small one here.
HAND_RADIUS = LENGTH  # [m]
#: An arm whose motors have nothing left still gets this share of what the strongest gets.
MIN_RESERVE = 1e-3
#: Sums of shares are one within this.
SHARE_SUM = 1e-6


class HandWrenches:
    """The wrenches of one problem's hands; InvalidValueError for shares that are none.

    Args:
        safety: by which friction is divided.
        split: which one defines what is internal; minimum_norm is the pseudoinverse.
        shares: of the object's weight by arm; "weights" as in the object's pose, "motors" in
            proportion to what each arm's motors have left.
        inertia: of a virtual body over its mass, for virtual_inertia [m2].

    Attributes:
        variables, cone_rows: rows of h and of the cones.
        pressing: whether any hand holds by contact.
        points: of the hands, shape (N, 3) [m]. turned: R_CW where any presses, shape (N, 3, 3).
        G: grasp matrix, shape (6, 6 N).
        to_tau: sum_i (J_i - J_0)' G_i as a matrix on h, shape (n, 6 N).
        cones: shape (c, 6 N), and stated: cones @ h <= stated, shape (c,).
        upper: the right side in this tick, shape (c,); see :mod:`coopqp.torque_law.program`.
        in_cone: 1 for rows of cones, 0 for bounds of the normal force, shape (c,).
        split: of this instant.
    """

    def __init__(
        self,
        chain: ClosedChain,
        *,
        safety: float,
        split: SplitName,
        shares: Shares,
        inertia: float = HAND_RADIUS**2,
    ) -> None:
        self._chain, self._split, self._inertia = chain, split, inertia
        self.hands = hands(chain)
        N = len(self.hands)
        self.size = 6 * N
        self.variables = tuple(
            Row(name=f"hand[{hand.arm}].{axis}", kind="hand", owner=hand.arm, unit=unit)
            for hand in self.hands
            for axis, unit in zip(AXES, UNITS, strict=True)
        )
        self._by_motors, self.shares = shares == "motors", _shares(chain, shares)
        self._prepare_cones(safety)
        self.points, self.G = np.zeros((N, 3)), np.zeros((6, 6 * N))
        self.turned = np.zeros((N, 3, 3))
        self.to_tau = np.zeros((chain.n, 6 * N))
        self._metric = np.tile(np.repeat([1.0, 1.0 / HAND_RADIUS], 3), N)
        # Loops between hands that press are closed by the contact, not by the model.
        pressed = [bool(self.hands[0].contact or hand.contact) for hand in self.hands[1:]]
        idle = [False] * (len(chain.arms) - N)
        self._loop_pulls = 1.0 - np.repeat([*pressed, *idle], 6)

    def _prepare_cones(self, safety: float) -> None:
        contacts = [(i, hand.arm, hand.contact) for i, hand in enumerate(self.hands)]
        pressing = [(i, arm, c.force_rows(safety)) for i, arm, c in contacts if c]
        self._local = [(i, rows.rows) for i, _, rows in pressing]
        self.pressing = bool(pressing)
        names = [(arm, label) for _, arm, rows in pressing for label in rows.labels]
        self.cone_rows = tuple(
            Row(name=f"contact[{arm}].{label}", kind="hand", owner=arm, unit="N")
            for arm, label in names
        )
        self.stated = np.concatenate([*(rows.upper for *_, rows in pressing), np.zeros(0)])
        self.upper = self.stated.copy()
        self.in_cone = np.array([label not in ("least", "most") for _, label in names], float)
        self.cones = np.zeros((len(self.upper), self.size))

    def update(self, state: State, dynamics: ClosedLoopDynamics) -> None:
        self.points[:] = points(self.hands, state.p_WO, state.R_WO)
        self.G[:] = grasp_matrix(self.points, state.p_WO)
        J = dynamics.J_arms
        for i in range(1, len(self.hands)):
            part = slice(6 * i, 6 * i + 6)
            self.to_tau[:, part] = (J[part] - J[:6]).T @ self.G[:, part]
        if self.pressing:
            self.turned[:], at = into_contacts(self.hands, state.R_WO), 0
            for i, rows in self._local:
                to = slice(at, at + len(rows))
                self.cones[to, 6 * i : 6 * i + 3] = rows[:, :3] @ self.turned[i]
                self.cones[to, 6 * i + 3 : 6 * i + 6] = rows[:, 3:] @ self.turned[i]
                at += len(rows)
        if self._by_motors and self.hands:
            self.shares[:] = self._reserves(state, dynamics)
        self.split = self._make_split(state)

    def _make_split(self, state: State) -> Split:
        if not self.hands:
            return Split(self.G, np.zeros((0, 6)))
        if self._split == "walker":
            return walker(self.points, state.p_WO, self.shares / self.shares.sum())
        masses = np.maximum(self.shares, MIN_RESERVE)
        inertias = self._inertia * masses
        if self._split == "minimum_norm":
            masses = inertias = np.ones(len(masses))
        return virtual_inertia(self.points, state.p_WO, masses, inertias)

    def loop_correction(
        self, state: State, dynamics: ClosedLoopDynamics, problem: ControlProblem
    ) -> Array:
        """-J_c a that closes open loops, shape (m,); pressing hands are held together by force."""
        kappa = loop_gain(problem)
        pulls = self._loop_pulls[dynamics.kept]
        back = 2.0 * kappa * dynamics.J.dot(state.v) + kappa**2 * pulls * state.e_loop
        return np.asarray(back, float)

    def cost(self, wrenches: WrenchStack) -> tuple[Array, Array]:
        """The cost of internal wrenches that no task asks for, as P and q of 1/2 h'P h + q'h."""
        B = self._metric[:, None] * self.split.projector
        P = B.T @ B
        if not len(wrenches.wanted):
            return P, np.zeros(self.size)
        # The least internal wrench that does what is asked.
        internal = self.split.projector / self._metric
        smallest = internal @ least_squares(wrenches.J @ internal, wrenches.wanted)
        return P, -B.T @ (self._metric * smallest)

    def _reserves(self, state: State, dynamics: ClosedLoopDynamics) -> Array:
        """Shares in proportion to how much of the object's weight each arm alone could carry."""
        chain, model = self._chain, self._chain.model
        own = np.asarray(pin.computeGeneralizedGravity(model, model.createData(), state.q), float)
        _, weight = dynamics.object_inertia()
        left = model.effortLimit - np.abs(own)
        left[chain.passive] = np.inf
        found, h = np.zeros(len(self.hands)), np.append(weight[:3], np.zeros(3))
        for i in range(len(self.hands)):
            part = slice(6 * i, 6 * i + 6)
            torque = np.abs(dynamics.J_arms[part].T @ (self.G[:, part] @ h))
            torque[chain.passive] = 0.0
            found[i] = np.min(np.maximum(left, 0.0) / np.maximum(torque, 1e-9))
        found = np.maximum(found, MIN_RESERVE * max(float(found.max()), 1e-9))
        return np.asarray(found / found.sum(), float)


#: Gain by which torques close loops where none is given [1/s].
LOOP_GAIN = 10.0


def loop_gain(problem: ControlProblem) -> float:
    """The gain kappa of laws by torques, where velocities' default 1/dt is none [1/s].

    A robot's hands and its object close the loops; a law that asks for kappa^2 e on top, with e
    what sensors, models and grips are off, tears at the object with the arms' mass times that.
    """
    by_default = problem.kappa * problem.dt >= 1.0 - 1e-9
    return min(LOOP_GAIN, problem.kappa) if by_default else problem.kappa


def _shares(chain: ClosedChain, shares: Shares) -> Array:
    """By hand that holds, with sum 1, shape (N,)."""
    held = chain.hold.holders
    if isinstance(shares, str):
        alpha = chain.alpha[: len(held)]
        return np.asarray(alpha / alpha.sum(), float)
    every = [arm.name for arm in chain.arms]
    require_known("arm", shares, every, "shares: ")
    values = np.array([shares.get(name, 0.0) for name in held])
    if len(held) == len(every) and abs(values.sum() - 1.0) > SHARE_SUM:
        raise InvalidValueError(f"shares: found {dict(shares)}, needs shares that sum to 1")
    if held and not values.sum() > 0.0:
        raise InvalidValueError(f"shares: none of the arms that hold has one ({', '.join(held)})")
    return np.asarray(values / values.sum(), float)


#: Wanted forces may be unreachable by rounding [N, N m].
ROUNDING = 1e-6


def require_forces(problem: ControlProblem, safety: float, name: str) -> None:
    """Refuse grasps that do not hold with friction over ``safety``, and unreachable wrenches."""
    pressing = any(grasp.contact for grasp in problem.chain.grasps.values())
    if problem.chain.holding < 2 or not (pressing or problem.wrenches):
        return
    start = State(problem.chain)
    hold, stack = StaticHold(problem.chain, safety=safety), WrenchStack(problem.wrenches, start)
    if pressing and (load := hold.load()).value < 1.0:
        raise GraspError(
            f"{name}: cannot hold the object at rest with safety {safety:g}: "
            f"{cannot_carry(problem.chain, hold, load)}"
        )
    stack.update(start)
    for fault in unreachable_wrenches(hold, stack):
        raise InvalidValueError(f"{name}: {fault}")
    hard = np.flatnonzero(stack.hard)
    if not len(hard) or _can(hold, stack, hard):
        return
    culprits = [stack.rows[i].name for i in hard if _can(hold, stack, hard[hard != i])]
    which = ", ".join(culprits) or "several of them"
    raise GraspError(
        f"{name}: the grasp cannot bear all hard wrenches together; without one of {which} it "
        "could. Leave that component free, or make it soft"
    )


def unreachable_wrenches(hold: StaticHold, stack: WrenchStack) -> Iterator[str]:
    """Wanted wrenches of ``stack``, up to date, beyond what ``hold`` gives, a sentence each."""
    for row, C, wanted in zip(stack.rows, stack.J, stack.wanted, strict=True):
        lower, upper = (hold.extreme(C, sign) for sign in (-1.0, 1.0))
        if lower is None or upper is None:
            return  # the object cannot be carried; reported elsewhere where hands press
        if lower.value - ROUNDING <= wanted <= upper.value + ROUNDING:
            continue
        near = lower if wanted < lower.value else upper
        yield (
            f"{row.name} wants {wanted:.3g} {row.unit}, but at rest at the start the hands "
            f"can do {lower.value:.3g} to {upper.value:.3g} {row.unit}; {near.holds} back"
        )


def _can(hold: StaticHold, stack: WrenchStack, rows: NDArray[np.intp]) -> bool:
    """Whether these rows can have their values at once."""
    nothing = np.zeros(stack.J.shape[1])
    return hold.extreme(nothing, 1.0, (stack.J[rows], stack.wanted[rows])) is not None


class MomentumObserver:
    """Estimates the external wrench on one chain from torques; its state is in the law's memory.

    ``dynamics``, with the modelled object, must be up to date at each update. InvalidValueError for
    a gain K [1/s] above 1/dt, where it would overshoot.

    Attributes:
        wrench: force and torque on the object at its origin, world axes, as of the last update,
            shape (6,) [N, N m].
        memory_sizes: what to remember; whoever commands torques writes "observer.tau".
        fault: why a measurement cannot be used: none is needed.
    """

    def __init__(
        self, dynamics: ClosedLoopDynamics, *, gain: float = 50.0, dt: float = 0.001
    ) -> None:
        if not 0.0 < gain * dt <= 1.0:
            raise InvalidValueError(
                f"gain: found {gain:g} 1/s, needs more than 0 and at most 1/dt = {1.0 / dt:g} 1/s"
            )
        self._dynamics, self._gain, self._dt = dynamics, gain, dt
        self._model, self._data = dynamics.model, dynamics.model.createData()
        n = dynamics.chain.n
        self.wrench, self.fault = np.zeros(6), ""
        self.memory_sizes = {
            "observer.begun": 1, "observer.integral": n, "observer.known": n,
            "observer.residual": n, "observer.tau": n, "observer.wrench": 6,
        }  # fmt: skip

    def update(self, state: State) -> Array:
        """The wrench at the end of a period with joint torques "observer.tau"; zero at first."""
        dt, dynamics, memory = self._dt, self._dynamics, state.memory
        C = pin.computeCoriolisMatrix(self._model, self._data, state.q, state.v)
        g = pin.computeGeneralizedGravity(self._model, self._data, state.q)
        now, momentum = C.T @ state.v - g, dynamics.A.dot(state.v)
        integral, known = memory["observer.integral"], memory["observer.known"]
        r = memory["observer.residual"]
        if memory["observer.begun"][0]:
            tau, push = memory["observer.tau"], dynamics.J_object.T.dot(memory["observer.wrench"])
            of_loops = dynamics.direct(tau + push).wrench[dynamics.kept].dot(dynamics.J)
            integral += dt * (tau + of_loops + 0.5 * (known + now) + r)
        else:
            integral[:], memory["observer.begun"][0] = momentum, 1.0
        known[:] = now
        r[:] = self._gain * (momentum - integral)
        N = dynamics.null_space()
        self.wrench[:] = least_squares(N.T @ dynamics.J_object.T, N.T @ r)
        memory["observer.wrench"][:] = self.wrench
        return self.wrench


class HandSensors:
    """Measures the external wrench on one chain by the hands; its state is in the law's memory.

    ``dynamics``, with the modelled object, must be up to date at each update. ``gain`` is the
    inverse of the filter's time constant [1/s]. ``wrench`` is as of :class:`MomentumObserver`.
    """

    def __init__(self, dynamics: ClosedLoopDynamics, *, gain: float, dt: float) -> None:
        chain = dynamics.chain
        self._dynamics, self._dt, self._share = dynamics, dt, 1.0 - math.exp(-gain * dt)
        self._hands, self._readings = hands(chain), WrenchReadings(chain)
        self.wrench = np.zeros(6)
        self.memory_sizes = {"sensors.begun": 1, "sensors.twist": 6, "sensors.wrench": 6}

    @property
    def fault(self) -> str:
        """Why the last measurement cannot be used; empty if it can."""
        return self._readings.fault

    def update(self, state: State) -> Array:
        """The wrench at the end of a period; zero at first, the last where nothing is measured."""
        dynamics, twist = self._dynamics, self._dynamics.J_object.dot(state.v)
        memory, kept = state.memory, state.memory["sensors.wrench"]
        found = self._readings.read(state.hand_wrench)
        if memory["sensors.begun"][0] and found is not None:
            M, b = dynamics.object_inertia()
            G = grasp_matrix(points(self._hands, state.p_WO, state.R_WO), state.p_WO)
            a = (twist - memory["sensors.twist"]) / self._dt
            kept += self._share * (M.dot(a) + b - G.dot(found.ravel()) - kept)
        memory["sensors.begun"][0], memory["sensors.twist"][:] = 1.0, twist
        self.wrench[:] = kept
        return self.wrench
