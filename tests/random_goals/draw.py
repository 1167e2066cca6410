"""A random start and a random goal, from one seed.

An arena is a shipped scenario: its robot, grasp, tasks, gains and secondary objectives.
Seeds alternate between starts near a joint limit and starts away from all of them; the goal is
somewhere round the start, in reach or not. Nothing looks at what any law would do.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pinocchio as pin
from walks import vector, walk

from coopqp.base.errors import MissingDependencyError
from coopqp.base.spec import Array
from coopqp.base.spec import Pose as PoseValue
from coopqp.controller import ControlProblem
from coopqp.model.closed_chain import ClosedChain
from coopqp.robots.example_robot import robots
from coopqp.scenario.loader import load
from coopqp.scenario.scenario import Scenario
from coopqp.task import Task
from coopqp.tasks import PlaneOnPlane, PointOnPoint, Pose

#: A start is near a limit if a joint is closer to it than the first, and away from all limits if
#: none is closer than the second [rad or m].
NEAR, AWAY = 0.05, 0.1
WALKS = 20  # random walks that look for such a start, one after the other
PACE = 1.5  # the references take so much longer than the scenario's, so that speeds bind less
NEAREST_GOAL = 0.1  # least distance of a goal, as a share of the largest


@dataclass(frozen=True)
class Arena:
    """Where goals are drawn.

    Attributes:
        scenario: shipped, by name.
        farthest: distance of a goal from the start [m].
        turn: to a goal with an orientation [rad].
        space: directions in which goals lie.
    """

    scenario: str
    farthest: float
    turn: float = 0.0
    space: tuple[float, float, float] = (1.0, 1.0, 1.0)


OWN = {
    "nao_t14": Arena("point_on_point", 0.06),
    "planar_pair": Arena("planar_pair", 0.25, space=(1.0, 1.0, 0.0)),
}
INSTALLED = {
    "two_pandas": Arena("two_pandas", 0.30, turn=0.6),
    "baxter": Arena("baxter_tray", 0.40),
    "tiago": Arena("tiago_torso", 0.25, turn=0.4),
}


@cache
def arenas() -> dict[str, Arena]:
    """Those whose robots are installed, by robot."""
    try:
        robots()
    except MissingDependencyError:
        return OWN
    return {**OWN, **INSTALLED}


@dataclass(frozen=True)
class Draw:
    """A start and a goal.

    Attributes:
        start: "near" a limit or "away" from all.
        problem: with the scenario's own secondary objectives.
        elsewhere: other configurations inside the limits, from which inverse kinematics may begin.
    """

    start: str
    problem: ControlProblem
    elsewhere: tuple[Array, ...]


@cache
def scenario_of(robot: str) -> Scenario:
    """An arena's scenario, built once a process."""
    return load(arenas()[robot].scenario)


def draw(robot: str, seed: int, others: int) -> Draw:
    """What belongs to a seed.

    Args:
        robot: of an arena.
        seed: even ones begin away from the limits, odd ones near one, where that can be had.
        others: how many other configurations to draw.
    """
    rng = np.random.default_rng([seed, sorted({**OWN, **INSTALLED}).index(robot)])
    scenario, arena = scenario_of(robot), arenas()[robot]
    chain = scenario.chain.moved(_start(rng, scenario.chain, near=seed % 2 == 1))
    X = _goal(rng, arena, chain.object_pose(chain.q_start))
    tasks = tuple(_aimed(task, X) for task in scenario.tasks)
    return Draw(
        "near" if least_margin(chain, chain.q_start) < NEAR else "away",
        replace(scenario.problem(chain=chain), tasks=tasks),
        tuple(walk(rng, scenario.chain) for _ in range(others)),
    )


def least_margin(chain: ClosedChain, q: Array) -> float:
    """Distance of the joint nearest to its limit [rad or m]."""
    return float(np.minimum(q - chain.lower, chain.upper - q).min())


def _start(rng: np.random.Generator, chain: ClosedChain, *, near: bool) -> Array:
    """Where random walks inside the limits find what is wanted; the scenario's start if nowhere."""
    for q in _walks(rng, chain):
        margin = least_margin(chain, q)
        if (margin < NEAR) if near else (margin >= AWAY):
            return q
    return chain.q_start


def _walks(rng: np.random.Generator, chain: ClosedChain) -> Iterator[Array]:
    """Ends of walks, each from where the one before has ended."""
    for _ in range(WALKS):
        q = walk(rng, chain)
        yield q
        chain = chain.moved(q)


def _goal(rng: np.random.Generator, arena: Arena, start: pin.SE3) -> pin.SE3:
    way, axis = rng.normal(size=(2, 3))
    way *= arena.space
    way *= rng.uniform(NEAREST_GOAL, 1.0) * arena.farthest / np.linalg.norm(way)
    turn = pin.exp3(rng.uniform(0.0, arena.turn) * axis / np.linalg.norm(axis))
    return pin.SE3(turn @ start.rotation, start.translation + way)


def _aimed(task: Task, X: pin.SE3) -> Task:
    """The scenario's task with another goal."""
    p = vector(X.translation)
    assert isinstance(task, PointOnPoint | PlaneOnPlane | Pose)
    slower = replace(task.profile, duration=PACE * task.profile.duration)
    if isinstance(task, PointOnPoint):
        return replace(task, goal=p, profile=slower)
    if isinstance(task, PlaneOnPlane):
        return replace(task, through=p, profile=slower)
    goal = PoseValue(position=p, rpy=vector(pin.rpy.matrixToRpy(X.rotation)))
    return replace(task, goal=goal, profile=slower)
