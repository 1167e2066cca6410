"""Tasks in accelerations and the tree's torques, shared by the torque controllers.

A task e(q, t) with e_dot = J v - rate has e_ddot = J a + drift, where drift is the change of
J v - rate along v, by a forward difference of the task, so that a task needs no second derivative.

Task rows with an impedance have accelerations e_ddot = B (w - K e) - R e_dot.
Rows with a stated mass M have B = M^-1; w has to be known there. All others have the inertia of
object and arms with the loops closed, B = W = J N (N' A N)^-1 N' J', through which an unknown
wrench acts as well: with w = 0 in the law they move as above.

R = B D where the damping is stated, and else gives every mode its damping ratio z. With
S = K^1/2 the modes are those of C = S W S, and

    R = 2 S^-1 C^1/4 z C^1/4 S         (M stated: 2 z (K/M)^1/2)

which is the double diagonalisation of Albu-Schaeffer, Ott, Frese and Hirzinger 2003.

A law that corrects open loops asks for accelerations J_c a = -drift_c - c that closed ones do not
have. Torques for a then produce a + d, with J_c d = c and N' A d = 0, and J d would appear as a
push: it is subtracted.
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from coopqp.base.errors import GraspError, InvalidValueError
from coopqp.base.rank import independent_rows, least_squares
from coopqp.base.spec import Array
from coopqp.closed_loop.dynamics import ClosedLoopDynamics
from coopqp.closed_loop.mobility import mobility
from coopqp.closed_loop.screw import LENGTH
from coopqp.controller import ControlProblem
from coopqp.model.closed_chain import AXES, ClosedChain
from coopqp.model.state import State
from coopqp.signal import Trajectory
from coopqp.task import Impedance, TaskStack
from coopqp.torque_law.margins import DELAY, MIN_DAMPING, spring_damping

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
        self.gains = self.tasks.gains
        self.e_dot, self.drift = np.zeros_like(self.tasks.e), np.zeros_like(self.tasks.e)
        self._ahead = State(problem.chain)
        self._effort = problem.chain.model.effortLimit

    def update(self, state: State) -> None:
        ahead, tasks, v = self._ahead, self.tasks, state.v
        ahead.q[:], ahead.t = state.q + STEP * v, state.t + STEP
        for name, now in state.inputs.items():
            later = ahead.inputs.setdefault(name, Trajectory(now.kind, now.value))
            later.value[:], later.rate[:] = now.after(STEP), now.rate
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
        """N (N' A N)^-1 N', accelerations of the joints per torque on them, shape (n, n)."""
        N = self.dynamics.null_space()
        return np.asarray(N @ np.linalg.solve(N.T @ self.dynamics.A @ N, N.T), float)


def _of_free_arms(chain: ClosedChain, tasks: TaskStack) -> str:
    """Which tasks move arms that do not hold the object."""
    free = {joint for arm in chain.arms[chain.holding :] for joint in chain.robot.arm_joints(arm)}
    own = [name in free for name in chain.joint_names]
    parts = zip(tasks.tasks, tasks.slices, strict=True)
    moved = [f"'{task.name}'" for task, part in parts if tasks.J[part][:, own].any()]
    return (
        f"{' and '.join(moved) or 'a task'} moves an arm that does not hold the object, which this "
        "law cannot be asked for beside all of the object; leave it out, or use torque_qp or qp"
    )


def require_motor_freedom(problem: ControlProblem, controller: str, *, free: bool = False) -> None:
    """GraspError with what motors cannot decide of the tasks; free arms may have some if free."""
    chain, start = problem.chain, State(problem.chain)
    if chain.standing and not free:
        raise GraspError(
            f"{controller}: no arm holds the object in one of the phases, and this law moves hands "
            "by the object alone; use torque_qp, or one that commands velocities, such as qp"
        )
    tasks = TaskStack([task for task in problem.tasks if not task.joint_space], start)
    tasks.update(start)
    if free and len(chain.hold.holders) < len(chain.robot.arms):
        level = TaskDynamics(problem)
        level.update(start)
        moved = tasks.J @ level.inverse_inertia()[:, level.dynamics.actuated]
        decided = len(independent_rows(moved))
        if decided == len(moved):
            return
        if chain.standing:
            raise GraspError(
                f"{controller}: the tasks ask {len(moved)} rows of free arms, and the motors "
                f"decide only {decided} of them independently; leave out rows, or use qp"
            )
    found = mobility(problem.chain, task_rows=[("all", tasks.J)], samples=1)
    missing = [screw.describe() for screw in (*found.impossible, *found.uncontrolled)]
    rows = len(tasks.e)
    if rows > found.motor_freedom_start or found.tasks_rank < rows:
        why = f"missing: {'; '.join(missing)}"
        if not missing and found.tasks_rank < rows:
            why = (
                f"only {found.tasks_rank} of the rows are independent, and those of all tasks have "
                "to be, hard and soft ones at whatever priority; leave out rows that others decide"
            )
        elif not missing:
            why = _of_free_arms(chain, tasks)
        raise GraspError(
            f"{controller}: the tasks ask {rows} rows, but with this grasp the motors decide only "
            f"{found.motor_freedom_start} object motions; {why}"
        )


class Impedances:
    """All rows of one problem that have an impedance, r of them.

    Attributes:
        rows: which of all task rows, shape (r,); the rest are ``others``.
        B, R: acceleration by a wrench on the rows, by their rate, shape (r, r) [1/kg, ...], [1/s].
        K: stiffness, shape (r,) [N/m, N m/rad]. stated: which have a stated mass, shape (r,).
    """

    def __init__(self, problem: ControlProblem, level: TaskDynamics) -> None:
        stack = level.tasks
        given = [
            (np.arange(part.start, part.stop), impedance)
            for task, part in zip(stack.tasks, stack.slices, strict=True)
            if (impedance := task.impedance) is not None
        ]

        def by_row(value: Callable[[Impedance], ArrayLike]) -> Array:
            values = (np.broadcast_to(value(i), len(i.axes)) for _, i in given)
            return np.concatenate([np.zeros(0), *values])

        self.rows = np.concatenate([np.zeros(0, int), *(rows for rows, _ in given)])
        self.others = np.setdiff1d(np.arange(len(stack.e)), self.rows)
        self._axes = by_row(lambda i: i.axes).astype(int)
        self.K = by_row(lambda i: i.stiffness)
        self.stated = by_row(lambda i: i.mass is not None).astype(bool)
        masses = by_row(lambda i: 1.0 if i.mass is None else i.mass)
        self._D = by_row(lambda i: 0.0 if i.damping is None else i.damping)
        self._z = by_row(lambda i: i.damping_ratio if i.damping is None else 0.0)
        self._level = level
        self.B, self.R = np.zeros((2, len(self.rows), len(self.rows)))
        self._X = np.zeros((len(stack.J.T), len(stack.J.T)))
        own, M = np.flatnonzero(self.stated), masses[self.stated]  # their entries are constant
        omega = np.sqrt(self.K[own] / M)
        self.B[own, own] = 1.0 / M
        self.R[own, own] = self._D[own] / M + 2.0 * self._z[own] * omega

    def update(self) -> None:
        if not len(self.rows):
            return
        self._X = self._level.inverse_inertia()
        real = np.flatnonzero(~self.stated)
        if not len(real):
            return
        J = self._level.tasks.J[self.rows[real]]
        W, S = J @ self._X @ J.T, np.sqrt(self.K[real])
        squares, U = np.linalg.eigh(S[:, None] * W * S)
        root = (U * np.maximum(squares, 0.0) ** 0.25) @ U.T
        R = 2.0 * (root * self._z[real]) @ root * S / S[:, None] + W * self._D[real]
        self.B[np.ix_(real, real)], self.R[np.ix_(real, real)] = W, R

    def guess(self) -> Array | None:
        """The external wrench where it is unknown, shape (6,): equal to the springs' forces.

        None without rows. At rest that is so, and the hands bear it; until then it does not change
        the torques' effect, since the springs pull against it by as much.
        """
        if not len(self.rows):
            return None
        wrench = np.zeros(6)
        np.add.at(wrench, self._axes, self.K * self._level.tasks.e[self.rows])
        return wrench

    def accelerations(self, wrench: Array, correction: Array) -> Array:
        """e_ddot of the rows that torques must produce, shape (r,).

        ``wrench``, shape (6,), is of the surroundings on the object, or the :meth:`guess`;
        ``correction``, shape (m,), is c of the loop rows.
        """
        level, rows = self._level, self.rows
        found = self.B.dot(wrench[self._axes] - self.K * level.tasks.e[rows])
        found -= self.R.dot(level.e_dot[rows])
        if correction.any():
            d = least_squares(level.dynamics.J, correction)
            found -= level.tasks.J[rows].dot(d - self._X.dot(level.dynamics.A.dot(d)))
        return np.asarray(found, float)


def require_impedances(
    problem: ControlProblem, level: TaskDynamics, name: str, *, knows_wrench: bool
) -> None:
    """Refuse masses where the external wrench is unknown, and springs that oscillate."""
    impedances = Impedances(problem, level)
    if not len(impedances.rows):
        return
    tasks = [task.name for task in problem.tasks if task.impedance is not None]
    which = f"{name}: task {' and '.join(tasks)}"
    if impedances.stated.any() and not knows_wrench:
        raise InvalidValueError(
            f"{which} states a mass, which needs the external wrench; say "
            "external_wrench: observed, or leave mass out for the inertia of object and arms"
        )
    level.update(State(problem.chain))
    impedances.update()
    C, R, dt = impedances.B * impedances.K, impedances.R, problem.dt
    stated, found = spring_damping(C, R, dt, None), spring_damping(C, R, dt, DELAY)
    if found < (needed := min(MIN_DAMPING, 0.5 * stated)):
        at_least = f"{needed:.2f}" if needed >= 5e-3 else "more than 0"  # where none was asked for
        raise InvalidValueError(
            f"{which} oscillates at dt {1e3 * dt:g} ms when commands are a tick late (damping "
            f"ratio {found:.2f}, needs {at_least}); lower stiffness and damping, or dt, "
            "or state more mass"
        )


def leaks(problem: ControlProblem) -> tuple[str, str, float] | None:
    """The largest cross-coupling of a push along an axis without a spring into a sprung axis.

    At rest, with an unknown push, object and arms must not accelerate along the springs: with W the
    inverse inertia of the object's six axes, s those with a spring and o the others,

        W_ss (w_s - K e) + W_so w_o = 0,       so that K e = w_s + W_ss^-1 W_so w_o

    Returns:
        The axis along which it is felt, that along which it pushes, and the force felt of a push by
        1 N or 1 N m [N, N m]; None where all axes have a spring, none has, or one cannot move.
    """
    given = [task.impedance for task in problem.tasks if task.impedance is not None]
    sprung = sorted({axis for impedance in given for axis in impedance.axes})
    others = [axis for axis in range(6) if axis not in sprung]
    massless = not any(body.mass for body in problem.chain.robot.model.inertias)
    if not sprung or not others or massless:
        return None
    level, state = TaskDynamics(problem), State(problem.chain)
    state.update()
    level.update(state)
    W = state.J_task @ level.inverse_inertia() @ state.J_task.T
    own = W[np.ix_(sprung, sprung)]
    if np.linalg.matrix_rank(own) < len(sprung):
        return None  # an axis that cannot move; laws refuse that
    coupling = np.linalg.solve(own, W[np.ix_(sprung, others)])
    lengths = np.array([1.0 if axis < 3 else LENGTH for axis in range(6)])
    share = np.abs(coupling) * lengths[others] / lengths[sprung][:, None]
    i, j = np.unravel_index(int(share.argmax()), share.shape)
    return AXES[sprung[i]], AXES[others[j]], float(coupling[i, j])
