"""The closed chain as rigid bodies under joint servos with torque limits.

Integrates the direct dynamic model with the classical Runge-Kutta method at a step that divides
the control period, and projects q and v back on the closed loops after every step.

Velocity commands become desired angles, q_d += v dt, followed by a servo in each joint:

    tau = effort / saturation_angle (q_d - q) + D (v_d - v) + gravity compensation,  |tau| <= effort

with D = 2 damping_ratio sqrt(K A_jj) from the inertia at the start.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from coopqp.controller import Command, ControlProblem
from coopqp.dynamics import ClosedLoopDynamics, Friction
from coopqp.errors import InvalidValueError
from coopqp.plant import Plant, PlantModel
from coopqp.spec import Positive, spec
from coopqp.state import State

Array = NDArray[np.float64]


class RigidBodyModel(PlantModel):
    """The rigid bodies and their servos.

    Args:
        problem: chain and control period.
        settings: the plug-in.

    Attributes:
        signals: tau, shape (n,) [N m], of the last step; energy, shape (2,):
            kinetic and potential [J];
            saturated, shape (n,): share of the period's steps that a motor was at its limit.

    """

    def __init__(self, problem: ControlProblem, settings: RigidBody) -> None:
        chain = problem.chain
        self._dynamics = ClosedLoopDynamics(chain, friction=settings.friction)
        self._compensation = ClosedLoopDynamics(chain)
        self._compensate = settings.gravity_compensation
        self._steps = settings.steps(problem.dt)
        self._h = problem.dt / self._steps
        self._state = State(chain)
        motors = np.zeros(chain.n, bool)
        motors[self._dynamics.actuated] = True
        self._effort = np.where(motors, chain.model.effortLimit, 0.0)
        self._dynamics.update(self._state.q, self._state.v)
        self._stiffness = self._effort / settings.saturation_angle
        inertia = np.diag(self._dynamics.A)
        self._damping = 2.0 * settings.damping_ratio * np.sqrt(self._stiffness * inertia)
        self._q_d, self._v_d = self._state.q.copy(), np.zeros(chain.n)
        self._feed_forward = np.zeros(chain.n)
        self._tau = np.zeros(chain.n)
        self._at_limit = np.zeros(chain.n)
        self.signals = {
            "tau": self._tau, "energy": np.zeros(2), "saturated": np.zeros(chain.n)
        }  # fmt: skip

    def step(self, state: State, command: Command) -> None:
        """One control period in steps of the Runge-Kutta method."""
        mine = self._state
        self._v_d[:] = command.v
        self._update_feed_forward()
        self._at_limit[:] = 0.0
        for _ in range(self._steps):
            self._runge_kutta(mine)
            mine.update()
            mine.close_loops()
            self._q_d += self._h * self._v_d
            self._at_limit += np.abs(self._tau) >= self._effort
        state.q[:], state.v[:] = mine.q, mine.v
        state.t += self._h * self._steps
        self._report()

    def _update_feed_forward(self) -> None:
        """Torques that hold the chain at rest where it is, by the inverse model."""
        if self._compensate:
            self._compensation.update(self._state.q, np.zeros_like(self._v_d))
            self._feed_forward[:] = self._compensation.inverse(np.zeros_like(self._v_d)).tau

    def _torque(self, q: Array, v: Array) -> Array:
        tau = self._tau
        np.subtract(self._q_d, q, tau)
        tau *= self._stiffness
        tau += self._damping * (self._v_d - v)
        tau += self._feed_forward
        np.minimum(np.maximum(tau, -self._effort, out=tau), self._effort, out=tau)
        return tau

    def _acceleration(self, q: Array, v: Array) -> Array:
        self._dynamics.update(q, v)
        return self._dynamics.direct(self._torque(q, v)).a.copy()

    def _runge_kutta(self, state: State) -> None:
        h, q, v = self._h, state.q, state.v
        a1 = self._acceleration(q, v)
        v2 = v + 0.5 * h * a1
        a2 = self._acceleration(q + 0.5 * h * v, v2)
        v3 = v + 0.5 * h * a2
        a3 = self._acceleration(q + 0.5 * h * v2, v3)
        v4 = v + h * a3
        a4 = self._acceleration(q + h * v3, v4)
        state.q += h / 6.0 * (v + 2.0 * v2 + 2.0 * v3 + v4)
        state.v += h / 6.0 * (a1 + 2.0 * a2 + 2.0 * a3 + a4)

    def _report(self) -> None:
        energy = self.signals["energy"]
        energy[0] = self._dynamics.kinetic_energy(self._state.q, self._state.v)
        energy[1] = self._dynamics.potential_energy(self._state.q)
        np.divide(self._at_limit, self._steps, self.signals["saturated"])


@spec
class RigidBody(Plant):
    """Rigid bodies with joint servos and torque limits, integrated with the loops closed."""

    time_step: Positive = 0.001
    """Integration step; must divide the control period [s]."""
    saturation_angle: Positive = 0.05
    """Angle error at which a servo asks its full torque [rad]."""
    damping_ratio: Positive = 1.0
    """Of each servo with the inertia it sees at the start; 1 is critical."""
    gravity_compensation: bool = True
    """Whether the servos are fed the torques that hold the modelled weight."""
    friction: Friction = Friction()
    """In every joint."""

    def build(self, problem: ControlProblem, seed: int) -> PlantModel:
        """At rest at the chain's start."""
        return RigidBodyModel(problem, self)

    def steps(self, dt: float) -> int:
        """Steps in a control period.

        Raises:
            InvalidValueError: the step does not divide the period.

        """
        steps = round(dt / self.time_step)
        if steps < 1 or abs(steps * self.time_step - dt) > 1e-9 * dt:
            raise InvalidValueError(
                f"rigid_body.time_step: found {self.time_step} s, needs a whole part of dt = {dt} s"
            )
        return steps
