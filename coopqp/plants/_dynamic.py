"""What plants with masses share: servos, delay, sensors, and their signals."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections import deque

import numpy as np

from coopqp.base.errors import InvalidValueError
from coopqp.base.spec import Array, seeded
from coopqp.closed_loop.hands import Hand, hands, robot_indices
from coopqp.controller import Command, ControlProblem
from coopqp.grasp import BEYOND, NO_CONTACT
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.state import State
from coopqp.plant import Disturbance, PlantModel
from coopqp.plants._servo import ServoLaw
from coopqp.plants._true_chain import slipped, true_chain

#: A hand that presses and has not touched the object for so long has lost it [s].
LOST = 0.02
#: Friction beyond what there is by less than this share is rounding.
ROUNDING = 1e-3


class HandSignals:
    """Signals of the hands, in the robot's order of arms; zero for those that hold nothing.

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
        places = zip(self.hands, self.at, strict=True)
        self._pressing = [(k, h, h.contact, i) for k, (h, i) in enumerate(places) if h.contact]

    @property
    def pressing(self) -> bool:
        return bool(self._pressing)

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
        told = self.signals
        for name in told.keys() - {"held", "slip"}:
            told[name][:] = 0.0
        told["hand_wrench"].reshape(-1, 6)[self.at] = wrenches.reshape(-1, 6)
        told["hand_point"].reshape(-1, 3)[self.at] = points
        for k, _, contact, i in self._pressing:
            w = in_contacts[k]
            told["normal_force"][i], told["tangential_force"][i] = w[2], np.hypot(w[0], w[1])
            told["edge_use"][i], told["friction_use"][i] = contact.edge_use(w), np.nan
            if w[2] > NO_CONTACT:
                needed = contact.friction_needed(w) if borne is None else borne[k] / w[2]
                told["friction_use"][i] = min(needed / (self._friction * contact.friction), MAX_USE)

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
        self._steps = _whole_steps(problem.dt, time_step)
        self.h = problem.dt / self._steps
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
            asked = np.abs(self.servo.asked)
            self._at_limit += (asked >= self.servo.effort) & (asked > 0.0)
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
        """Let the object slip in a hand by the change since the last period."""
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


def _whole_steps(dt: float, time_step: float) -> int:
    steps = round(dt / time_step)
    if steps < 1 or abs(steps * time_step - dt) > 1e-9 * dt:
        raise InvalidValueError(
            f"time_step: found {time_step:g} s, stated or by default, needs a whole part of dt = "
            f"{dt:g} s; state one, such as time_step: {dt / math.ceil(dt / time_step):g}"
        ).at("time_step")
    return steps
