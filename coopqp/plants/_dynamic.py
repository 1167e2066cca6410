"""What plants with masses share: servos, delay, sensors, and their signals."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections import deque

import numpy as np

from coopqp.base.errors import InvalidValueError
from coopqp.base.spec import Array, seeded
from coopqp.controller import Command, ControlProblem
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.state import State
from coopqp.plant import Disturbance, PlantModel
from coopqp.plants._hands import HandSignals
from coopqp.plants._servo import Servo, ServoLaw
from coopqp.plants._true_chain import slipped, true_chain


class DynamicModel(PlantModel):
    """A plant with masses, driven by velocities through servos or by torques.

    Args:
        problem: chain and control period.
        servo: of the joints.
        time_step: of the integration [s]; must divide the control period.
        seed: of the noise.
        disturbance: unknown to the controller.

    Attributes:
        true: the state of the true chain, before noise; its time goes on from phase to phase.
        hand_signals: of the hands, which subclasses write and add to ``signals``.
        signals: ``tau`` (n,) [N m] at the end of the period; ``saturated`` (n,), share of the
            period's steps that a motor was at its limit; ``energy`` (2,), kinetic and potential
            [J]; ``push`` (6,), on the object at the end of the period [N, N m].

    Raises:
        InvalidValueError: the time step does not divide the control period, or the robot has no
            mass.
    """

    def __init__(
        self,
        problem: ControlProblem,
        servo: Servo,
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
        self.disturbance, self._seed = disturbance, seed
        self._dt, self._slipped = problem.dt, 0.0
        firm = true_chain(problem.chain, seed, disturbance)
        self.true, self._truth = State(firm), State(firm)
        self.hand_signals = HandSignals(firm, disturbance.friction)
        self.servo = ServoLaw(problem.chain, servo)
        self._steps = _whole_steps(problem.dt, time_step)
        self.h = problem.dt / self._steps
        self._rng = seeded(seed)
        self._late: deque[Command] = deque(Command(n) for _ in range(disturbance.delay))
        self._at_limit = np.zeros(n)
        self.signals = {
            "tau": self.servo.tau,
            "saturated": np.zeros(n),
            "energy": np.zeros(2),
            "push": np.zeros(6),
        }
        self.measured = self._noisy(self.true.q, disturbance.noise_position)
        self.servo.hold(self.measured)

    def step(self, state: State, command: Command) -> None:
        self._slip()
        self.servo.begin(self._delayed(command), self.true.q)
        self._at_limit[:] = 0.0
        for _ in range(self._steps):
            self.integrate()
            self.servo.advance(self.h)
            self._at_limit += np.abs(self.servo.asked) > self.servo.effort
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

        The arms hold the object where they really are. With velocity commands, the servos hold the
        last measured angles, from where the controller goes on, and delayed commands are dropped;
        with torques nothing stops.
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

    def _delayed(self, command: Command) -> Command:
        if not self._late:
            return command
        self._late.append(command.copy())
        return self._late.popleft()

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
