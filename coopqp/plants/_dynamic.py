"""What plants with masses share: servos, delay, sensors, and the signals they tell."""

from __future__ import annotations

from abc import abstractmethod
from collections import deque

import numpy as np

from coopqp.checked import Array, seeded
from coopqp.controller import Command, ControlProblem
from coopqp.disturbance import Disturbance
from coopqp.errors import InvalidValueError
from coopqp.plant import PlantModel
from coopqp.plants._servo import Servo, ServoLaw
from coopqp.state import State


class DynamicModel(PlantModel):
    """A plant with masses, driven by velocities through servos or by torques.

    Args:
        problem: chain and control period.
        servo: of the joints.
        time_step: of the integration [s]; must divide the control period.
        seed: of the noise.
        disturbance: what the controller does not know.

    Attributes:
        true: the state before noise; its time goes on from phase to phase.
        signals: ``tau`` (n,) [N m] at the end of the period; ``saturated`` (n,), share of the
            period's steps that a motor was at its limit; ``energy`` (2,), kinetic and potential
            [J].

    Raises:
        InvalidValueError: the time step does not divide the control period.
    """

    def __init__(
        self,
        problem: ControlProblem,
        servo: Servo,
        time_step: float,
        seed: int,
        disturbance: Disturbance,
    ) -> None:
        n = problem.chain.n
        self.true, self._t_start = State(problem.chain), 0.0
        self.servo = ServoLaw(problem.chain, servo)
        self.disturbance = disturbance
        self._steps = _whole_steps(problem.dt, time_step)
        self.h = problem.dt / self._steps
        self._rng = seeded(seed)
        self._late: deque[Command] = deque(Command(n) for _ in range(disturbance.delay))
        self._at_limit = np.zeros(n)
        self.signals: dict[str, Array] = {
            "tau": self.servo.tau,
            "saturated": np.zeros(n),
            "energy": np.zeros(2),
        }

    def step(self, state: State, command: Command) -> None:
        """One control period."""
        self.servo.begin(self._delayed(command), self.true.q)
        self._at_limit[:] = 0.0
        for _ in range(self._steps):
            self.integrate()
            self.servo.advance(self.h)
            self._at_limit += np.abs(self.servo.asked) > self.servo.effort
        np.divide(self._at_limit, self._steps, self.signals["saturated"])
        self.signals["energy"][:] = self.energy()
        self._measure(state)

    def configuration(self, state: State) -> Array:
        """Before noise."""
        return self.true.q

    def resume(self, before: PlantModel) -> None:
        """Take over time, motion, servos, commands on their way and the stream of noise."""
        assert isinstance(before, DynamicModel)
        true, old = self.true, before.true
        true.t = self._t_start = old.t
        true.q[:], true.v[:] = old.q, old.v
        true.update()
        self.servo.resume(before.servo)
        self._late, self._rng = before._late, before._rng
        self.take_hold(before)

    @abstractmethod
    def take_hold(self, before: PlantModel) -> None:
        """Make ``true``, taken over from before, agree with the loops that have closed."""

    @abstractmethod
    def integrate(self) -> None:
        """Advance ``true`` by h: its t, q and v."""

    @abstractmethod
    def energy(self) -> tuple[float, float]:
        """Kinetic and potential energy [J]."""

    def _delayed(self, command: Command) -> Command:
        """The command that arrives now."""
        if not self._late:
            return command
        self._late.append(command.copy())
        return self._late.popleft()

    def _measure(self, state: State) -> None:
        true, noise = self.true, self.disturbance
        state.t, state.q[:], state.v[:] = true.t - self._t_start, true.q, true.v
        if noise.noise_position:
            state.q += self._rng.normal(0.0, noise.noise_position, len(state.q))
        if noise.noise_velocity:
            state.v += self._rng.normal(0.0, noise.noise_velocity, len(state.v))


def _whole_steps(dt: float, time_step: float) -> int:
    steps = round(dt / time_step)
    if steps < 1 or abs(steps * time_step - dt) > 1e-9 * dt:
        raise InvalidValueError(
            f"time_step: found {time_step} s, needs a whole part of dt = {dt} s"
        )
    return steps
