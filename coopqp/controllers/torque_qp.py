"""The QP at torque level: accelerations, torques and loop wrenches as variables.

    minimise    sum_i w_i |J_i a + drift_i + 2 g_i e_dot_i + g_i^2 e_i + integral g_i^3 int e_i|^2
              + damping |a + v/damping_time|^2 + effort |tau|^2 + grip |lambda|^2
    subject to  A a + H = S' tau + J_c' lambda                     dynamics          (hard)
                J_c a = -Jdot_c v - 2 kappa J_c v - kappa^2 e      loop acceleration (hard)
                |tau| <= effort limits                             motors            (hard)
                a within what joint position, velocity and acceleration limits allow (hard)

g_i is the task's gain. While a motor is at its limit the integral stands still.
Before a joint reaches its stop its speed must fall to zero: v + a dt <= (upper - q)/brake_time.
"""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from coopqp.checked import Array, NonNegative, Positive, spec
from coopqp.controller import Command, Controller, ControlProblem, Law
from coopqp.controllers._torque_level import TaskDynamics, require_motor_freedom
from coopqp.qp import QP, RowNames
from coopqp.solver import Solution, Verifier
from coopqp.state import State


class TorqueQpLaw(Law):
    """The QP of one problem; x = [a; tau of the motors; lambda]; memory is the integral, (k,).

    Attributes:
        qp: the last tick's program.
        solution: its answer.
    """

    def __init__(self, problem: ControlProblem, settings: TorqueQp) -> None:
        super().__init__(problem, torques=True)
        self._settings = settings
        self._level = level = TaskDynamics(problem)
        chain, dynamics = problem.chain, level.dynamics
        n, k, m = chain.n, len(dynamics.actuated), len(dynamics.drift)
        joints = chain.joint_names
        motors = [joints[i] for i in dynamics.actuated]
        self.qp = QP(
            RowNames(
                variables=(
                    *(f"a[{name}]" for name in joints),
                    *(f"tau[{name}]" for name in motors),
                    *(f"wrench.{name}" for name in chain.loops.kept_names),
                ),
                equalities=(
                    *(f"dynamics[{name}]" for name in joints),
                    *chain.loops.kept_names,
                ),
            )
        )
        self.solution = Solution(self.qp)
        self._a, self._tau = slice(0, n), slice(n, n + k)
        self._diagonal = np.repeat([settings.damping, settings.effort, settings.grip], [n, k, m])
        self.memory_size = len(level.tasks.e)
        self._effort = chain.model.effortLimit[dynamics.actuated]
        self._gains = np.repeat([t.gain for t in problem.tasks], _sizes(level))
        self._weights = level.tasks.weights
        self.qp.lb[self._tau], self.qp.ub[self._tau] = -self._effort, self._effort
        # S' tau and J_c' lambda on the left of the dynamics row.
        self.qp.A[dynamics.actuated, n + np.arange(k)] = -1.0
        curvature = float(self._diagonal.min())
        self._verifier = Verifier(self.qp, self.solution, problem.budget, curvature)
        self._solve = problem.solver.open(self.qp, self.solution)

    def tick(self, state: State) -> Command:
        """Assemble, solve, verify; without a usable answer the motors hold and brake."""
        command = self.command
        self.assemble(state)
        self._solve()
        command.status = self.solution.status = self._verifier.check()
        assert command.tau is not None
        command.tau[:] = 0.0
        if command.status.usable:
            tau = self.solution.v[self._tau]
            command.tau[self._level.dynamics.actuated] = tau
            if (np.abs(tau) < self._effort).all():
                state.memory += self.problem.dt * self._level.tasks.e
        else:
            command.tau[:] = self._holding(state)
            self.solution.v[:] = 0.0
        return command

    def assemble(self, state: State) -> None:
        """Fill the QP for a state."""
        level = self._level
        level.update(state)
        self._fill_objective(state)
        self._fill_equalities(state)
        self._fill_bounds(state)

    def _fill_objective(self, state: State) -> None:
        qp, level, a = self.qp, self._level, self._a
        tasks, gains = level.tasks, self._gains
        held = tasks.e + self._settings.integral * gains * state.memory
        wanted = -level.drift - gains * (2.0 * level.e_dot + gains * held)
        weighted = tasks.J * self._weights[:, None]
        qp.P[:] = 0.0
        qp.P[a, a] = weighted.T.dot(tasks.J)
        qp.P.reshape(-1)[:: qp.n + 1] += self._diagonal
        qp.q[:] = 0.0
        qp.q[a] = -wanted.dot(weighted)
        qp.q[a] += self._settings.damping / self._settings.damping_time * state.v

    def _fill_equalities(self, state: State) -> None:
        qp, dynamics, n = self.qp, self._level.dynamics, self.problem.chain.n
        k, kappa = len(dynamics.actuated), self.problem.kappa
        qp.A[:n, :n] = dynamics.A
        qp.A[:n, n + k :] = -dynamics.J.T
        qp.A[n:, :n] = dynamics.J
        qp.b[:n] = -dynamics.H
        qp.b[n:] = -dynamics.drift
        qp.b[n:] -= 2.0 * kappa * dynamics.J.dot(state.v) + kappa**2 * state.e_loop
        qp.seal()

    def _fill_bounds(self, state: State) -> None:
        chain, dt, settings = self.problem.chain, self.problem.dt, self._settings
        fastest = np.minimum(chain.velocity, (chain.upper - state.q) / settings.brake_time)
        slowest = np.maximum(-chain.velocity, (chain.lower - state.q) / settings.brake_time)
        limit = settings.acceleration
        upper = np.clip((fastest - state.v) / dt, -limit, limit)
        lower = np.clip((slowest - state.v) / dt, -limit, limit)
        self.qp.ub[self._a] = upper
        np.minimum(lower, upper, out=self.qp.lb[self._a])

    def _holding(self, state: State) -> Array:
        """The weight, and a brake that stops the joints, within the motors' limits."""
        dynamics = self._level.dynamics
        brake = dynamics.A.dot(state.v) / self._settings.damping_time
        tau = dynamics.distribute(dynamics.gravity(state.q) - brake).tau
        effort = self.problem.chain.model.effortLimit
        return np.asarray(np.minimum(np.maximum(tau, -effort), effort), float)


def _sizes(level: TaskDynamics) -> list[int]:
    return [part.stop - part.start for part in level.tasks.slices]


@spec
class TorqueQp(Controller):
    """QP at torque level: dynamics and loops hard, motor, joint and acceleration limits hard."""

    uses_solver: ClassVar[bool] = True

    integral: NonNegative = 0.3
    """Weight of the integral over gain cubed; above 2 it is unstable."""
    damping: Positive = 1e-5
    """Cost of squared accelerations that do not brake [s4/rad2]."""
    damping_time: Positive = 0.05
    """Motion that no task asks for dies out in this time [s]."""
    effort: Positive = 1e-4
    """Cost of squared motor torques [1/(N m)2]; decides how redundant motors share."""
    grip: Positive = 1e-6
    """Cost of squared loop wrenches [1/N2]; decides how hard the hands squeeze."""
    brake_time: Positive = 0.05
    """A joint may move towards its stop at most at the distance over this time [s]."""
    acceleration: Positive = 500.0
    """Largest joint acceleration [rad/s2]."""

    @property
    def commands_torques(self) -> bool:
        """Always."""
        return True

    def build(self, problem: ControlProblem) -> Law:
        """Refuse tasks that the motors cannot decide."""
        require_motor_freedom(problem, self.name or "torque_qp")
        return TorqueQpLaw(problem, self)
