"""Random rollouts of the QP law that look for a broken promise.

Every rollout draws a grasp, a start inside or outside the limits, a task with a goal that may be
out of reach, and limits tight or loose, all from its own seed. It must keep every position and
velocity bound (a joint that starts outside comes back without going farther out, and stays), keep
the loops within the budget, have no NaN and raise nothing, and end as reached, blocked by rows with
names, or still recovering.
"""

from __future__ import annotations

import math
import multiprocessing
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np

from coopqp.checked import Array
from coopqp.checked import Pose as PoseValue
from coopqp.closed_chain import ClosedChain
from coopqp.controller import ControlProblem
from coopqp.grasp import Grasp
from coopqp.grasps import Revolute, Rigid
from coopqp.held_object import HeldObject
from coopqp.limits import JointPosition, JointVelocity
from coopqp.plants.kinematic import KinematicModel
from coopqp.profile import Profile
from coopqp.qp_law.law import QPLaw
from coopqp.rank import null_space
from coopqp.robots.nao_t14 import NaoT14
from coopqp.rollout import drive
from coopqp.solver import Budget
from coopqp.solvers import Daqp
from coopqp.state import State
from coopqp.study.explanation import explain, record_tick
from coopqp.task import Task, TaskStack
from coopqp.tasks import JointCentering, PointOnPlane, PointOnPoint, Pose

DT, TICKS, MOST_ROUNDS = 0.01, 300, 5  # [s], ticks a round, rounds while it still moves
EXCESS = 1e-9  # what a bound may be exceeded by, rounding [rad, rad/s]
START = {"right": [0.7, -0.2, 1.2, 0.9, 0.1], "left": [0.7, 0.2, -1.2, -0.9, -0.1]}
GRASPS: dict[str, Grasp] = {"rigid": Rigid(), "revolute": Revolute(point=(0.0, 0.0, -0.05))}
WALK, WALK_STEPS = 0.03, 60  # a random walk along the loops [rad], steps
FARTHEST_OUTSIDE = 0.3  # [rad]
AT = 1e-4  # a joint this near its limit rests there [rad]
SINGULAR = 0.05  # least motion of the object for a unit of joint motion [m/rad]
OUTCOMES = ("reached", "blocked", "recovering")


@dataclass(frozen=True)
class Rollout:
    """How one rollout went.

    Attributes:
        seed: from which it can be repeated.
        grasp: "rigid" or "revolute". outside: whether it started outside. tight: likewise.
        outcome: reached, blocked or recovering; empty when it is none of them.
        reason: the names of what blocked it.
        broken: promises that were broken, in words.
        position_excess: largest overrun of a position limit that held before [rad].
        velocity_excess: of a velocity limit [rad/s].
        loop_position, loop_orientation: largest loop error [m], [rad].
        fallbacks: ticks that gave something up or held still.
    """

    seed: int
    grasp: str
    outside: bool
    tight: bool
    outcome: str
    reason: str
    broken: tuple[str, ...]
    position_excess: float = 0.0
    velocity_excess: float = 0.0
    loop_position: float = 0.0
    loop_orientation: float = 0.0
    fallbacks: int = 0


@dataclass
class _Watch:
    """What is kept while a rollout runs."""

    was_out: Array
    position_excess: float = 0.0
    velocity_excess: float = 0.0
    loop_position: float = 0.0
    loop_orientation: float = 0.0
    fallbacks: int = 0
    broken: set[str] = field(default_factory=set)


def stress(
    count: int, *, seed: int = 0, jobs: int = 0, progress: Callable[[int], None] | None = None
) -> list[Rollout]:
    """Run many rollouts on all cores.

    Args:
        count: how many.
        seed: of the first; the others count up.
        jobs: processes; all cores when 0.
        progress: called with the number done.
    """
    seeds = range(seed, seed + count)
    done: list[Rollout] = []
    for rollout in _all(seeds, jobs or multiprocessing.cpu_count()):
        done.append(rollout)
        if progress:
            progress(len(done))
    return done


def _all(seeds: range, jobs: int) -> Iterator[Rollout]:
    if jobs == 1 or len(seeds) == 1:
        yield from map(one_rollout, seeds)
        return
    with multiprocessing.Pool(min(jobs, len(seeds))) as pool:
        yield from pool.imap_unordered(one_rollout, seeds, chunksize=8)


def one_rollout(seed: int) -> Rollout:
    """Draw a rollout from a seed and run it; an exception is a broken promise, not raised."""
    rng = np.random.default_rng(seed)
    grasp = str(rng.choice(list(GRASPS)))
    outside, tight = bool(rng.random() < 0.3), bool(rng.random() < 0.5)
    try:
        problem = draw(rng, grasp, outside=outside, tight=tight)
        return _run(problem, seed, grasp, tight)
    except Exception as error:  # noqa: BLE001 - this is what the stress test looks for
        words = f"raised {type(error).__name__}: {error}"
        return Rollout(seed, grasp, outside, tight, "", "", (words,))


def draw(rng: np.random.Generator, grasp: str, *, outside: bool, tight: bool) -> ControlProblem:
    """A random problem: start, task and limits."""
    robot = NaoT14().build()
    first = ClosedChain.take_hold(robot, robot.configuration(START), GRASPS[grasp], HeldObject())
    q = _walk(rng, first, outside=outside)
    chain = first.moved(q)
    limits = (
        JointPosition(margin=float(rng.uniform(0.0, 0.1)) if tight else 0.0),
        JointVelocity(scale=float(rng.uniform(0.05, 0.3)) if tight else 1.0),
    )
    return ControlProblem(
        chain=chain,
        tasks=(_task(rng, chain, grasp),),
        secondary=(JointCentering(),) if rng.random() < 0.5 else (),
        limits=limits,
        dt=DT,
        kappa=1.0 / DT,
        solver=Daqp(),
        budget=Budget(),
    )


def _walk(rng: np.random.Generator, chain: ClosedChain, *, outside: bool) -> Array:
    """Where a random walk along the loops ends: inside the limits, or as soon as it is outside."""
    state = State(chain)
    direction = rng.normal(size=chain.n)
    inside = state.q.copy()
    for _ in range(WALK_STEPS if outside else int(rng.integers(1, WALK_STEPS))):
        basis = null_space(state.J_loop)
        step = basis @ (basis.T @ direction)
        state.q += WALK * step / max(float(np.linalg.norm(step)), 1e-9)
        state.update()
        state.close_loops(3)
        beyond = np.maximum(chain.lower - state.q, state.q - chain.upper).max()
        if beyond > 0.0:
            if outside and beyond < FARTHEST_OUTSIDE and rng.random() < 0.3:
                return state.q.copy()
            if not outside or beyond >= FARTHEST_OUTSIDE:
                return inside
        else:
            inside = state.q.copy()
    return inside


def _task(rng: np.random.Generator, chain: ClosedChain, grasp: str) -> Task:
    way = rng.normal(size=3)
    goal = chain.start_position + rng.uniform(0.01, 0.15) * way / np.linalg.norm(way)
    profile = Profile(
        kind=str(rng.choice(["step", "constant_velocity", "trapezoid", "quintic"])),  # type: ignore[arg-type]
        duration=float(rng.uniform(0.2, 2.0)),
    )
    place = (float(goal[0]), float(goal[1]), float(goal[2]))
    kinds = ("point", "plane", "pose") if grasp == "revolute" else ("point", "plane")
    kind = str(rng.choice(kinds))
    if kind == "plane":
        normal = rng.normal(size=3)
        return PointOnPlane(
            name="task", normal=(normal[0], normal[1], normal[2]), through=place, profile=profile
        )
    if kind == "pose":
        angles = rng.uniform(-0.5, 0.5, 3)
        pose = PoseValue(position=place, rpy=(angles[0], angles[1], angles[2]))
        return Pose(name="task", goal=pose, profile=profile)
    point = rng.uniform(-0.04, 0.04, 3)
    return PointOnPoint(
        name="task", goal=place, point=(point[0], point[1], point[2]), profile=profile
    )


def _run(problem: ControlProblem, seed: int, grasp: str, tight: bool) -> Rollout:
    law = QPLaw(problem, 1e-6)
    state = law.start()
    chain = problem.chain
    outside = not chain.starts_inside
    speed = chain.velocity * next(k.scale for k in problem.limits if isinstance(k, JointVelocity))
    watch = _Watch(was_out=_beyond(chain, state.q))
    outcome, reason = "moving", ""
    for _ in range(MOST_ROUNDS):
        _round(law, state, speed, watch)
        outcome, reason = _outcome(problem, law, state)
        if outcome not in ("moving", "recovering"):
            break
    _judge(watch, problem.budget, outcome)
    return Rollout(
        seed, grasp, outside, tight, outcome, reason, tuple(sorted(watch.broken)),
        max(0.0, watch.position_excess), max(0.0, watch.velocity_excess),
        watch.loop_position, watch.loop_orientation, watch.fallbacks,
    )  # fmt: skip


def _round(law: QPLaw, state: State, speed: Array, watch: _Watch) -> None:
    """Run for a while and keep the worst of everything."""
    chain = law.problem.chain
    plant = KinematicModel(DT, chain.n)
    for command, _ in drive(law, plant, state, TICKS):
        watch.fallbacks += command.status.fallback or not command.status.usable
        watch.velocity_excess = max(watch.velocity_excess, float((np.abs(command.v) - speed).max()))
        if not np.isfinite(command.v).all():
            watch.broken.add("commanded NaN")
            break
        _watch(watch, chain, state)
    _watch(watch, chain, state)


def _beyond(chain: ClosedChain, q: Array) -> Array:
    """How far each joint is outside its limits, shape (n,) [rad]."""
    beyond: Array = np.maximum(np.maximum(chain.lower - q, q - chain.upper), 0.0)
    return beyond


def _watch(watch: _Watch, chain: ClosedChain, state: State) -> None:
    beyond = _beyond(chain, state.q)
    watch.position_excess = max(watch.position_excess, float((beyond - watch.was_out).max()))
    # What is inside now must stay inside; what is outside may only come nearer.
    watch.was_out = np.minimum(watch.was_out, beyond)
    watch.loop_position = max(watch.loop_position, state.loop_position_error)
    watch.loop_orientation = max(watch.loop_orientation, state.loop_orientation_error)


def _outcome(problem: ControlProblem, law: QPLaw, state: State) -> tuple[str, str]:
    if _beyond(problem.chain, state.q).max() > EXCESS:
        return "recovering", ""
    tasks = TaskStack(problem.tasks, State(problem.chain))
    tasks.update(state)
    at, reached = 0, True
    for task in problem.tasks:
        for part in task.parts(problem.chain):
            error = float(np.linalg.norm(tasks.e[at : at + part.rows]))
            reached, at = reached and error <= part.tolerance, at + part.rows
    if reached:
        return "reached", ""
    record = record_tick(law, state, scenario="stress", controller="qp", tick=TICKS)
    why = explain(record)
    names = [*(r.name for r in why.relaxations), *(f"loops|{name}" for name in why.impossible)]
    if names:
        return "blocked", ", ".join(names)
    held = _at_limits(problem.chain, state)
    if _near_singular(problem, tasks, state, list(held)):
        blocks = ["singular pose", *held.values()]
        return "blocked", f"{', '.join(blocks)} along {', '.join(why.missed)}"
    return ("moving", "") if float(np.abs(law.command.v).max()) > 1e-6 else ("", why.sentence)


def _at_limits(chain: ClosedChain, state: State) -> dict[int, str]:
    """Joints that rest at a position limit, with the limit's name."""
    names = chain.joint_names
    low, high = state.q - chain.lower < AT, chain.upper - state.q < AT
    lowest = {i: f"limit.position[{names[i]}].lower" for i in np.flatnonzero(low).tolist()}
    highest = {i: f"limit.position[{names[i]}].upper" for i in np.flatnonzero(high).tolist()}
    return {**lowest, **highest}


def _near_singular(
    problem: ControlProblem, tasks: TaskStack, state: State, held: list[int]
) -> bool:
    """Whether loops and joints at their limits leave a direction of the tasks next to nothing."""
    locked = np.eye(problem.chain.n)[held]
    free = null_space(np.vstack([state.J_loop, locked]))
    values = np.linalg.svd(tasks.J @ free, compute_uv=False)
    return len(values) < len(tasks.J) or bool(values.min(initial=math.inf) < SINGULAR)


def _judge(watch: _Watch, budget: Budget, outcome: str) -> None:
    if watch.position_excess > EXCESS:
        watch.broken.add(f"left a position limit by {watch.position_excess:.2g} rad")
    if watch.velocity_excess > EXCESS:
        watch.broken.add(f"broke a velocity limit by {watch.velocity_excess:.2g} rad/s")
    if watch.loop_position > budget.loop_position:
        watch.broken.add(f"opened a loop by {1e3 * watch.loop_position:.2g} mm")
    if watch.loop_orientation > budget.loop_orientation:
        watch.broken.add(f"opened a loop by {watch.loop_orientation:.2g} rad")
    if outcome not in OUTCOMES:
        watch.broken.add("ended without a reason")


@dataclass(frozen=True)
class Summary:
    """One line of the table: rollouts of one kind.

    Attributes:
        kind: such as "rigid, inside, loose".
        count: of rollouts.
        outcomes: by name.
        broken: rollouts that broke a promise.
        position_excess, velocity_excess, loop_position, loop_orientation: the worst of them.
        fallbacks: ticks, of all rollouts.
    """

    kind: str
    count: int
    outcomes: dict[str, int]
    broken: int
    position_excess: float
    velocity_excess: float
    loop_position: float
    loop_orientation: float
    fallbacks: int


def summarize(rollouts: list[Rollout]) -> list[Summary]:
    """By grasp, start and limits, and all together."""
    kinds: dict[str, list[Rollout]] = {}
    for r in rollouts:
        words = (r.grasp, "outside" if r.outside else "inside", "tight" if r.tight else "loose")
        kinds.setdefault(", ".join(words), []).append(r)
    lines = [_summary(kind, kinds[kind]) for kind in sorted(kinds)]
    return [*lines, _summary("all", rollouts)]


def _summary(kind: str, rollouts: list[Rollout]) -> Summary:
    return Summary(
        kind,
        len(rollouts),
        dict(sorted(Counter(r.outcome or "unexplained" for r in rollouts).items())),
        sum(bool(r.broken) for r in rollouts),
        max(r.position_excess for r in rollouts),
        max(r.velocity_excess for r in rollouts),
        max(r.loop_position for r in rollouts),
        max(r.loop_orientation for r in rollouts),
        sum(r.fallbacks for r in rollouts),
    )
