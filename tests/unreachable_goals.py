"""Random problems with one hard or scaled task that cannot be met in full, and how they end.

The same task as soft of priority 0, with all others one priority below it, is what a hard one must
not fall short of: both want its least squares first.
"""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pinocchio as pin
from stress import arrangements, goals
from stress.firmness import as_soft
from stress.goals import Aim, pick
from walks import walk

from coopqp.assessment.oscillation import oscillation
from coopqp.base.rank import null_space
from coopqp.base.spec import Array
from coopqp.controller import ControlProblem
from coopqp.controllers import QPController
from coopqp.limits import JointPosition, JointVelocity
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.profile import KINDS, Profile
from coopqp.model.state import State
from coopqp.scenario.loader import load
from coopqp.solver import written
from coopqp.solvers import Daqp
from coopqp.task import Task, TaskStack
from coopqp.tasks import JointCentering

DURATION, LONG = 12.0, 120.0  # [s]
PERIODS = (0.005, 0.01, 0.02)  # [s]
FARTHEST = 0.05  # by which a task is unreachable [m]
ROUNDS, CLOSE = 8, 0.1  # to place a goal, and the share of the distance that it may be off
#: Kinds of the task that is unreachable; the others are of any kind that comes to rest.
FIRM = ("point_on_point", "point_on_plane", "point_on_line", "pose", "distance", "prismatic")
MOVING = ("twist", "relative_motion")
#: Robots of shipped scenarios that the stress test does not draw.
OTHERS = ("pr2_circle", "two_so101")
FARTHER, FARTHER_SHARE = 2e-4, 0.01  # what hard may be off more than soft [m], or as a share
AT_REST = 1e-4  # an object that moves less rests [m]
FARTHER_OFF = "farther off"


@dataclass(frozen=True)
class Draw:
    """A problem with one unreachable task.

    Attributes:
        robot, grasp: of the chain.
        firm: the task that is unreachable, hard or scaled.
        problem: all of it; ``firm`` is its first task.
        reference: the same with the firm task as soft, before all others.
        ended: how the reference ends.
    """

    robot: str
    grasp: str
    firm: Task
    problem: ControlProblem
    reference: ControlProblem
    ended: Ended


@dataclass(frozen=True)
class Ended:
    """What became of a run.

    Attributes:
        error: norm of the firm task's error to its goal at the end, all rows [m, rad].
        object_path, object_range: of the object's coordinate with the longest path in the last
            half [m].
        joint_path, joint_range: likewise of a joint [rad, m].
        oscillates: whether a joint does, once the references rest.
        statuses: ticks by what they say.
        q: configuration at the end.
    """

    error: float
    object_path: float
    object_range: float
    joint_path: float
    joint_range: float
    oscillates: bool
    statuses: Counter[str]
    q: Array

    @property
    def rests(self) -> bool:
        """Whether the object stands still in the last half."""
        return self.object_path < AT_REST

    @property
    def paths(self) -> str:
        """The longest paths, in words."""
        return (
            f"{1e3 * self.object_path:.1f} in {1e3 * self.object_range:.1f} mm, "
            f"{1e3 * self.joint_path:.1f} in {1e3 * self.joint_range:.1f} mrad"
        )


def run(
    problem: ControlProblem, firm: Task, duration: float = DURATION, q: Array | None = None
) -> Ended:
    """Run a problem on joints that do as told, and look at the last half.

    Args:
        problem: what to run.
        firm: the task whose error is told.
        duration: of the run [s].
        q: configuration to set out from; the problem's start without it.
    """
    law = QPController().unprepared(problem)
    state = law.start(q)
    ticks = round(duration / problem.dt)
    goal = TaskStack([firm.at_goal()], State(problem.chain))
    made = law.run(state, ticks)
    goal.update(state)
    half = made.q[ticks // 2 :]
    places = np.array([problem.chain.object_pose(at).translation for at in half])
    object_path, object_range = _longest_path(places)
    joint_path, joint_range = _longest_path(half)
    resting = made.q[math.ceil(max(task.end for task in problem.tasks) / problem.dt) :]
    oscillates = oscillation(resting, problem.chain.joint_units, problem.dt)
    return Ended(
        error=float(np.linalg.norm(goal.e)),
        object_path=object_path,
        object_range=object_range,
        joint_path=joint_path,
        joint_range=joint_range,
        oscillates=oscillates is not None,
        statuses=Counter(written(causes) for causes in made.causes),
        q=made.q[-1].copy(),
    )


def shortfall(found: Ended, reference: Ended, problem: ControlProblem, firm: Task) -> str:
    """Why a firm task ends farther off than as soft of priority 0; empty where it does not.

    A gradient descent may end in another minimum, or not have ended. So both go on from where the
    firm run has come to, with all references at their goals, for as long and then for much longer:
    at fault is the firm task that ends both times farther off than the soft one.

    Args:
        found: how the firm task ended.
        reference: how it ended as soft, from the same start.
        problem: with the firm task.
        firm: that task.
    """
    if not falls_short(found, reference):
        return ""
    firmly, softly = (
        replace(given, tasks=tuple(task.at_goal() for task in given.tasks))
        for given in (problem, as_soft(problem, firm))
    )
    for duration in (DURATION, LONG):
        on = run(firmly, firm, duration, found.q)
        if not falls_short(on, run(softly, firm, duration, found.q)):
            return "still on its way" if falls_short(found, on) else "another local optimum"
    return FARTHER_OFF


def _longest_path(x: Array) -> tuple[float, float]:
    """The longest path of a coordinate, and its range."""
    path, width = np.abs(np.diff(x, axis=0)).sum(axis=0), np.ptp(x, axis=0)
    longest = int(np.argmax(path))
    return float(path[longest]), float(width[longest])


def falls_short(found: Ended, reference: Ended) -> bool:
    """Whether a firm task ends farther off than as soft of priority 0."""
    return found.error - reference.error > max(FARTHER, FARTHER_SHARE * reference.error)


def draw(seed: int) -> Draw:
    """The problem that belongs to a seed."""
    rng = np.random.default_rng(seed)
    robot, grasp, first = _chain(rng)
    chain = first.moved(walk(rng, first))
    dt = pick(rng, PERIODS)
    limits = JointPosition(), JointVelocity(scale=pick(rng, (1.0, 1.0, 0.3)))
    X = chain.object_pose(walk(rng, chain))
    away = _direction(rng, chain)
    kind, mode = pick(rng, FIRM), pick(rng, ("hard", "hard", "scaled"))
    common = {**_common(rng, "firm"), "mode": mode, "weight": float(10.0 ** rng.uniform(-1.0, 1.0))}
    aim = goals.random_aim(rng, X)
    aim = _facing(kind, X.rotation.T @ away, aim)
    soft = [_soft(rng, chain, X, i) for i in range(int(rng.integers(1, 4)))]
    secondary = (JointCentering(gain=0.5),) if rng.random() < 0.5 else ()
    wanted = float(rng.uniform(0.0, FARTHEST))
    kept = rng.bit_generator.state  # a task may draw more numbers, alike each time

    def at(shift: float) -> ControlProblem:
        rng.bit_generator.state = kept
        moved = replace(aim, X=pin.SE3(X.rotation, X.translation + shift * away))
        tasks = (goals.BUILDERS[kind](moved, common), *soft)
        return ControlProblem(
            chain=chain, tasks=tasks, secondary=secondary, limits=limits, dt=dt, solver=Daqp()
        )

    least, most = 0.0, 2.0 * chain.reach  # where it is met, where it is too far off
    shift = most
    for _ in range(ROUNDS):
        problem = at(shift)
        reference = as_soft(problem, problem.tasks[0])
        ended = run(reference, problem.tasks[0])
        off = ended.error - wanted
        if abs(off) <= CLOSE * wanted or shift - off <= 0.0:
            break
        least, most = (least, shift) if off > 0.0 else (shift, most)
        shift = shift - off if least < shift - off < most else 0.5 * (least + most)
    return Draw(robot, grasp, problem.tasks[0], problem, reference, ended)


def _chain(rng: np.random.Generator) -> tuple[str, str, ClosedChain]:
    robot = pick(rng, robots())
    grasp = "its own" if robot in OTHERS else pick(rng, arrangements.grasps_of(robot))
    return robot, grasp, chain_of(robot, grasp)


def robots() -> tuple[str, ...]:
    """The arrangements that the stress test draws, and the other robots of shipped scenarios."""
    names = arrangements.names()
    return (*names, *OTHERS) if len(names) > len(arrangements.OWN) else names


@cache
def chain_of(robot: str, grasp: str) -> ClosedChain:
    """The chain of one of them; the others are held as in their scenario."""
    return load(robot).chain if robot in OTHERS else arrangements.chain(robot, grasp)


def _direction(rng: np.random.Generator, chain: ClosedChain) -> Array:
    """A direction in which the object can move at the start, so that reach ends somewhere."""
    state = State(chain)
    way = state.J_task[:3] @ null_space(state.J_loop)
    direction = way @ rng.normal(size=way.shape[1])
    return np.asarray(direction / np.linalg.norm(direction))


def _facing(kind: str, away: Array, aim: Aim) -> Aim:
    """The aim, its directions turned so that the task feels a shift away, in the object frame."""
    if kind in ("point_on_plane", "distance"):
        return replace(aim, axis=away)
    axis = aim.axis - (aim.axis @ away) * away
    return replace(aim, axis=axis / np.linalg.norm(axis), normal=away)


def _soft(rng: np.random.Generator, chain: ClosedChain, X: pin.SE3, i: int) -> Task:
    """A task of any kind that comes to rest, for the pose in reach or for another one."""
    kinds = [kind for kind in goals.BUILDERS if kind not in MOVING]
    there = X if rng.random() < 0.5 else goals.anywhere(rng, X, chain.reach)
    build = goals.BUILDERS[pick(rng, kinds)]
    common = _common(rng, f"soft{i}")
    common |= {"priority": int(rng.integers(0, 3)), "weight": float(10.0 ** rng.uniform(-1, 1))}
    return build(goals.random_aim(rng, there), common)


def _common(rng: np.random.Generator, name: str) -> goals.Common:
    profile = Profile(kind=pick(rng, KINDS), duration=float(rng.uniform(0.3, 2.0)))  # type: ignore[arg-type]
    return {"name": name, "gain": float(rng.uniform(2.0, 20.0)), "profile": profile}
