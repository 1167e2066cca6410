"""A scenario that follows a plan: before each phase's own tasks the way to where they are met.

The path is the reference of joints and object, with its rates as feed-forward; all limits stay in
force. Its clock waits for joints that are pushed off (``scenario.input.Clock``). Where the plan of
a phase ends begin the phase's own tasks.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import Any, Literal

import numpy as np

from coopqp.assessment.limits import audit
from coopqp.base.errors import InvalidValueError, UnknownNameError, under
from coopqp.base.reading import FilePath
from coopqp.base.spec import Array, Name, NonNegative, Positive, spec
from coopqp.base.table import Table, read_table
from coopqp.controller import ControlProblem
from coopqp.model.closed_chain import ClosedChain
from coopqp.scenario.scenario import WAY, Phase, Scenario
from coopqp.signal import POSE, quaternion_of
from coopqp.signals import Waypoints
from coopqp.task import Task
from coopqp.tasks import Pose, Posture

#: How fast what is left of an error goes to zero along the path [1/s].
GAIN = 10.0
GOAL = "goal"
#: Column with the number of the phase that a row leads to, from 1 on; and the name of the clock.
PHASE, CLOCK = "phase", "way"
#: How far a plan may begin from the start [rad, m].
NEAR = 1e-3
#: A joint this many times as fast as it can be has jumped.
FAST = 2.0
#: A row so many times later than usual comes after missing ones. Who comes to rest within a tick or
#: two takes a last step that is shorter than this share of the one before.
MISSING, SLOWER = 1.5, 0.7
#: By how much a path may be beyond a limit of place or speed, whose units these are; of distances
#: one row of so many is looked at.
BEYOND, OF_SPEED, COARSE = 1e-6, ("m", "rad", "m/s", "rad/s"), 10
#: Where ways are found. It lies above, so it is found by name, as plug-ins are.
PLANNER = "coopqp.planning.plan"


@spec
class Followed:
    """A plan that is followed."""

    plan: FilePath | Literal[True]
    """The file that coopqp plan has written; or true, to find a way when the scenario is read."""
    keep: tuple[Name, ...] = ()
    """Names of tasks that are met at the start and stay so along the way, as hard tasks."""
    by: tuple[Name, ...] = ()
    """Names of the controllers that follow it, all if omitted; others do the tasks alone, in the
    same phases."""
    seconds: Positive = 10.0
    """Time within which it is found, where plan is true [s]."""
    late: NonNegative = 2.0
    """How much later than planned each way may end, as where the joints are pushed off it [s]."""


def following(scenario: Scenario, followed: Followed) -> Scenario:
    """The scenario with a plan before the tasks of each phase.

    Raises:
        CoopqpError: no way is found, or the file is none that 'coopqp plan' writes for such a
            robot, start and phases.
    """
    with under("plan"):
        if isinstance(followed.plan, Path):
            table = read_table(followed.plan)
            Waypoints(file=followed.plan)._table(POSE)
        else:
            table = _found(scenario, followed)
        ways = list(_ways(scenario, table))
    for name in followed.by:
        if name not in scenario.controllers:
            raise UnknownNameError("controller", name, scenario.controllers, "by: ")
    phases, alone = list[Phase](), list[Phase]()
    arms = {arm.name for arm in scenario.robot_model.arms}
    for phase, (t, q, X) in zip(scenario.schedule, ways, strict=True):
        kept = [replace(task, mode="hard") for task in phase.tasks if task.name in followed.keep]
        tasks = (*way_tasks(t, q, X, scenario.dt, arms.issubset(phase.released)), *kept)
        before = f"{phase.name} {WAY}" if phase.name else WAY
        lasts = t[-1] + followed.late
        first = Phase(name=before, duration=lasts, released=phase.released, tasks=tasks)
        then = replace(phase, name=phase.name or GOAL)
        phases += [first, then]
        alone += [replace(first, tasks=phase.tasks), then]
    others = [name for name in scenario.controllers if followed.by and name not in followed.by]
    phases_of = dict.fromkeys(others, tuple(alone))
    return scenario.changed(tasks=(), duration=0.0, phases=tuple(phases), phases_of=phases_of)


def way_tasks(t: Array, q: Array, X: Array, dt: float, stands: bool) -> tuple[Task, ...]:
    """Joints q (T, n) and the object's poses X (T, 7) as references, whose clock waits.

    An object that ``stands``, as no arm holds it, follows nothing.
    """
    along: dict[str, Any] = {"times": t.tolist(), "between": "linear", "clock": CLOCK}
    gain = min(GAIN, 1.0 / dt)
    joints = Posture(name="planned joints", goal=Waypoints(values=q.tolist(), **along), gain=gain)
    if stands:
        return (joints,)
    return joints, Pose(
        name="planned object", goal=Waypoints(values=X.tolist(), **along), gain=gain
    )


def follows(scenario: Scenario) -> bool:
    """Whether a scenario follows a plan."""
    return any(phase.name.split()[-1:] == [WAY] for phase in scenario.phases)


def _found(scenario: Scenario, followed: Followed) -> Table:
    planner, seconds = import_module(PLANNER), followed.seconds
    budget = planner.Budget(seconds=seconds, seed=scenario.seed)
    way = planner.plan(scenario, keep=followed.keep, budget=budget)
    if not way.found:
        raise InvalidValueError(f"{way.sentence}; it had 'seconds: {seconds:g}'")
    return Table(Path("plan"), way.columns, 0)


def _ways(scenario: Scenario, table: Table) -> Iterator[tuple[Array, Array, Array]]:
    """Times, joints and object's poses of the way to each phase's goals."""
    t, q = table.times(), table.take(scenario.chain.joint_names)
    X, phases = table.take(POSE.columns), len(scenario.schedule)
    off = np.abs(q[0] - scenario.chain.q_start)
    if off.max() > NEAR:
        joint = scenario.chain.joint_names[int(off.argmax())]
        words = f"begins {off.max():.3g} from the start of {joint}; plan the way anew from here"
        raise InvalidValueError(f"{table.path}: {words}")
    to: Array = table.take([PHASE])[:, 0] if PHASE in table.columns else np.ones(len(t))
    if not np.array_equal(np.unique(to), np.arange(1.0, phases + 1.0)) or (np.diff(to) < 0.0).any():
        words = f"leads to {len(np.unique(to))} phases, and the scenario has {phases}"
        raise InvalidValueError(f"{table.path}: {words}; plan the way anew")
    chain, before = scenario.chain, q
    for k in range(1, phases + 1):
        rows = to == k
        if k > 1:
            chain = chain.handed_over(before[-1], scenario.schedule[k - 1].released)
        before = q[rows]
        problem = scenario.problem(scenario.schedule[k - 1], chain)
        if wrong := _damaged(chain, t[rows], before, X[rows]) or _beyond(problem, t[rows], before):
            raise InvalidValueError(f"{table.path}: {wrong}; plan the way anew")
        yield t[rows] - t[rows][0], before, X[rows]


def _damaged(chain: ClosedChain, t: Array, q: Array, X: Array) -> str:
    """Where rows are missing, joints jump, or the object is not held there; empty if nowhere."""
    (late,) = np.nonzero(np.diff(t) > MISSING * np.median(np.diff(t)))
    if len(late):
        return f"rows are missing between {t[late[0]]:.3f} and {t[late[0] + 1]:.3f} s"
    most = np.where(chain.velocity > 0.0, chain.velocity, np.inf)
    jumps = np.abs(np.diff(q, axis=0)) > FAST * most * np.diff(t)[:, None]
    if jumps.any():
        i, joint = np.argwhere(jumps)[0]
        return f"{chain.joint_names[joint]} jumps at {t[i]:.3f} s"
    step = np.abs(np.diff(q, axis=0)).max(axis=1)
    if len(step) > 2 and step[-1] > max(SLOWER * step[-2], NEAR):
        return f"it still moves where it ends at {t[-1]:.3f} s, as if its last rows were cut off"
    for at, row, x in zip(t, q, X, strict=True):
        opened = np.abs(chain.loop_error(row)).max() if chain.loops.closed else 0.0
        if opened > NEAR:
            return f"a loop is open by {opened:.2g} m or rad at {at:.3f} s"
        pose = chain.object_pose(row)
        turned, said = quaternion_of(pose.rotation), x[3:] / np.linalg.norm(x[3:])
        apart = min(np.abs(turned - said).max(), np.abs(turned + said).max())
        if max(np.abs(pose.translation - x[:3]).max(), apart) > NEAR:
            return f"the object is not where the joints hold it at {at:.3f} s"
    return ""


def _beyond(problem: ControlProblem, t: Array, q: Array) -> str:
    """Which limit, that may be tighter than when the way was planned, it breaks; empty if none."""
    for limit in problem.limits if len(q) > 1 else ():
        every = COARSE if limit.clearance(problem.chain) else 1  # distances take their time
        at, rows = t[::-every][::-1], q[::-every][::-1]
        v = np.diff(rows, axis=0) / np.diff(at)[:, None]
        for row, margin in audit([limit], problem.chain, rows, v, problem.dt).margins.items():
            if row.unit in OF_SPEED and len(v) and (least := float(margin.min())) < -BEYOND:
                place = f"at {at[int(margin.argmin()) + 1]:.3f} s"
                return f"{row.words} is broken by {-least:.2g} {row.unit} {place}"
    return ""
