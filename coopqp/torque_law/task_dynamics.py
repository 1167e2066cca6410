"""Tasks in accelerations and the tree's torques, shared by the torque controllers.

A task e(q, t) with e_dot = J v - rate has e_ddot = J a + drift, where drift is the change of
J v - rate along v, by a forward difference of the task, so that a task needs no second derivative.
"""

from __future__ import annotations

import numpy as np

from coopqp.base.errors import GraspError
from coopqp.base.spec import Array
from coopqp.closed_loop.dynamics import ClosedLoopDynamics
from coopqp.closed_loop.mobility import mobility
from coopqp.controller import ControlProblem
from coopqp.model.state import State
from coopqp.signal import CLOCK, Trajectory
from coopqp.task import TaskStack

#: Step of the forward difference [s]: its error is this times a second derivative.
STEP = 1e-6


class TaskDynamics:
    """Tasks and tree of one problem, for control by torques.

    Attributes:
        dynamics: of the modelled object.
        tasks: e, J, rate as of the last update.
        gains: of the task rows, shape (k,) [1/s].
        e_dot: J v - rate, and drift: e_ddot - J a, shape (k,).
    """

    def __init__(self, problem: ControlProblem) -> None:
        start = State(problem.chain)
        self.dynamics = ClosedLoopDynamics(problem.chain)
        self.tasks = TaskStack(problem.tasks, start)
        self.gains = np.repeat([float(task.gain) for task in problem.tasks], self.tasks.sizes)
        self.e_dot, self.drift = np.zeros_like(self.tasks.e), np.zeros_like(self.tasks.e)
        self._ahead = State(problem.chain)
        self._effort = problem.chain.model.effortLimit

    def update(self, state: State) -> None:
        ahead, tasks, v = self._ahead, self.tasks, state.v
        ahead.q[:], ahead.t = state.q + STEP * v, state.t + STEP
        for name, clock in state.inputs.items():
            if clock.kind == CLOCK:
                later = ahead.inputs.setdefault(name, Trajectory(CLOCK, clock.value))
                later.value[:], later.rate[:] = clock.value + STEP * clock.rate, clock.rate
        ahead.update()
        tasks.update(ahead)
        e_dot_ahead = tasks.J.dot(v) - tasks.rate
        tasks.update(state)
        self.e_dot = tasks.J.dot(v) - tasks.rate
        self.drift = (e_dot_ahead - self.e_dot) / STEP
        self.dynamics.update(state.q, v)

    def holding(self, state: State, brake_time: float) -> Array:
        """Gravity compensation and a brake over ``brake_time`` [s], within effort limits [N m]."""
        dynamics = self.dynamics
        dynamics.update(state.q, state.v)
        brake = dynamics.A.dot(state.v) / brake_time
        tau = dynamics.distribute(dynamics.gravity(state.q) - brake).tau
        return np.asarray(np.minimum(np.maximum(tau, -self._effort), self._effort), float)

    def inverse_inertia(self) -> Array:
        """Acceleration of the joints per torque on them, the loops closed, shape (n, n).

        X = N (N' A N)^-1 N', with N as in :meth:`ClosedLoopDynamics.null_space`.
        """
        N = self.dynamics.null_space()
        return np.asarray(N @ np.linalg.solve(N.T @ self.dynamics.A @ N, N.T), float)


def _of_free_arms(problem: ControlProblem, tasks: TaskStack) -> str:
    """Which tasks move arms that do not hold the object."""
    chain = problem.chain
    free = [
        chain.joint_names.index(joint)
        for arm in chain.arms[chain.holding :]
        for joint in chain.robot.arm_joints(arm)
    ]
    moved = [
        f"'{task.name}'"
        for task, part in zip(tasks.tasks, tasks.slices, strict=True)
        if tasks.J[part][:, free].any()
    ]
    return (
        f"{' and '.join(moved) or 'a task'} moves an arm that does not hold the object, which laws "
        "by torques cannot be asked for beside all of the object; leave it out, or use qp"
    )


def require_motor_freedom(problem: ControlProblem, controller: str) -> None:
    """GraspError with the missing object motions: tasks that the motors cannot decide."""
    start = State(problem.chain)
    if problem.chain.standing:
        raise GraspError(
            f"{controller}: no arm holds the object in one of the phases, and this law moves hands "
            "by the object alone; use one that commands velocities, such as qp"
        )
    tasks = TaskStack([task for task in problem.tasks if not task.joint_space], start)
    tasks.update(start)
    found = mobility(problem.chain, task_rows=[("all", tasks.J)], samples=1)
    missing = [screw.words() for screw in (*found.impossible, *found.uncontrolled)]
    rows = len(tasks.e)
    if rows > found.motor_freedom_start or found.tasks_rank < rows:
        why = f"missing: {'; '.join(missing)}"
        if not missing and found.tasks_rank < rows:
            why = (
                f"only {found.tasks_rank} of the rows are independent, and those of all tasks have "
                "to be, hard and soft ones at whatever priority; leave out rows that others decide"
            )
        elif not missing:
            why = _of_free_arms(problem, tasks)
        raise GraspError(
            f"{controller}: the tasks ask {rows} rows, but with this grasp the motors decide only "
            f"{found.motor_freedom_start} object motions; {why}"
        )
