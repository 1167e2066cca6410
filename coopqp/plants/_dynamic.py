"""What plants with masses share: servos, delay, sensors, and their signals.

Joint servos give motor torques within the motors' limits. A velocity command moves the desired
angle, q_d += v dt, and each joint follows it:

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

import math
from abc import abstractmethod
from collections import deque

import numpy as np

from coopqp.base.errors import InvalidValueError
from coopqp.base.rank import least_squares, null_space
from coopqp.base.spec import Array, Positive, seeded, spec
from coopqp.closed_loop.dynamics import ClosedLoopDynamics
from coopqp.closed_loop.hands import Hand, hands, robot_indices
from coopqp.controller import Command, ControlProblem
from coopqp.grasp import BEYOND, NO_CONTACT
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.state import State
from coopqp.plant import Disturbance, PlantModel
from coopqp.plants._true_chain import slipped, true_chain


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
        tau, requested: torques as of the last :meth:`torque`, and before they were limited by
            ``effort``, which is zero for passive joints, shape (n,) [N m].
        stiffness: K, zero for passive joints, shape (n,) [N m/rad]; not used with a frequency.
        follows: whether the last command was a velocity, or there was none.
    """

    def __init__(self, chain: ClosedChain, servo: Servo) -> None:
        self._model = ClosedLoopDynamics(chain, shares=chain.alpha)
        motors = np.zeros(chain.n, bool)
        motors[self._model.actuated] = True
        self.effort = np.where(motors, chain.model.effortLimit, 0.0)
        self.stiffness = full_effort(chain) / servo.saturation_angle
        self._ratio, self._frequency = servo.damping_ratio, servo.frequency
        self._compensate = servo.gravity_compensation
        self._q_d, self.follows = chain.q_start.copy(), True
        self._rest, self._damping, self._v_d, self._forward = np.zeros((4, chain.n))
        self.tau, self.requested = np.zeros((2, chain.n))

    def resume(self, before: ServoLaw) -> None:
        """Keep the desired angles of the servos of the phase before."""
        self._q_d[:], self._v_d[:] = before._q_d, before._v_d
        self._forward[:], self.follows = before._forward, before.follows
        self._request(self._forward)

    def hold(self, q: Array) -> None:
        """Hold these angles, from where velocity commands go on."""
        self._q_d[:] = q

    def begin(self, command: Command, q: Array) -> None:
        self.follows = command.tau is None
        if command.tau is not None:
            self._forward[:] = command.tau
            self._request(self._forward)
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
        self._request(following + self._forward)
        return self.tau

    def _request(self, torque: Array) -> None:
        self.requested[:] = torque
        np.maximum(torque, -self.effort, out=self.tau)
        np.minimum(self.tau, self.effort, out=self.tau)


#: Taken for the stiffness of a joint whose motor has no limit [N m].
UNLIMITED_EFFORT = 100.0


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


#: A hand that presses and has not touched the object for so long has lost it [s].
LOST = 0.02
#: Friction beyond what there is by less than this share is rounding.
ROUNDING = 1e-3


class HandSignals:
    """Signals of the hands, in the robot's order of arms; zero for those that hold nothing.

    Attributes:
        hands: those that hold, in the chain's order. at: their indices in the robot's.
        signals: ``internal_wrench`` (6 N,), the part of the hands' wrenches that cancels, world
            axes [N, N m]; ``hand_wrench`` (6 N,), of each hand on the object at its point, world
            axes; ``hand_point`` (3 N,), where that is [m]; and where any hand presses
            ``normal_force`` (N,) and ``tangential_force`` (N,) [N], ``friction_use`` (N,), required
            over available friction, at most ``MAX_USE``, ``edge_use`` (N,), how far out on the pad
            the pressure is, 1 at its edge, ``slip`` (N,), how far the object has moved along the
            contact [m], and ``held`` (1,), 1 until the object is lost. Both uses are NaN while a
            hand presses on nothing, and ``edge_use`` of a point always is.
        lost: which hand lost it and why; empty while it is held.
    """

    def __init__(self, chain: ClosedChain, friction: float) -> None:
        arms = len(chain.robot.arms)
        sizes = {"internal_wrench": 6, "hand_wrench": 6, "hand_point": 3}
        self.signals = {name: np.zeros(size * arms) for name, size in sizes.items()}
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
        places = zip(self.hands, self.at, strict=True)
        self._pressing = [(k, h, h.contact, i) for k, (h, i) in enumerate(places) if h.contact]

    @property
    def pressing(self) -> bool:
        return bool(self._pressing)

    def write(
        self, wrenches: Array, points: Array, in_contacts: Array, borne: Array | None = None
    ) -> None:
        """Write the signals, of wrenches on the object at points in the world of hands that hold.

        ``wrenches`` are each at its point in world axes, ``in_contacts`` the same wrenches in the
        contacts' frames; ``borne`` is the sum of the friction forces' sizes over all points of each
        contact [N], by its own model of friction if omitted.
        """
        signals = self.signals
        for name in signals.keys() - {"held", "slip"}:
            signals[name][:] = 0.0
        signals["hand_wrench"].reshape(-1, 6)[self.at] = wrenches.reshape(-1, 6)
        signals["hand_point"].reshape(-1, 3)[self.at] = points
        for k, _, contact, i in self._pressing:
            w, use = in_contacts[k], np.nan
            if w[2] > NO_CONTACT:
                needed = contact.friction_needed(w) if borne is None else borne[k] / w[2]
                use = min(needed / (self._friction * contact.friction), MAX_USE)
            signals["normal_force"][i], signals["tangential_force"][i] = w[2], np.hypot(w[0], w[1])
            signals["edge_use"][i], signals["friction_use"][i] = contact.edge_use(w), use

    def split(self, wrenches: Array, alpha: Array) -> None:
        """Write what cancels of wrenches at the object's origin; after :meth:`write`."""
        internal = self.signals["internal_wrench"].reshape(-1, 6)
        internal[self.at] = wrenches - np.outer(alpha[: len(wrenches)], wrenches.sum(axis=0))

    def touch(self, dt: float) -> None:
        """Count how long hands have not pressed, by dt [s]; the object is lost after some time."""
        for _, hand, _, i in self._pressing:
            touches = self.signals["normal_force"][i] > 0.0
            self._apart[i] = 0.0 if touches else self._apart[i] + dt
            if self._apart[i] > LOST:
                self.lose(f"{hand.arm} no longer touches it")

    def bear(self) -> None:
        """Declare the object lost where friction cannot bear the hands' wrenches."""
        for _, hand, _, i in self._pressing:
            if np.isnan(self.signals["friction_use"][i]):
                self.lose(f"{hand.arm} would have to pull it")
            elif self.signals["edge_use"][i] > 1.0 + BEYOND:
                self.lose(f"{hand.arm} tips over its pad's edge")
            elif self.signals["friction_use"][i] > 1.0 + ROUNDING:
                self.lose(f"{hand.arm} needs more friction than there is")

    def lose(self, why: str) -> None:
        self.lost = self.lost or why
        self.signals["held"][0] = 0.0


#: Largest reported use of friction.
MAX_USE = 10.0


class DynamicModel(PlantModel):
    """A plant with masses, driven by velocities through servos or by torques.

    InvalidValueError: the time step [s] does not divide the control period; a robot without mass.

    Attributes:
        true: the state of the true chain, before noise; its time goes on from phase to phase.
        hand_signals: of the hands, which subclasses write and add to ``signals``.
        signals: ``tau`` (n,) [N m] at the end of the period; ``saturated`` (n,), share of the
            period's steps that a motor was at its limit; ``energy`` (2,), kinetic and potential
            [J]; ``push`` (6,), on the object at the end of the period [N, N m].
    """

    def __init__(
        self,
        problem: ControlProblem,
        servo: ServoLaw,
        time_step: float,
        seed: int,
        disturbance: Disturbance,
    ) -> None:
        super().__init__()
        n = problem.chain.n
        if not any(body.mass for body in problem.chain.robot.model.inertias):
            raise InvalidValueError(
                f"robot {problem.chain.robot.name} has no masses; use plant: kinematic"
            )
        self.disturbance, self.servo, self._seed = disturbance, servo, seed
        self._dt, self._slipped = problem.dt, 0.0
        firm = true_chain(problem.chain, seed, disturbance)
        self.true, self._truth = State(firm), State(firm)
        self.hand_signals = HandSignals(firm, disturbance.friction)
        dt, self._steps = problem.dt, round(problem.dt / time_step)
        if self._steps < 1 or abs(self._steps * time_step - dt) > 1e-9 * dt:
            raise InvalidValueError(
                f"time_step: found {time_step:g} s, stated or by default, needs a whole part of dt "
                f"= {dt:g} s; state one, such as time_step: {dt / math.ceil(dt / time_step):g}"
            ).at("time_step")
        self.h = dt / self._steps
        self._rng = seeded(seed)
        self._late: deque[Command] = deque(Command(n) for _ in range(disturbance.delay))
        self._at_limit = np.zeros(n)
        self.signals = {"tau": servo.tau, "saturated": np.zeros(n), "energy": np.zeros(2)}
        self.signals["push"] = np.zeros(6)
        self.measured = self._noisy(self.true.q, disturbance.noise_position)
        self.servo.hold(self.measured)

    def step(self, state: State, command: Command) -> None:
        self._slip()
        carried_out = command
        if self._late:
            self._late.append(command.copy())
            carried_out = self._late.popleft()
        self.servo.begin(carried_out, self.true.q)
        self._at_limit[:] = 0.0
        for _ in range(self._steps):
            self.integrate()
            self.servo.advance(self.h)
            requested = np.abs(self.servo.requested)
            self._at_limit += (requested >= self.servo.effort) & (requested > 0.0)
        np.divide(self._at_limit, self._steps, self.signals["saturated"])
        self.signals["energy"][:] = self.energy()
        push = self.disturbance.wrench(self.true.t)
        self.signals["push"][:] = 0.0 if push is None else push
        self._measure(state, command)

    def truth(self, state: State) -> State:
        truth = self._truth
        truth.t, truth.q[:], truth.v[:] = state.t, self.true.q, self.true.v
        truth.update()
        return truth

    def resume(self, before: PlantModel) -> None:
        """Take over time, motion, servos, commands on their way and the stream of noise.

        With velocity commands, the servos hold the last measured angles, from where the controller
        goes on, and delayed commands are dropped; with torques nothing stops.
        """
        assert isinstance(before, DynamicModel)
        old, released = before.true, self.true.chain.hold.released
        self._slipped = before._slipped
        self._late, self._rng, self.measured = before._late, before._rng, before.measured
        self.servo.resume(before.servo)
        if self.servo.follows:
            assert self.measured is not None
            self.servo.hold(self.measured)
            self._late = deque(Command(len(old.q)) for _ in self._late)
        self._occupy(old.chain.handed_over(old.q, released), old)
        self.hand_signals = before.hand_signals
        self.hand_signals.follow(self.true.chain)
        self.signals |= self.hand_signals.signals
        self.attach(before)

    def _slip(self) -> None:
        distance = self.disturbance.slipped(self.true.t)
        if distance != self._slipped:
            step, self._slipped = distance - self._slipped, distance
            self._occupy(slipped(self.true.chain, self._seed, step), self.true)
            self.grip()

    def _occupy(self, chain: ClosedChain, old: State) -> None:
        self.true, self._truth = State(chain, old.q, old.t), State(chain)
        self.true.v[:] = old.v

    @abstractmethod
    def attach(self, before: PlantModel) -> None:
        """Make ``true``, taken over from before, agree with the loops that have closed."""

    @abstractmethod
    def grip(self) -> None:
        """Follow a new ``true.chain``, in which an arm holds the object a little otherwise."""

    @abstractmethod
    def integrate(self) -> None:
        """Advance ``true`` by h: its t, q and v."""

    @abstractmethod
    def energy(self) -> tuple[float, float]:
        """Kinetic and potential energy [J]."""

    def _measure(self, state: State, command: Command) -> None:
        true, disturbance = self.true, self.disturbance
        self.measured = self._noisy(true.q, disturbance.noise_position)
        state.hand_wrench = self.hand_wrench
        if command.tau is None:
            state.advance(command.v, self._dt)
            state.q_measured = self.measured.copy()
        else:
            state.q[:], state.q_measured = self.measured, None
            state.v[:] = self._noisy(true.v, disturbance.noise_velocity)
            state.t += self._dt  # as the loop counts, whatever the sum of the plant's steps is

    def _noisy(self, values: Array, deviation: float) -> Array:
        if not deviation:
            return values.copy()
        return values + self._rng.normal(0.0, deviation, len(values))
