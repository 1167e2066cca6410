"""PID in task space for the whole closed chain: section 5.3 and Fig. 10 of the paper.

With e the task error (six rows for a pose), e_dot = J v - rate measured, not differentiated, e_m
a reference model of the decay of e after a step of the reference, and w = e - e_m:

    u = kp w + ki int w dt + kd w_dot

``kinematic``: J v = rate + e_m_dot - u with the loops closed, mapped through a basis N of their
null space, v = N (J N)^+ (rate + e_m_dot - u), which is J_a of eq. (19) without choosing
independent joints. e_m_dot = -kp e_m.

``torque``: the wrench -u on the object plus a feed-forward, as torques Gamma of the tree,

    Gamma = g(q) - J' u                      (gravity)
    Gamma = A a_r + H - J' u                 (inverse_dynamics; a_r follows the reference and e_m)

and from there to the motors by eq. (23), with redundant motors by eq. (27), or such that the hands
exert the internal wrench that is asked for, as far as passive joints stay free. e_m decays with the
task's gain (:mod:`coopqp.torque_law.margins`). While a motor is beyond its limit its torque is
clipped, the tick is TASKS_RELAXED, and the integral is held (anti-windup).

Gains that oscillate at the start with commands one tick late are refused. The highest stable
stiffness is proportional to 1/dt^2, so the torque level's default gains decrease from 4 ms on,
those of rotation from 2 ms on: kd with 1/dt, kp with 1/dt^2, ki with 1/dt^3, which keeps the shape
of the motion and the margin in ticks. A low rate alone is not refused.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import Field

from coopqp.base.errors import InvalidValueError
from coopqp.base.rank import least_squares, null_space
from coopqp.base.spec import Array, NonNegative, spec
from coopqp.closed_loop.grasp_matrix import grasp_matrix
from coopqp.closed_loop.hands import WrenchStack, hands, points
from coopqp.controller import Command, Controller, ControlProblem, Features, Law
from coopqp.model.state import State
from coopqp.solver import Status
from coopqp.task import TaskStack
from coopqp.torque_law import margins
from coopqp.torque_law.task_dynamics import TaskDynamics, require_motor_freedom

Gains = Annotated[tuple[NonNegative, ...], Field(min_length=1)]


class KinematicPid(Law):
    """PID on the object's twist; memory as in :func:`memory_of`."""

    def __init__(self, problem: ControlProblem, settings: PassiveGraspPid) -> None:
        super().__init__(problem)
        self._tasks = TaskStack(problem.tasks, State(problem.chain))
        k = len(self._tasks.e)
        self.memory_sizes = margins.memory_of(k)
        kp, ki, kd = settings.gains(problem, KINEMATIC_GAINS, k)
        self._loop = margins.VelocityLoop(kp, ki, kd, problem.dt)
        settings.require_damping(problem, self._loop)

    def decide(self, state: State) -> Command:
        tasks, command = self._tasks, self.command
        tasks.update(state)
        e_dot = tasks.J.dot(state.v) - tasks.rate
        wanted = tasks.rate + self._loop.decide(state.memory, tasks.e, e_dot)
        N = null_space(state.J_loop)
        command.v[:] = N @ least_squares(tasks.J @ N, wanted)
        command.v -= np.linalg.pinv(state.J_loop) @ (self.problem.kappa * state.e_loop)
        return self.settle()


class TorquePid(Law):
    """PID on the object's wrench, with memory as in :func:`memory_of`, and ``loop`` for margins."""

    def __init__(self, problem: ControlProblem, settings: PassiveGraspPid) -> None:
        super().__init__(problem, torques=True)
        self._level = level = TaskDynamics(problem)
        self._model = margins.ReferenceModel(level.gains, problem.dt)
        self.memory_sizes = self._model.memory_sizes
        defaults = torque_gains(problem.dt)
        self._gains = kp, ki, kd = settings.gains(problem, defaults, len(level.tasks.e))
        self._inverse = settings.feed_forward == "inverse_dynamics"
        margins.require_damped_models(problem, settings.name)
        level.update(State(problem.chain))
        J, forward = level.tasks.J, float(self._inverse)
        W = J @ level.inverse_inertia() @ J.T
        self.loop = margins.TorqueLoop(level.gains, kp, ki, kd, W, problem.dt, forward)
        settings.require_damping(problem, self.loop)
        self._effort = problem.chain.model.effortLimit
        self._wrenches = WrenchStack(problem.wrenches, State(problem.chain))
        self._hands = hands(problem.chain)

    def decide(self, state: State) -> Command:
        level, command, memory = self._level, self.command, state.memory
        level.update(state)
        kp, ki, kd = self._gains
        tasks, dynamics = level.tasks, level.dynamics
        self._model.update(memory, tasks.e)
        u = kp * memory["deviation"] + ki * memory["integral"]
        u += kd * (level.e_dot - memory["model_rate"])
        Gamma, a_r = self._feed_forward(state)
        Gamma -= tasks.J.T.dot(u)
        tau = self._motors(Gamma, state, a_r)
        finite = bool(np.isfinite(tau).all())
        assert command.tau is not None
        if not finite:
            tau = dynamics.distribute(dynamics.gravity(state.q)).tau
        beyond = np.abs(tau) > self._effort
        np.clip(tau, -self._effort, self._effort, out=command.tau)
        command.say(Status.OPTIMAL if finite else Status.NOT_FINITE)
        if finite and beyond.any():
            names = (self.problem.chain.joint_names[i] for i in np.flatnonzero(beyond))
            command.add(Status.TASKS_RELAXED, f"motors at their limits: {', '.join(names)}")
        self._model.advance(memory, level.e_dot, integrate=finite and not beyond.any())
        return command

    def learned(self, state: State) -> Array:
        """Accelerations of the joints that the integral adds, by wrong masses and pushes, (n,)."""
        level, (_, ki, _) = self._level, self._gains
        return -level.inverse_inertia() @ (level.tasks.J.T @ (ki * state.memory["integral"]))

    def hold_still(self, state: State) -> None:
        assert self.command.tau is not None
        self.command.tau[:] = self._level.holding(state, BRAKE_TIME)

    def _motors(self, Gamma: Array, state: State, a_r: Array) -> Array:
        """Torques of the motors, with the internal wrench that is asked for.

        By the wrench at the cut, which leaves passive joints free, then comes near to what is
        asked, then spares the motors. Hands exert shares of what gives the object a_r, and it.
        """
        wrenches, dynamics = self._wrenches, self._level.dynamics
        if not wrenches.tasks:
            return dynamics.distribute(Gamma).tau
        wrenches.update(state)
        at = points(self._hands, state.p_WO, state.R_WO)
        C = np.split(np.sqrt(wrenches.weights)[:, None] * wrenches.J, len(at), axis=1)
        C = [part @ grasp_matrix([state.p_WO], p) for part, p in zip(C, at, strict=True)]
        carried = dynamics.object_wrenches(a_r, np.zeros(len(dynamics.J_arms) - 6)).needed
        right = np.sqrt(wrenches.weights) * wrenches.wanted - C[0] @ carried
        rows = np.hstack([C[0] - part for part in C[1:]])[:, dynamics.kept]
        passive, motors = dynamics.J[:, dynamics.passive].T, dynamics.J[:, dynamics.actuated].T
        cut, free = np.zeros(len(dynamics.J)), np.eye(len(dynamics.J))
        for A, wanted in (
            (passive, Gamma[dynamics.passive]), (rows, right), (motors, Gamma[dynamics.actuated])
        ):  # fmt: skip
            if free.size:
                cut += free @ least_squares(A @ free, wanted - A @ cut)
                free = free @ null_space(A @ free)
        tau = np.zeros_like(Gamma)
        tau[dynamics.actuated] = Gamma[dynamics.actuated] - motors @ cut
        return tau

    def _feed_forward(self, state: State) -> tuple[Array, Array]:
        """Torques of the tree, and the accelerations that they are for."""
        dynamics, level = self._level.dynamics, self._level
        if not self._inverse:
            return dynamics.gravity(state.q), np.zeros(self.problem.chain.n)
        rows = np.vstack([level.tasks.J, dynamics.J])
        wanted = np.concatenate([self._model.e_ddot - level.drift, -dynamics.drift])
        a_r = least_squares(rows, wanted)
        return np.asarray(dynamics.A.dot(a_r) + dynamics.H, float), a_r


#: In which motion dies out where a tick has no answer [s].
BRAKE_TIME = 0.05
#: kp [1/s], ki [1/s2], kd [-] of the kinematic level, translation and rotation.
KINEMATIC_GAINS = ((5.0, 5.0), (2.0, 2.0), (0.0, 0.0))
#: kp [N/m, N m/rad], ki [.../s], kd [... s] of the torque level, translation and rotation.
TORQUE_GAINS = ((600.0, 4.0), (2400.0, 8.0), (40.0, 0.25))
#: Control period up to which the torque level has these gains, translation and rotation [s]; at
#: the start of passive_grasp_pose, rotation about x is the first to oscillate with longer ones.
FULL_GAINS_DT = (0.004, 0.002)
#: Powers of one time scale that slow a motion down without changing its shape: of kp, ki, kd.
POWERS = (2, 3, 1)
#: What may be lowered against ringing, as powers of one factor: ki; all; kp and ki.
REMEDIES = ((0, 1, 0), POWERS, (2, 3, 0))


def torque_gains(dt: float) -> list[tuple[float, float]]:
    """Defaults of the torque level at a control period, for translation and rotation."""
    move, turn = (min(1.0, full / dt) for full in FULL_GAINS_DT)
    return [
        (move**power * gains[0], turn**power * gains[1])
        for power, gains in zip(POWERS, TORQUE_GAINS, strict=True)
    ]


@spec
class PassiveGraspPid(Controller):
    """Task-space PID on the whole closed chain (Fig. 10), by velocities or by torques."""

    supports: ClassVar[Features] = frozenset({"forces"})

    level: Literal["kinematic", "torque"] = "torque"
    """Whether it commands velocities or torques."""
    kp: Gains | None = None
    """Proportional gains, one for all task rows or one each [N/m, N m/rad; kinematic 1/s].

    Gains that oscillate at the start, with commands one tick late, are refused. The defaults of the
    torque level are for dt to 4 ms (rotation 2 ms); beyond, kp goes as 1/dt^2, ki as 1/dt^3, kd as
    1/dt."""
    ki: Gains | None = None
    """Integral gains, likewise, per second."""
    kd: Gains | None = None
    """Derivative gains, likewise, times a second."""
    feed_forward: Literal["gravity", "inverse_dynamics"] = "inverse_dynamics"
    """What the torque level adds: the weight, or the reference's whole inverse dynamics."""

    @property
    def commands_torques(self) -> bool:
        return self.level == "torque"

    def build(self, problem: ControlProblem) -> Law:
        """Refuse tasks that the motors cannot decide, a wrong number of gains, oscillating ones."""
        require_motor_freedom(problem, self.name)
        if problem.wrenches and not self.commands_torques:
            words = "velocities exert no forces; use level: torque"
            raise InvalidValueError(f"{self.name}: task '{problem.wrenches[0].name}': {words}")
        law = TorquePid if self.level == "torque" else KinematicPid
        return law(problem, self)

    def gains(
        self, problem: ControlProblem, defaults: Sequence[tuple[float, float]], rows: int
    ) -> tuple[Array, Array, Array]:
        """kp, ki, kd by task row; InvalidValueError for lists of another length."""
        parts = [part for task in problem.tasks for part in task.parts(problem.chain)]
        turning = np.repeat([part.unit == "rad" for part in parts], [p.rows for p in parts])
        found = []
        for key, (move, turn) in zip(("kp", "ki", "kd"), defaults, strict=True):
            given = getattr(self, key)
            if given is None:
                found.append(np.where(turning, turn, move))
            elif len(given) in (1, rows):
                found.append(np.array(given) * np.ones(rows))
            else:
                raise InvalidValueError(
                    f"{self.name}.{key}: found {len(given)} gains, needs 1 "
                    f"or {rows}, one for each task row"
                )
        return found[0], found[1], found[2]

    def require_damping(
        self, problem: ControlProblem, loop: margins.TorqueLoop | margins.VelocityLoop
    ) -> None:
        """Refuse gains that oscillate at the start with commands one tick late."""
        if margins.damped(loop):
            return
        raise InvalidValueError(
            f"{self.name}: the gains oscillate at dt "
            f"{1e3 * problem.dt:g} ms with commands a tick late (damping ratio "
            f"{loop.damping():.2f}, needs {margins.MIN_DAMPING:.2f}); {_fix(loop)}"
        )


def _fix(loop: margins.TorqueLoop | margins.VelocityLoop) -> str:
    """Which gains to lower, and by how much."""
    for powers in REMEDIES:
        most = margins.largest(partial(_damped_at, loop, powers), 1.0)
        if most > 0.0:
            times = (
                f"{key} at most {most**power:.2g} times as large"
                for key, power in zip(("kp", "ki", "kd"), powers, strict=True)
                if power
            )
            return f"needs {', '.join(times)}"
    return "needs gains of another size: all much lower, or more kd with the same kp and ki"


def _damped_at(
    loop: margins.TorqueLoop | margins.VelocityLoop, powers: Sequence[int], factor: float
) -> bool:
    kp, ki, kd = (factor**power for power in powers)
    return margins.damped(replace(loop, kp=kp * loop.kp, ki=ki * loop.ki, kd=kd * loop.kd))
