"""Shipped robots whose bodies are watched: self-collision, and things in the world nearby."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import cache

import numpy as np
from scenario_files import LOADABLE

from coopqp.base.errors import CoopqpError
from coopqp.base.spec import Pose
from coopqp.controller import ControlProblem
from coopqp.controllers.qp import QPController
from coopqp.limit import Limit
from coopqp.limits import Obstacle, Obstacles, SelfCollision
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.profile import Profile
from coopqp.scenario.loader import load
from coopqp.scenario.scenario import Scenario
from coopqp.tasks import JointCentering
from coopqp.tasks import Pose as PoseTask

#: What must be left of the distance to keep at the start [m].
CLEAR = 0.003
DIRECTIONS = 200  # in which a place for a thing is looked for

#: A scenario of each shipped robot with bodies, by names: tests are collected without meshes.
OF_ROBOTS = (
    "baxter_tray", "heavy_object", "point_on_point", "position_pair", "pr2_circle", "three_ur",
    "tiago_torso", "two_pandas", "two_so101",
)  # fmt: skip
OF_ROBOTS = tuple(name for name in OF_ROBOTS if name in LOADABLE)


@cache
def watched() -> tuple[str, ...]:
    """Names of shipped scenarios of the QP controller whose robots have bodies."""
    return tuple(_names())


def _names() -> Iterator[str]:
    for name in LOADABLE:
        scenario = load(name)
        if any(isinstance(c, QPController) for c in scenario.controllers.values()):
            try:
                SelfCollision().rows(scenario.problem().chain)
            except CoopqpError:
                continue
            yield name


def robots() -> dict[str, ClosedChain]:
    """A chain of each shipped robot with bodies, by the name of a scenario with it."""
    found: dict[tuple[str, ...], str] = {}
    for name in (*OF_ROBOTS, *watched()):
        found.setdefault(load(name).chain.joint_names, name)
    return {name: load(name).problem().chain for name in found.values()}


def watching(name: str, *, things: bool = True, alone: bool = False) -> ControlProblem:
    """A shipped scenario with self-collision, and with things near the object or without.

    Pairs that start too near are ignored. alone: without all other limits.
    """
    scenario = load(name)
    chain = scenario.problem().chain
    limits = [self_collision(chain)]
    if things:
        limits.append(near_things(chain))
    others = () if alone else without_bodies(scenario.limits)
    return with_limits(scenario, *others, *limits).problem()


def driven(name: str, seed: int) -> ControlProblem:
    """The same with a random goal for the object, most of them out of what the limits leave."""
    problem, rng = watching(name), np.random.default_rng(seed)
    place = problem.chain.start_position + rng.normal(0.0, 0.3, 3)
    turn = tuple(rng.normal(0.0, 1.0, 3).tolist())
    goal = Pose(position=tuple(place.tolist()), rpy=turn)
    task = PoseTask(goal=goal, profile=Profile(duration=0.2))
    return replace(problem, tasks=(task,), secondary=(JointCentering(gain=0.5),))


def with_limits(scenario: Scenario, *limits: Limit) -> Scenario:
    return replace(scenario, limits=limits)


def self_collision(chain: ClosedChain) -> SelfCollision:
    """Of all pairs that are apart at the start."""
    near = [
        (a.name, b.name)
        for a, b, d in SelfCollision().at_start(chain)
        if d < SelfCollision().distance + CLEAR
    ]
    return SelfCollision(ignore=tuple(near))


def near_things(chain: ClosedChain) -> Obstacles:
    """A ball, a box and a post as near to the bodies as they may be, wherever that is."""
    rng = np.random.default_rng(0)
    sizes = {
        "ball": {"sphere": 0.03},
        "box": {"box": (0.05, 0.04, 0.03)},
        "post": {"cylinder": {"radius": 0.02, "length": 0.1}},
    }
    return Obstacles(shapes={name: _thing(chain, name, size, rng) for name, size in sizes.items()})


def _thing(
    chain: ClosedChain, name: str, size: dict[str, object], rng: np.random.Generator
) -> Obstacle:
    for reach in np.linspace(0.08, 1.0, DIRECTIONS):
        way = rng.normal(size=3)
        at = chain.start_position + reach * way / np.linalg.norm(way)
        rpy = tuple(rng.uniform(-1.0, 1.0, 3).tolist())
        thing = Obstacle(**size, position=tuple(at.tolist()), rpy=rpy)  # type: ignore[arg-type]
        nearest = Obstacles(shapes={name: thing}).at_start(chain)[0][2]
        if nearest > Obstacles.distance + CLEAR:
            return thing
    raise AssertionError(f"no place for a {name}")


def without_bodies(limits: Sequence[Limit]) -> tuple[Limit, ...]:
    """Those that watch no bodies."""
    return tuple(each for each in limits if not isinstance(each, SelfCollision | Obstacles))
