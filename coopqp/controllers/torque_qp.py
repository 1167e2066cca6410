"""The QP at torque level: accelerations, torques and loop wrenches as variables.

    minimise    sum_i w_i |J_i a + drift_i + 2 g_i e_dot_i + g_i^2 e_i + integral g_i^3 int w_i|^2
              + damping |a + v/damping_time|^2 + effort |tau|^2 + grip |lambda|^2
    subject to  A a + H = S' tau + J_c' lambda                     dynamics          (hard)
                J_c a = -Jdot_c v - 2 kappa J_c v - kappa^2 e      loop acceleration (hard)
                |tau| <= effort limits                             motors            (hard)
                lb <= v + a dt <= ub,  G (v + a dt) <= h          the scenario's limits (hard)

g_i is the task's gain, w_i how far the error is from its reference model (``_reference_model``), so
that a step of the reference does not overshoot. While a motor is at its limit the integral stands
still. Gains and integrals that ring with commands one tick late are refused (``_margins``).
lb, ub, G, h are what the scenario's limits say of the next velocity, but a joint near its stop must
slow down in time: v + a dt <= (upper - q)/brake_time. Where the velocity has already left a limit,
it comes back with the largest acceleration.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import ClassVar

import numpy as np

from coopqp.checked import NonNegative, Positive, spec
from coopqp.closed_chain import ClosedChain
from coopqp.controller import Command, Controller, ControlProblem, Heeds, Law
from coopqp.controllers._margins import damped, largest, require_damped_models, row_loop
from coopqp.controllers._reference_model import ReferenceModel
from coopqp.controllers._torque_level import TaskDynamics, require_motor_freedom
from coopqp.errors import InvalidValueError
from coopqp.qp import QP, Rows
from coopqp.qp_law.bounds import Bounds
from coopqp.qp_law.equations import add_damping, normal_equations
from coopqp.row import Row
from coopqp.solver import Solution, Verifier
from coopqp.state import State

#: Ticks in which a motion may die out, or a joint brake, at the fastest.
LEAST_TICKS = 4


class TorqueQpLaw(Law):
    """The QP of one problem; x = [a; tau of the motors; lambda]; memory: that of ReferenceModel.

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
        start = State(chain)
        self._bounds = Bounds(
            chain, problem.limits, start, problem.dt, position_time=settings.brake_time
        )
        self.qp = QP(_rows(chain, dynamics.actuated.tolist(), self._bounds.rows))
        self.solution = Solution(self.qp)
        self._a, self._tau = slice(0, n), slice(n, n + k)
        self._diagonal = np.repeat([settings.damping, settings.effort, settings.grip], [n, k, m])
        self._effort = chain.model.effortLimit[dynamics.actuated]
        self._gains = level.gains
        self._model = ReferenceModel(level.gains, problem.dt)
        self.memory_sizes = self._model.memory_sizes
        self._weights = level.tasks.weights
        self.qp.lb[self._tau], self.qp.ub[self._tau] = -self._effort, self._effort
        # S' tau and J_c' lambda on the left of the dynamics row.
        self.qp.A[dynamics.actuated, n + np.arange(k)] = -1.0
        curvature = float(self._diagonal.min())
        self._verifier = Verifier(self.qp, self.solution, problem.budget, curvature)
        self._solve = problem.solver.open(self.qp, self.solution)

    def decide(self, state: State) -> Command:
        """Assemble, solve, verify; without a usable answer the motors hold and brake."""
        command = self.command
        self.assemble(state)
        self._solve()
        self.solution.status = self._verifier.check()
        command.say(self.solution.status)
        assert command.tau is not None
        command.tau[:] = 0.0
        if command.status.usable:
            tau = self.solution.v[self._tau]
            command.tau[self._level.dynamics.actuated] = tau
            integrate = bool((np.abs(tau) < self._effort).all())
            self._model.update(state.memory, self._level.tasks.e)
            self._model.advance(state.memory, self._level.e_dot, integrate=integrate)
        else:
            command.tau[:] = self._level.holding(state, self._settings.damping_time)
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
        held = tasks.e + self._settings.integral * gains * state.memory["integral"]
        wanted = -level.drift - gains * (2.0 * level.e_dot + gains * held)
        qp.P[:], qp.q[:] = 0.0, 0.0
        normal_equations(tasks.J, self._weights, wanted, 0.0, qp.P[a, a], qp.q[a])
        add_damping(qp.P, self._diagonal)
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
        """What the limits say of v + a dt, as bounds and rows on a."""
        qp, a, bounds, v = self.qp, self._a, self._bounds, state.v
        dt, most = self.problem.dt, self._settings.acceleration
        bounds.update(state)
        upper = np.clip((bounds.ub - v) / dt, -most, most)
        lower = np.clip((bounds.lb - v) / dt, -most, most)
        qp.ub[a] = upper
        np.minimum(lower, upper, out=qp.lb[a])
        if qp.p:
            # No row asks for more than the joints' acceleration can give.
            qp.G[:, a] = bounds.G
            room = (bounds.h - bounds.G.dot(v)) / dt
            np.maximum(room, -most * np.abs(bounds.G).sum(axis=1), out=qp.h)

    def hold_still(self, state: State) -> None:
        """Hold the weight and brake."""
        assert self.command.tau is not None
        self._level.dynamics.update(state.q, state.v)
        self.command.tau[:] = self._level.holding(state, self._settings.damping_time)


def _rows(chain: ClosedChain, actuated: Sequence[int], inequalities: tuple[Row, ...]) -> Rows:
    """Accelerations, torques and wrenches; the dynamics and the loops."""
    joints, units = chain.joint_names, chain.joint_units
    a = (
        Row(name=f"a[{name}]", kind="joint", unit=f"{unit}/s2", joint=name)
        for name, unit in zip(joints, units, strict=True)
    )
    efforts = {"rad": "N m", "m": "N"}
    tau = (
        Row(name=f"tau[{joints[i]}]", kind="motor", unit=efforts[units[i]], joint=joints[i])
        for i in actuated
    )
    wrench = (
        replace(row, name=f"wrench.{row.name}", unit="N m" if row.unit == "rad/s" else "N")
        for row in chain.loops.kept_rows
    )
    dynamics = (
        Row(name=f"dynamics[{name}]", kind="dynamics", unit=efforts[unit], joint=name)
        for name, unit in zip(joints, units, strict=True)
    )
    return Rows((*a, *tau, *wrench), inequalities, (*dynamics, *chain.loops.kept_rows))


@spec
class TorqueQp(Controller):
    """QP at torque level: dynamics and loops hard, motor, joint and acceleration limits hard."""

    uses_solver: ClassVar[bool] = True
    heeds: ClassVar[Heeds] = frozenset({"limits"})

    integral: NonNegative = 0.3
    """Weight of the integral over gain cubed; refused where it rings, from 0.8 on or earlier."""
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
        """Refuse tasks that the motors cannot decide, gains and integrals that ring."""
        name = self.name or "torque_qp"
        require_motor_freedom(problem, name)
        require_damped_models(problem, name)
        self._require_times(problem.dt, name)
        self._require_damped_integral(problem, name)
        return TorqueQpLaw(problem, self)

    def _require_times(self, dt: float, name: str) -> None:
        """What dies out or brakes within a tick or two overshoots, and passes the stop."""
        for key in ("damping_time", "brake_time"):
            found = getattr(self, key)
            if found < LEAST_TICKS * dt:
                raise InvalidValueError(
                    f"{name}.{key}: found {found:g} s, needs at least {LEAST_TICKS} ticks, "
                    f"{LEAST_TICKS * dt:g} s"
                )

    def _require_damped_integral(self, problem: ControlProblem, name: str) -> None:
        dt = problem.dt
        for task in problem.tasks:
            holds = partial(_integral_holds, task.gain, dt)
            if not holds(self.integral):
                raise InvalidValueError(
                    f"{name}.integral: found {self.integral:g}, needs at most "
                    f"{largest(holds, self.integral):g} at gain {task.gain:g} 1/s (task "
                    f"{task.name}) and dt {1e3 * dt:g} ms; more rings, so lower it"
                )


def _integral_holds(gain: float, dt: float, integral: float) -> bool:
    return damped(row_loop(gain, integral, dt))
