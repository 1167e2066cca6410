"""A scenario that follows a plan: before each phase's own tasks the way to where they are met.

The path is the reference, with its rates as feed-forward, by torques also its accelerations and the
wrench between the hands; all limits stay in force. Its clock waits for joints that are pushed off
(``scenario.input.Clock``). Where the plan of a phase ends begin the phase's own tasks.
"""

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np

import coopqp
from coopqp.assessment.limits import audit
from coopqp.base.errors import InvalidValueError, require_known, under
from coopqp.base.reading import FilePath
from coopqp.base.spec import Array, Name, NonNegative, Positive, spec
from coopqp.base.table import Table, read_table
from coopqp.closed_loop.grasp_matrix import COMPONENTS
from coopqp.controller import Controller, ControlProblem
from coopqp.model.closed_chain import ClosedChain
from coopqp.scenario.scenario import Phase, Scenario, off_plan
from coopqp.signal import POSE, quaternion_of
from coopqp.signals import Waypoints
from coopqp.task import Task
from coopqp.tasks import InternalWrench, Pose, Posture

#: How fast what is left of an error goes to zero along the path, by velocities and by torques
#: [1/s], and how many ticks that takes by torques at least.
GAIN, TORQUE_GAIN, TICKS = 10.0, 40.0, 10.0
WAY, GOAL = "way", "goal"
#: A copy of the plan beside what came of it.
FOLLOWED = "followed.csv"
#: Column with the number of the phase that a row leads to, from 1 on; and the name of the clock.
PHASE, CLOCK = "phase", "way"
#: How near a plan is to the start that begins there, a loop to closed, and the object to where it
#: is held [rad, m].
NEAR = 1e-3
#: A joint this many times as fast as it can be has jumped.
FAST = 2.0
#: A row so many times later than usual comes after missing ones. Who comes to rest within a tick or
#: two takes a last step that is shorter than this share of the one before.
MISSING, SLOWER = 1.5, 0.7
#: By how much a path may be beyond a limit of place or speed, whose units these are, as the spline
#: of a timed one is beside a limit it goes along; of distances one row of so many is looked at.
BEYOND, OF_SPEED, COARSE = 2e-3, ("m", "rad", "m/s", "rad/s"), 10


class Way(NamedTuple):
    """The way of one phase, from t = 0 on."""

    t: Array  # times, shape (T,) [s]
    q: Array  # joints then, shape (T, n)
    object: Array  # its poses, shape (T, 7)
    # between two hands, by ``COMPONENTS``, shape (T, 6); empty where nobody has said
    wrench: Array = np.zeros((0, 0))


@spec
class PlanReference:
    """A plan that is followed."""

    plan: FilePath | Literal[True]
    """The file that coopqp plan or time has written; or true, to find a way when this is read."""
    keep: tuple[Name, ...] = ()
    """Names of tasks that are met at the start and stay so along the way, as hard tasks."""
    by: tuple[Name, ...] = ()
    """Names of the controllers that follow it, all if omitted; others do the tasks alone, in the
    same phases."""
    seconds: Positive = 10.0
    """Time within which it is found, where plan is true [s]."""
    late: NonNegative = 2.0
    """How much longer than planned each way lasts, for joints that are pushed off it [s]."""


def following(scenario: Scenario, reference: PlanReference) -> Scenario:
    """The scenario with a plan before the tasks of each phase.

    CoopqpError: no way is found, or the file is none that 'coopqp plan' writes for such a robot,
    start and phases.
    """
    with under("plan"):
        if isinstance(reference.plan, Path):
            table = read_table(reference.plan)
            Waypoints(file=reference.plan)._table(POSE)
        else:
            way = coopqp.plan(scenario, keep=reference.keep, budget=reference.seconds)
            if not way.success:
                raise InvalidValueError(f"{way.sentence}; it had 'seconds: {reference.seconds:g}'")
            table = Table(Path("plan"), way.columns, 0)
        ways = list(_ways(scenario, table))
    require_known("controller", reference.by, scenario.controllers, "by: ")
    each = {
        name: _phases(scenario, ways, reference, law)
        for name, law in scenario.controllers.items()
        if law.commands_torques or (reference.by and name not in reference.by)
    }
    phases = _phases(scenario, ways, reference)
    return scenario.changed(tasks=(), duration=0.0, phases=phases, phases_of=each, follows=table)


def _phases(
    scenario: Scenario, ways: Sequence[Way], reference: PlanReference, law: Controller | None = None
) -> tuple[Phase, ...]:
    """Each phase and the way to it, which a law that does not follow it does not know."""
    found, arms = list[Phase](), {arm.name for arm in scenario.robot_model.arms}
    alone = law is not None and bool(reference.by) and law.name not in reference.by
    for phase, way in zip(scenario.schedule, ways, strict=True):
        kept = [replace(task, mode="hard") for task in phase.tasks if task.name in reference.keep]
        tasks = (*way_tasks(way, scenario.dt, arms.issubset(phase.released), law), *kept)
        before = Phase(
            name=f"{phase.name} {WAY}".strip(), duration=way.t[-1] + reference.late, leads=True,
            released=phase.released, tasks=phase.tasks if alone else tasks,
        )  # fmt: skip
        found += [before, replace(phase, name=phase.name or GOAL)]
    return tuple(found)


def way_tasks(way: Way, dt: float, stands: bool, law: Controller | None = None) -> tuple[Task, ...]:
    """The references along a way, whose clock waits for the joints.

    By velocities joints and object go on straight from tick to tick; an object that ``stands``, as
    no arm holds it, follows nothing. By torques the path between ticks is smooth, since its
    accelerations count, and nothing is asked for twice: of laws that weigh tasks the joints, of
    others the object, for which no clock waits; and the wrench between the hands.
    """
    torques = law is not None and law.commands_torques
    gain = min(TORQUE_GAIN, 1.0 / (TICKS * dt)) if torques else min(GAIN, 1.0 / dt)
    of_joints = not torques or (law is not None and "modes" in law.supports)
    along: dict[str, Any] = {"times": way.t.tolist(), "clock": CLOCK}

    def on(values: Array, smooth: bool = torques) -> Waypoints:
        between: Literal["cubic", "linear"] = "cubic" if smooth else "linear"
        return Waypoints(values=values.tolist(), between=between, **along)

    found: list[Task] = []
    if of_joints:
        found.append(Posture(name="planned joints", goal=on(way.q), gain=gain))
    if not stands and not (torques and of_joints):
        found.append(Pose(name="planned object", goal=on(way.object), gain=gain))
    if torques and law is not None and "forces" in law.supports and way.wrench.size:
        parts = zip(COMPONENTS, way.wrench.T[:, :, None], strict=True)
        each: dict[str, Any] = {name: on(values, False) for name, values in parts}
        found.append(InternalWrench(name="planned wrench", **each))
    return tuple(found)


def _ways(scenario: Scenario, table: Table) -> Iterator[Way]:
    t, q = table.times(), table.take(scenario.chain.joint_names)
    X, phases = table.take(POSE.columns), len(scenario.schedule)
    if wrong := off_plan(scenario.chain, table):
        raise InvalidValueError(wrong)
    off = np.abs(q[0] - scenario.chain.q_start)
    chain, before = scenario.chain, q
    for k, rows in enumerate(rows_of_phases(table, phases)):
        if k:
            chain = chain.handed_over(before[-1], scenario.schedule[k].released)
        before = q[rows]
        problem = scenario.problem(scenario.schedule[k], chain)
        wrong = _damaged(chain, t[rows], before, X[rows], NEAR + float(off.sum()))
        if wrong := wrong or _beyond(problem, t[rows], before):
            raise InvalidValueError(f"{table.path}: {wrong}; plan the way anew")
        pair = chain.holding == 2 and set(COMPONENTS) <= set(table.columns)
        wrench = table.take(COMPONENTS if pair else ())
        yield Way(t[rows] - t[rows][0], before, X[rows], wrench[rows] if pair else np.zeros((0, 0)))


def rows_of_phases(table: Table, phases: int) -> list[slice]:
    """Rows that lead to each phase; InvalidValueError where there are not so many phases."""
    to = table.take([PHASE])[:, 0] if PHASE in table.columns else np.ones(len(table.times()))
    if not np.array_equal(np.unique(to), np.arange(1.0, phases + 1.0)) or (np.diff(to) < 0.0).any():
        words = f"leads to {len(np.unique(to))} phases, and the scenario has {phases}"
        raise InvalidValueError(f"{table.path}: {words}; plan the way anew")
    ends = np.flatnonzero(np.diff(to, prepend=0.0, append=0.0)).tolist()
    return [slice(a, b) for a, b in itertools.pairwise(ends)]


def _damaged(chain: ClosedChain, t: Array, q: Array, X: Array, near: float) -> str:
    """Where rows are missing, joints jump, or the object is not so near [m, rad]; else empty."""
    (late,) = np.nonzero(np.diff(t) > MISSING * np.median(np.diff(t)))
    if len(late):
        return f"rows are missing between {t[late[0]]:.3f} and {t[late[0] + 1]:.3f} s"
    fastest = np.where(chain.velocity > 0.0, chain.velocity, np.inf)
    jumps = np.abs(np.diff(q, axis=0)) > FAST * fastest * np.diff(t)[:, None]
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
        turned, given = quaternion_of(pose.rotation), x[3:] / np.linalg.norm(x[3:])
        apart = min(np.abs(turned - given).max(), np.abs(turned + given).max())
        if max(np.abs(pose.translation - x[:3]).max(), apart) > near:
            return f"the object is not where the joints hold it at {at:.3f} s"
    return ""


def _beyond(problem: ControlProblem, t: Array, q: Array) -> str:
    """Which limit, that may be tighter than when the way was planned, it breaks; empty if none."""
    for limit in problem.limits if len(q) > 1 else ():
        every = COARSE if limit.clearance(problem.chain) else 1  # distances take their time
        at, rows = t[::-every][::-1], q[::-every][::-1]
        v = np.diff(rows, axis=0) / np.diff(at)[:, None]
        for row, margin in audit([limit], problem.chain, rows, v, problem.dt).margins.items():
            if row.unit in OF_SPEED and len(v) and (worst := float(margin.min())) < -BEYOND:
                place = f"at {at[int(margin.argmin()) + 1]:.3f} s"
                return f"{row.label} is broken by {-worst:.2g} {row.unit} {place}"
    return ""
