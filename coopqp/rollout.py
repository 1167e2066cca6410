"""The control loop: state, tick, plant, trace. The only place with a clock."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Sequence

import numpy as np
import pinocchio as pin

from coopqp.checked import Array
from coopqp.closed_chain import ClosedChain
from coopqp.closed_loop.leverage import leverage
from coopqp.closed_loop.wrench_stack import WrenchStack
from coopqp.controller import HEEDS_NOTHING, Command, ControlProblem, Heeds, Law
from coopqp.input import Sender
from coopqp.plant import PlantModel
from coopqp.plants._guarded import GuardedPlant
from coopqp.row import Row
from coopqp.solver import Status, written
from coopqp.state import State
from coopqp.task import Task, TaskStack
from coopqp.task_end import TaskInfo
from coopqp.trace import Failure, Trace, no_input
from coopqp.wording import suppressed

Progress = Callable[[int], None]
"""Called now and then with the number of ticks done."""

PROGRESS_EVERY = 50  # ticks


def rollout(
    law: Law,
    plant: PlantModel,
    ticks: int,
    *,
    controller: str,
    solver: str | None,
    heeds: Heeds = HEEDS_NOTHING,
    progress: Progress | None = None,
    state: State | None = None,
    feed: Sender | None = None,
) -> Trace:
    """Run a law on a plant.

    Args:
        law: the controller, built.
        plant: at the start.
        ticks: how many.
        controller: its name, for the trace.
        solver: its name, for the trace.
        heeds: what of the problem the law reads, for the trace.
        progress: called every few ticks.
        state: where it begins, of the law's own start; written, so that it is where it ends. At
            rest where the plant's sensors say when omitted.
        feed: who sends to the inputs; nothing arrives when omitted.

    Returns:
        All that happened.
    """
    if state is None:
        state = law.start(q_measured=plant.measured, hand_wrench=plant.hand_wrench)
    guarded = GuardedPlant(plant)
    recorder = _Recorder(law, guarded, state, ticks)
    for k, (command, us) in enumerate(drive(law, guarded, state, ticks, feed)):
        recorder.instant(k, state)
        recorder.tick(k, command, us, state)
        if progress and k % PROGRESS_EVERY == 0:
            progress(k)
    recorder.instant(ticks, state)
    if progress:
        progress(ticks)
    return recorder.trace(controller, solver, heeds)


def drive(
    law: Law,
    plant: PlantModel,
    state: State,
    ticks: int | Iterable[object],
    feed: Sender | None = None,
) -> Iterator[tuple[Command, float]]:
    """The control loop: take what has arrived, decide, hand over the command, let the plant move.

    Args:
        law: the controller, built.
        plant: where the state is.
        state: written; after the last step its kinematics are up to date.
        ticks: how many, or as many as there are items.
        feed: who sends to the inputs; nothing arrives when omitted.

    Yields:
        The command and how long the tick took [us], before the plant carries it out.
    """
    guarded = plant if isinstance(plant, GuardedPlant) else GuardedPlant(plant)
    for _ in range(ticks) if isinstance(ticks, int) else ticks:
        if feed:
            feed.step(state)
        before = time.perf_counter_ns()
        broken = guarded.broken
        command = law.refuse(guarded.why, broken) if broken else law.tick(state)
        yield command, 1e-3 * (time.perf_counter_ns() - before)
        guarded.step(state, command)
        if guarded.broken:
            state.t += law.problem.dt
    if feed:
        feed.step(state)
    state.update()


class _MeasuredWrenches:
    """What tasks ask of the hands' wrenches, against what the plant tells of them.

    Args:
        problem: with the tasks.
        start: the state from which their references set out.
        plant: that tells ``hand_wrench``.
    """

    def __init__(self, problem: ControlProblem, start: State, plant: PlantModel) -> None:
        begin = State(problem.chain, start.q, start.t)
        begin.inputs = start.inputs
        self.stack = WrenchStack(problem.wrenches, begin)
        chain = problem.chain
        robot = [arm.name for arm in chain.robot.arms]
        self._at = [robot.index(arm.name) for arm in chain.arms[: chain.holding]]
        self._told = plant.signals.get("hand_wrench")

    def error(self, true: State) -> Array:
        """C h - wanted of each row; NaN where the plant tells no forces."""
        try:
            self.stack.update(true)
        except KeyboardInterrupt:
            raise
        except BaseException:  # noqa: BLE001 - the tick, which met the same error, names it
            return np.full(len(self.stack.wanted), np.nan)
        if self._told is None:
            return np.full(len(self.stack.wanted), np.nan)
        return self.stack.error(self._told.reshape(-1, 6)[self._at])


class _Recorder:
    """Arrays for one run, filled tick by tick."""

    def __init__(self, law: Law, plant: PlantModel, start: State, ticks: int) -> None:
        problem = law.problem
        n, rows = problem.chain.n, ticks + 1
        self._law, self._plant = law, plant
        # Its own stacks, so that a controller without tasks inside is measured alike.
        # Starts of their own: a task may keep its arrays.
        stacks = []
        for tasks in (problem.tasks, [task.at_goal() for task in problem.tasks]):
            begin = State(problem.chain, start.q, start.t)
            begin.inputs = start.inputs
            stacks.append(TaskStack(tasks, begin))
        self.t, self.q, self.v = np.zeros(rows), np.zeros((rows, n)), np.zeros((ticks, n))
        self.position, self.rotation = np.zeros((rows, 3)), np.zeros((rows, 3, 3))
        self.loop = np.zeros((rows, 2))
        self.commanded, self.gap = np.zeros((ticks, n)), np.zeros((ticks, len(start.gap)))
        self.measured = np.full((ticks, n), np.nan)
        self.memory = np.zeros((ticks, sum(law.memory_sizes.values())))
        self._remembered = start.memory.numbers.copy()
        self._parts = _parts((*problem.tasks, *problem.wrenches), problem.chain)
        self._wrenches = _MeasuredWrenches(problem, start, plant)
        asking = [task for task in problem.tasks for _ in task.parts(problem.chain)]
        self._velocities = [i for i, task in enumerate(asking) if task.asks_velocity]
        self.task_error, self.goal_error = np.zeros((2, rows, len(self._parts)))
        self._stacks = tuple(zip(stacks, (self.task_error, self.goal_error), strict=True))
        asked = len(stacks[0].e) + len(self._wrenches.stack.wanted)
        self.e, self.rate = np.full((2, rows, asked), np.nan)
        self.tick_us, self.compiled = np.zeros(ticks), np.zeros(ticks, bool)
        self.usable = np.ones(ticks, bool)
        self.inaccurate = np.zeros(ticks, bool)
        self.status = [Status.OPTIMAL.name] * ticks
        self.scale = np.ones(ticks)
        self.inputs = {n: no_input(c.kind, ticks) for n, c in start.inputs.items()}
        self.failures: list[Failure] = []
        self.signals = {
            name: np.zeros((ticks, *signal.shape)) for name, signal in plant.signals.items()
        }

    def instant(self, k: int, state: State) -> None:
        """Keep what tick k - 1 has led to, which is the state before tick k."""
        true = self._plant.truth(state)
        true.inputs = state.inputs
        if k:
            self._close(k - 1, true.v)
        self._inputs_at_end = state.inputs
        self.t[k], self.q[k] = state.t, true.q
        self.position[k], self.rotation[k] = true.p_WO, true.R_WO
        self.loop[k] = true.loop_position_error, true.loop_orientation_error
        for stack, error in self._stacks:
            try:
                stack.update(true)
            except KeyboardInterrupt:
                raise
            except BaseException:  # noqa: BLE001 - the tick, which met the same error, names it
                error[k] = np.nan
                continue
            motion = len(stack.e)
            for i, (_, part) in enumerate(self._parts):
                if i not in self._velocities and part.stop <= motion:
                    error[k, i] = np.linalg.norm(stack.e[part])
            if error is self.task_error:
                self.e[k, :motion], self.rate[k, :motion] = stack.e, stack.rate
        self._wrench_errors(k, true)

    def _wrench_errors(self, k: int, true: State) -> None:
        """How far the hands' wrenches are from what is wanted; nobody knows before the first."""
        told, motion = self._wrenches, len(self._stacks[0][0].e)
        if not len(told.stack.wanted):
            return
        self.e[k, motion:] = told.error(true) if k else np.nan
        self.rate[k, motion:] = 0.0
        for i, (_, part) in enumerate(self._parts):
            if part.start >= motion:
                self.task_error[k, i] = self.goal_error[k, i] = np.linalg.norm(self.e[k, part])

    def _close(self, k: int, v: Array) -> None:
        """Keep what only shows after the step of tick k."""
        if self._law.command.tau is not None:
            self.v[k] = v
        for i in self._velocities:  # how far it missed the velocities that tasks ask for
            part = self._parts[i][1]
            for stack, error in self._stacks:
                error[k + 1, i] = np.linalg.norm(stack.J[part].dot(v) - stack.rate[part])
        for name, signal in self._plant.signals.items():
            self.signals[name][k] = signal

    def tick(self, k: int, command: Command, us: float, state: State) -> None:
        """Keep what the law decided in tick k, and from what."""
        closed = len(state.closed_error)
        self.commanded[k], self.gap[k, :closed] = state.q, state.gap[:closed]
        measured = state.q if command.tau is not None else state.q_measured
        if measured is not None:
            self.measured[k] = measured
        self.memory[k], self._remembered = self._remembered, state.memory.numbers.copy()
        self.v[k], self.tick_us[k], self.scale[k] = command.v, us, command.scale
        self.compiled[k] = self._law.compiled
        for name, kept in self.inputs.items():
            followed = state.inputs[name]
            kept.value[k], kept.rate[k] = followed.value, followed.rate
            if name in state.inputs.arrived:
                kept.sent[k], kept.arrived[k] = state.inputs.arrived[name]
        if command.causes != (Status.OPTIMAL,):
            self._note(k, command)

    def _note(self, k: int, command: Command) -> None:
        """Keep why tick k is not optimal."""
        status = command.status
        self.status[k] = written(command.causes)
        if status is Status.INACCURATE:
            self.inaccurate[k] = True
        elif not status.usable:
            self.usable[k] = False
            self.failures.append(Failure(k, status.value, command.note))

    def _margins(self, q: Array, v: Array) -> dict[Row, Array]:
        """What every limit had left after each tick."""
        problem = self._law.problem
        found: dict[Row, Array] = {}
        for limit in problem.limits:
            with suppressed():  # a tick that met the same error names it
                found |= limit.margins(problem.chain, q, v, problem.dt)
        return found

    def _starts(self) -> dict[Row, float]:
        """What it had left before the first."""
        found = self._margins(self.q[[0, 0]], np.zeros_like(self.q[:1]))
        return {row: float(margin[0]) for row, margin in found.items()}

    def _leverage(self) -> Array:
        """How much of what is missed can still be brought about, over the start's; shape (K,)."""
        chain = self._law.problem.chain
        start, end = (State(chain, q, self.t[-1]) for q in self.q[[0, -1]])
        start.inputs = end.inputs = self._inputs_at_end
        end.v[:] = self.v[-1] if len(self.v) else 0.0
        parts = [part for _, part in self._parts]
        with suppressed():  # a tick that met the same error names it
            return leverage(self._stacks[0][0], parts, self._velocities, start, end)
        return np.ones(len(parts))

    def trace(self, controller: str, solver: str | None, heeds: Heeds) -> Trace:
        """Everything recorded, frozen."""
        problem = self._law.problem
        chain = problem.chain
        return Trace(
            controller=controller,
            solver=solver,
            engine=self._law.engine,
            dt=problem.dt,
            kappa=problem.kappa,
            joints=chain.joint_names,
            units=chain.joint_units,
            lower=chain.lower,
            upper=chain.upper,
            velocity=chain.velocity,
            effort=chain.model.effortLimit.copy(),
            tasks=tuple(info for info, _ in self._parts),
            t=self.t,
            q=self.q,
            v=self.v,
            commanded=self.commanded,
            measured=self.measured,
            gap=self.gap,
            memory=self.memory,
            position=self.position,
            rotation=self.rotation,
            loop_position=self.loop[:, 0],
            loop_orientation=self.loop[:, 1],
            task_error=self.task_error,
            leverage=self._leverage(),
            goal_error=self.goal_error,
            task_rows=_task_rows((*problem.tasks, *problem.wrenches), chain),
            e=self.e,
            rate=self.rate,
            usable=self.usable,
            inaccurate=self.inaccurate,
            status=tuple(self.status),
            scale=self.scale,
            margins=self._margins(self.q, self.v),
            starts=self._starts(),
            compiled=self.compiled,
            tick_us=self.tick_us,
            points=arm_points(chain, self.q),
            heeds=heeds,
            failures=tuple(self.failures),
            signals=self.signals,
            inputs=self.inputs,
        )


def _parts(tasks: Sequence[Task], chain: ClosedChain) -> list[tuple[TaskInfo, slice]]:
    """What the trace says of each part of each task, and its rows in the stack."""
    found, at = [], 0
    for task in tasks:
        first = at
        for part in task.parts(chain):
            name = f"{task.name}.{part.name}" if part.name else task.name
            springs = _springs(task)[at - first : at - first + part.rows]
            info = TaskInfo(name, part.unit, part.tolerance, task.end, springs=springs)
            found.append((info, slice(at, at + part.rows)))
            at += part.rows
    return found


def _springs(task: Task) -> tuple[tuple[int, int, float], ...]:
    """Row, axis and stiffness of each of an impedance's rows; none of other tasks."""
    asked = task.impedance
    pairs = zip(asked.axes, asked.stiffness.tolist(), strict=True) if asked else ()
    return tuple((row, axis, stiffness) for row, (axis, stiffness) in enumerate(pairs))


def _task_rows(tasks: Sequence[Task], chain: ClosedChain) -> tuple[str, ...]:
    """What the rows of all tasks are called."""
    return tuple(f"{task.name}.{row}" for task in tasks for row in task.rows(chain))


def arm_points(chain: ClosedChain, q: Array) -> dict[str, Array]:
    """Joint origins and hand of each arm at each configuration, for drawing.

    Args:
        chain: the closed chain.
        q: shape (T, n).

    Returns:
        By arm, base first, shape (T, p, 3) [m].
    """
    model, data = chain.model, chain.model.createData()
    joints = {
        arm.name: [model.getJointId(name) for name in chain.robot.arm_joints(arm)]
        for arm in chain.arms
    }
    tips = {arm.name: model.getFrameId(arm.tip) for arm in chain.arms}
    points = {name: np.zeros((len(q), len(ids) + 1, 3)) for name, ids in joints.items()}
    for k, row in enumerate(q):
        pin.framesForwardKinematics(model, data, row)
        for name, ids in joints.items():
            for i, joint in enumerate(ids):
                points[name][k, i] = data.oMi[joint].translation
            points[name][k, -1] = data.oMf[tips[name]].translation
    return points
