"""Inverse dynamics with the object's wrench split among the hands by a formula: a baseline.

    J_c a = -Jdot_c v - back,   J a = wanted       in least squares
    w = M a_o + b,   h = X w + squeeze (e; -e)      X of a split, e between two hands
    tau = A a + H + sum_i (J_i - J_0)' G_i h_i       within the motors' limits

X knows no friction: without a squeeze hands that press drop the object, and a constant squeeze is
too much at rest or too little in a push, which is what this baseline shows; see Walker, Freeman
and Marcus 1991, Erhart and Hirche 2015, and the pseudoinverse as ``minimum_norm``.
"""

from typing import Literal

import numpy as np

from coopqp.base.errors import GraspError
from coopqp.base.rank import least_squares, null_space
from coopqp.base.spec import Array, NonNegative, Positive, spec
from coopqp.closed_loop.grasp_matrix import Split, section
from coopqp.controller import Command, Controller, ControlProblem, Law
from coopqp.model.state import State
from coopqp.solver import Status
from coopqp.torque_law.hand_wrenches import HandWrenches
from coopqp.torque_law.margins import require_damped_models
from coopqp.torque_law.task_dynamics import TaskDynamics, require_motor_freedom

#: Cost of joint accelerations that no task asks for.
DAMPING = 1e-5


@spec
class WrenchSplit(Controller):
    """Inverse dynamics with the load split by a formula and a fixed squeeze; knows no friction."""

    split: Literal["walker", "virtual_inertia", "minimum_norm"] = "virtual_inertia"
    """Which formula: shares of everything, virtual bodies, or the pseudoinverse."""
    inertia: Positive = 1e-4
    """Of a virtual body over its mass, for virtual_inertia [m2]."""
    squeeze: NonNegative = 0.0
    """Added along the line between two hands [N]."""
    damping_time: Positive = 0.05
    """Motion that no task asks for dies out in this time [s]."""

    @property
    def commands_torques(self) -> bool:
        return True

    def build(self, problem: ControlProblem) -> Law:
        """Refuse tasks that motors cannot decide, oscillating gains, squeezes of three hands."""
        name = self.name
        require_motor_freedom(problem, name)
        require_damped_models(problem, name)
        if self.squeeze and problem.chain.holding != 2:
            raise GraspError(
                f"{name}.squeeze: is between two hands, and {problem.chain.holding} hold the object"
            )
        return WrenchSplitLaw(problem, self)


class WrenchSplitLaw(Law):
    """The formulas of one problem."""

    def __init__(self, problem: ControlProblem, settings: WrenchSplit) -> None:
        super().__init__(problem, torques=True)
        self._settings, self._level = settings, TaskDynamics(problem)
        self._hands = HandWrenches(
            problem.chain, safety=1.0, split=settings.split, shares="weights",
            inertia=settings.inertia,
        )  # fmt: skip
        effort = problem.chain.model.effortLimit.copy()
        effort[problem.chain.passive] = 0.0
        self._effort = effort

    def decide(self, state: State) -> Command:
        """Accelerations, the object's wrench, its split, torques."""
        level, hands, command = self._level, self._hands, self.command
        level.update(state)
        dynamics = level.dynamics
        hands.update(state, dynamics)
        a = self._acceleration(state)
        M, b = dynamics.object_inertia()
        w = M @ (dynamics.J_object @ a + dynamics.drift_arms[:6]) + b
        split = hands.split
        tree = dynamics.A @ a + dynamics.H
        h = split.X @ w + self._squeeze()
        h = h + self._freed(split, tree + hands.to_tau @ h)
        assert command.tau is not None
        tau = tree + hands.to_tau @ h
        np.clip(tau, -self._effort, self._effort, out=command.tau)
        if not np.isfinite(command.tau).all():
            return self.refuse(Status.NOT_FINITE)
        command.say(Status.OPTIMAL)
        return command

    def _acceleration(self, state: State) -> Array:
        level, dynamics = self._level, self._level.dynamics
        back = self._hands.loop_correction(state, dynamics, self.problem)
        closing = least_squares(dynamics.J, -dynamics.drift - back)
        gains, tasks = level.gains, level.tasks
        wanted = -level.drift - gains * (2.0 * level.e_dot + gains * tasks.e)
        N = null_space(dynamics.J)
        JN = tasks.J @ N
        weighted = JN.T * tasks.weights
        rest = -state.v / self._settings.damping_time - closing
        right = weighted @ (wanted - tasks.J @ closing) + DAMPING * (N.T @ rest)
        free = np.linalg.solve(weighted @ JN + DAMPING * np.eye(N.shape[1]), right)
        return np.asarray(closing + N @ free, float)

    def _squeeze(self) -> Array:
        h = np.zeros(self._hands.size)
        if self._settings.squeeze:
            e = section(self._hands.points[0], self._hands.points[1]).axes[0]
            h[:3], h[6:9] = self._settings.squeeze * e, -self._settings.squeeze * e
        return h

    def _freed(self, split: Split, tau: Array) -> Array:
        """The internal wrench that frees passive joints of torque, the least one."""
        passive = self.problem.chain.passive
        if not len(passive):
            return np.zeros(self._hands.size)
        P = split.projector
        return np.asarray(P @ least_squares(self._hands.to_tau[passive] @ P, -tau[passive]), float)

    def hold_still(self, state: State) -> None:
        assert self.command.tau is not None
        self.command.tau[:] = self._level.holding(state, self._settings.damping_time)
