"""One PID in task space for the whole closed chain: section 5.3 and Fig. 10 of the paper.

With e the task error (six rows for a pose), e_dot = J v - rate measured, not differentiated:

    u = kp e + ki int e dt + kd e_dot

``kinematic``: J v = rate - u with the loops closed, mapped through a basis N of their null space,
v = N (J N)^+ (rate - u), which is J_a of eq. (19) without choosing independent joints.

``torque``: the wrench -u on the object plus a feed-forward, as torques Gamma of the tree,

    Gamma = g(q) - J' u                      (gravity)
    Gamma = A a_r + H - J' u                 (inverse_dynamics; a_r follows the reference)

and from there to the motors by eq. (23), with redundant motors by eq. (27). While a motor is at
its limit the integral stands still (anti-windup).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from coopqp.checked import Array, NonNegative, spec
from coopqp.controller import Command, Controller, ControlProblem, Law
from coopqp.controllers._torque_level import TaskDynamics, require_motor_freedom
from coopqp.errors import InvalidValueError
from coopqp.rank import least_squares, null_space
from coopqp.solver import Status
from coopqp.state import State
from coopqp.task import TaskStack

Gains = Annotated[tuple[NonNegative, ...], Field(min_length=1)]


class KinematicPid(Law):
    """PID on the object's twist; memory is the integral, shape (k,)."""

    def __init__(self, problem: ControlProblem, settings: PassiveGraspPid) -> None:
        super().__init__(problem)
        self._tasks = TaskStack(problem.tasks, State(problem.chain))
        self.memory_sizes = {"integral": len(self._tasks.e)}
        self._gains = settings.gains(problem, KINEMATIC_GAINS, len(self._tasks.e))

    def decide(self, state: State) -> Command:
        """One evaluation; the integral is carried in ``state.memory``."""
        tasks, command = self._tasks, self.command
        tasks.update(state)
        kp, ki, kd = self._gains
        integral = state.memory["integral"]
        integral += self.problem.dt * tasks.e
        wanted = tasks.rate - kp * tasks.e - ki * integral
        wanted -= kd * (tasks.J.dot(state.v) - tasks.rate)
        N = null_space(state.J_loop)
        command.v[:] = N @ least_squares(tasks.J @ N, wanted)
        command.v -= np.linalg.pinv(state.J_loop) @ (self.problem.kappa * state.e_loop)
        command.status = Status.OPTIMAL if np.isfinite(command.v).all() else Status.NOT_FINITE
        if not command.status.usable:
            command.v[:] = 0.0
        return command


class TorquePid(Law):
    """PID on the object's wrench; memory is the integral, shape (k,)."""

    def __init__(self, problem: ControlProblem, settings: PassiveGraspPid) -> None:
        super().__init__(problem, torques=True)
        self._level = TaskDynamics(problem)
        self.memory_sizes = {"integral": len(self._level.tasks.e)}
        self._gains = settings.gains(problem, TORQUE_GAINS, len(self._level.tasks.e))
        self._inverse = settings.feed_forward == "inverse_dynamics"
        self._effort = problem.chain.model.effortLimit

    def decide(self, state: State) -> Command:
        """One evaluation; the integral is carried in ``state.memory``."""
        level, command = self._level, self.command
        level.update(state)
        kp, ki, kd = self._gains
        tasks, dynamics = level.tasks, level.dynamics
        integral = state.memory["integral"]
        u = kp * tasks.e + ki * integral + kd * level.e_dot
        Gamma = self._feed_forward(state) - tasks.J.T.dot(u)
        result = dynamics.distribute(Gamma)
        tau = result.tau
        finite = bool(np.isfinite(tau).all())
        assert command.tau is not None
        command.tau[:] = tau if finite else 0.0
        command.status = Status.OPTIMAL if finite else Status.NOT_FINITE
        if (np.abs(tau) <= self._effort).all():
            integral += self.problem.dt * tasks.e
        return command

    def _feed_forward(self, state: State) -> Array:
        dynamics, level = self._level.dynamics, self._level
        if not self._inverse:
            return dynamics.gravity(state.q)
        rows = np.vstack([level.tasks.J, dynamics.J])
        wanted = -np.concatenate([level.drift, dynamics.drift])
        a_r = least_squares(rows, wanted)
        return np.asarray(dynamics.A.dot(a_r) + dynamics.H, float)


#: kp [1/s], ki [1/s2], kd [-] of the kinematic level.
KINEMATIC_GAINS = (5.0, 2.0, 0.0)
#: kp [N/m, N m/rad], ki [.../s], kd [... s] of the torque level, translation and rotation.
TORQUE_GAINS = ((600.0, 4.0), (2400.0, 16.0), (40.0, 0.25))


@spec
class PassiveGraspPid(Controller):
    """Task-space PID on the whole closed chain (Fig. 10), by velocities or by torques."""

    level: Literal["kinematic", "torque"] = "torque"
    """Whether it commands velocities or torques."""
    kp: Gains | None = None
    """Proportional gains, one for all task rows or one each [N/m, N m/rad; kinematic 1/s]."""
    ki: Gains | None = None
    """Integral gains, likewise, per second."""
    kd: Gains | None = None
    """Derivative gains, likewise, times a second."""
    feed_forward: Literal["gravity", "inverse_dynamics"] = "inverse_dynamics"
    """What the torque level adds: the weight, or the reference's whole inverse dynamics."""

    @property
    def commands_torques(self) -> bool:
        """At the torque level."""
        return self.level == "torque"

    def build(self, problem: ControlProblem) -> Law:
        """Refuse tasks that the motors cannot decide, and gains of the wrong number."""
        require_motor_freedom(problem, self.name or "passive_grasp_pid")
        law = TorquePid if self.level == "torque" else KinematicPid
        return law(problem, self)

    def gains(
        self, problem: ControlProblem, defaults: Sequence[float | tuple[float, float]], rows: int
    ) -> tuple[Array, Array, Array]:
        """kp, ki, kd by task row.

        Raises:
            InvalidValueError: a list that is neither of length one nor of the tasks' rows.
        """
        turning = np.array([_is_angle(unit) for unit in _units(problem)])
        found = []
        for key, default in zip(("kp", "ki", "kd"), defaults, strict=True):
            given = getattr(self, key)
            if given is None:
                move, turn = default if isinstance(default, tuple) else (default, default)
                found.append(np.where(turning, turn, move))
            elif len(given) in (1, rows):
                found.append(np.array(given) * np.ones(rows))
            else:
                raise InvalidValueError(
                    f"{self.name or 'passive_grasp_pid'}.{key}: found {len(given)} gains, needs 1 "
                    f"or {rows}, one for each task row"
                )
        return found[0], found[1], found[2]


def _units(problem: ControlProblem) -> list[str]:
    """Unit of every task row."""
    return [
        part.unit
        for task in problem.tasks
        for part in task.parts(problem.chain)
        for _ in range(part.rows)
    ]


def _is_angle(unit: str) -> bool:
    return unit == "rad"
