"""Quantities of each instant of a run: the object, the loops, and the errors of the tasks.

On plants without errors and with no inputs, all of it follows from t, q and v, and is computed for
the whole run at its end (``TrajectoryEvaluation``). Else the plant's truth is read at each instant.
"""

import itertools
from collections.abc import Sequence

import numpy as np
import pinocchio as pin

from coopqp.assessment.thresholds import within
from coopqp.base.rank import null_space
from coopqp.base.spec import Array
from coopqp.base.wording import suppressed
from coopqp.closed_loop.hands import WrenchStack, robot_indices
from coopqp.controller import ControlProblem
from coopqp.kernel.trajectory_evaluation import TrajectoryEvaluation, joint_points, survey
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.state import State
from coopqp.plant import PlantModel
from coopqp.signal import InputValues
from coopqp.task import Task, TaskStack
from coopqp.trace import TaskInfo

NOTHING = 1e-12  # missed, or possible [m, rad; m/rad]


class Instants:
    """Arrays for all instants of a run of T ticks from a start.

    ``alone`` says that no inputs arrive.

    Attributes:
        at_end: whether all is computed when the run has ended, by :meth:`follow`.
        parts: info of each part of each task, and its rows.
        position, rotation, loop, task_error, goal_error, e, rate, points: as in the trace; ``loop``
            has both errors.
    """

    def __init__(
        self, problem: ControlProblem, plant: PlantModel, start: State, ticks: int, *, alone: bool
    ) -> None:
        self._problem, self._plant, rows = problem, plant, ticks + 1
        chain = problem.chain
        self.parts = parts_of((*problem.tasks, *problem.wrenches), chain)
        asking = [task for task in problem.tasks for _ in task.parts(chain)]
        self._velocities = [i for i, task in enumerate(asking) if task.asks_velocity]
        self._begin = _beginning(problem, start)
        self._goals = [task.at_goal() for task in problem.tasks]
        self._evaluation: TrajectoryEvaluation | None = None
        self.points: dict[str, Array] = {}
        if alone and plant.ideal and not problem.wrenches:
            points = itertools.chain.from_iterable(chain.once(joint_points).values())
            tasks = (*problem.tasks, *self._goals)
            self._evaluation = survey(chain, tasks, self._begin, tuple(points))
        self.at_end = self._evaluation is not None
        if self.at_end:
            return
        self.position, self.rotation = np.zeros((rows, 3)), np.zeros((rows, 3, 3))
        self.loop = np.zeros((rows, 2))
        self.task_error, self.goal_error = np.zeros((2, rows, len(self.parts)))
        # Its own stacks, so that a controller without tasks inside is measured alike.
        # Starts of their own: a task may keep its arrays.
        stacks = [
            TaskStack(tasks, _beginning(problem, start)) for tasks in (problem.tasks, self._goals)
        ]
        self._stacks = tuple(zip(stacks, (self.task_error, self.goal_error), strict=True))
        self._wrenches = WrenchStack(problem.wrenches, _beginning(problem, start))
        self._hand_wrench = plant.signals.get("hand_wrench")
        wanted = len(stacks[0].e) + len(self._wrenches.wanted)
        self.e, self.rate = np.full((2, rows, wanted), np.nan)

    def keep(self, k: int, true: State) -> None:
        """Record the instant before tick k, which is the result of tick k - 1."""
        if self.at_end:
            return
        for i in self._velocities if k else ():  # of the step of tick k - 1
            part = self.parts[i][1]
            for stack, error in self._stacks:
                error[k, i] = np.linalg.norm(stack.J[part].dot(true.v) - stack.rate[part])
        self.position[k], self.rotation[k] = true.p_WO, true.R_WO
        self.loop[k] = true.loop_position_error, true.loop_orientation_error
        for stack, error in self._stacks:
            if not _updated(stack, true):
                error[k] = np.nan
                continue
            motion = len(stack.e)
            for i, (_, part) in enumerate(self.parts):
                if i not in self._velocities and part.stop <= motion:
                    error[k, i] = np.linalg.norm(stack.e[part])
            if error is self.task_error:
                self.e[k, :motion], self.rate[k, :motion] = stack.e, stack.rate
        self._wrench_errors(k, true)

    def _wrench_errors(self, k: int, true: State) -> None:
        """Errors of the hands' wrenches; unknown before the first tick."""
        stack, motion = self._wrenches, len(self._stacks[0][0].e)
        if not len(stack.wanted):
            return
        if _updated(stack, true) and k and self._hand_wrench is not None:
            by_hand = self._hand_wrench.reshape(-1, 6)[robot_indices(self._problem.chain)]
            self.e[k, motion:] = stack.error(by_hand)
        self.rate[k, motion:] = 0.0
        for i, (_, part) in enumerate(self.parts):
            if part.start >= motion:
                self.task_error[k, i] = self.goal_error[k, i] = np.linalg.norm(self.e[k, part])

    def follow(self, t: Array, q: Array, v: Array, offset: Array) -> None:
        """Compute all of it after the run, from t (T + 1,), q (T + 1, n) and v (T, n).

        ``offset`` of the closed loops, shape (6 L,) [m, rad], has not changed.
        """
        chain = self._problem.chain
        if self._evaluation is None:
            self.points = arm_points(chain, q)
            return
        evaluated = self._evaluation.look(t, q, v if self._velocities else None)
        self.position, self.rotation = evaluated.position, evaluated.rotation
        apart = evaluated.loop_error[:, : len(offset)] - offset
        sizes = np.linalg.norm(apart.reshape(len(t), -1, 2, 3), axis=3)
        self.loop = sizes.max(axis=1, initial=0.0)
        rows = evaluated.e.shape[1] // 2
        self.task_error, self.goal_error = np.zeros((2, len(t), len(self.parts)))
        for error, first in ((self.task_error, 0), (self.goal_error, rows)):
            for i, (_, part) in enumerate(self.parts):
                own = slice(first + part.start, first + part.stop)
                if i not in self._velocities:
                    error[:, i] = np.linalg.norm(evaluated.e[:, own], axis=1)
                elif evaluated.moved is not None:
                    missed = evaluated.moved[:, own] - evaluated.rate[:-1, own]
                    error[1:, i] = np.linalg.norm(missed, axis=1)
        self.e, self.rate = evaluated.e[:, :rows], evaluated.rate[:, :rows]
        self.points, at = {}, 0
        for arm, points in chain.once(joint_points).items():
            self.points[arm] = evaluated.points[:, at : at + len(points)]
            at += len(points)

    def directional_manipulability(
        self, t: float, q: Array, v: Array, inputs: InputValues
    ) -> Array:
        """Directional manipulability of each part's error at the end over that at the start.

        With N a basis of the joint motions that keep the loops closed, J the rows of a task and u
        the direction of its error, a unit of joint motion moves at most |N' J' u| along it. Where
        that has all but vanished, the pose is singular in that direction: the arms are stretched,
        and no limit is to blame.

        ``t`` and ``v`` are of the end, ``q`` of start and end. The result, shape (K,), is 1 where
        nothing is missed or nothing could be done at the start.
        """
        ratios = np.ones(len(self.parts))
        parts = zip(self.task_error[-1], self.parts, strict=True)
        good = all(within(error, info.tolerance) for error, (info, _) in parts)
        if good or not np.isfinite(q).all():
            return ratios
        start, end = (State(self._problem.chain, each, t) for each in q)
        start.inputs = end.inputs = inputs
        end.v[:] = v
        tasks = TaskStack(self._problem.tasks, self._begin) if self.at_end else self._stacks[0][0]
        with suppressed():  # a tick that met the same error names it
            tasks.update(start)
            J_before = tasks.J @ null_space(start.J_loop)
            tasks.update(end)
            J_now = tasks.J @ null_space(end.J_loop)
            for i, (_, part) in enumerate(self.parts):
                slow = i in self._velocities
                missed = tasks.rate[part] - tasks.J[part] @ end.v if slow else tasks.e[part]
                could = float(np.linalg.norm(missed @ J_before[part]))
                if could > NOTHING:
                    ratios[i] = float(np.linalg.norm(missed @ J_now[part])) / could
        return ratios


def _updated(stack: TaskStack, true: State) -> bool:
    """Whether all tasks could be evaluated; the tick that met the same error names it."""
    with suppressed():
        stack.update(true)
        return True
    return False


def _beginning(problem: ControlProblem, start: State) -> State:
    """The state from which references begin, in arrays of its own."""
    begin = State(problem.chain, start.q, start.t)
    begin.inputs = start.inputs
    return begin


def parts_of(tasks: Sequence[Task], chain: ClosedChain) -> list[tuple[TaskInfo, slice]]:
    """Trace info of each part of each task, and its rows in the stack."""
    parts, at = [], 0
    for task in tasks:
        first, impedance = at, task.impedance
        pairs = zip(impedance.axes, impedance.stiffness.tolist(), strict=True) if impedance else ()
        springs = tuple((row, *pair) for row, pair in enumerate(pairs))
        for part in task.parts(chain):
            name = f"{task.name}.{part.name}" if part.name else task.name
            info = TaskInfo(
                name, part.unit, part.tolerance, task.end,
                springs=springs[at - first : at - first + part.rows],
                mode=task.mode, priority=task.priority,
            )  # fmt: skip
            parts.append((info, slice(at, at + part.rows)))
            at += part.rows
    return parts


def rows_of(tasks: Sequence[Task], chain: ClosedChain) -> tuple[str, ...]:
    """What the rows of all tasks are called."""
    return tuple(f"{task.name}.{row}" for task in tasks for row in task.rows(chain))


def arm_points(chain: ClosedChain, q: Array) -> dict[str, Array]:
    """Joint origins and hand of each arm, base first, shape (T, p, 3) [m], at q (T, n)."""
    model, data, own = chain.model, chain.model.createData(), chain.once(joint_points)
    points = {arm: np.zeros((len(q), len(places), 3)) for arm, places in own.items()}
    for k, row in enumerate(q):
        pin.forwardKinematics(model, data, row)
        for arm, places in own.items():
            points[arm][k] = [data.oMi[joint].act(p) for joint, p in places]
    return points
