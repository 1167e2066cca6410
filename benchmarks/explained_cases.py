"""What ``explanations.py`` asks about: random runs of which it is known what is true of them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pinocchio as pin
from scipy.optimize import least_squares

from coopqp.base.spec import Array
from coopqp.limits import JointAcceleration, JointPosition, JointVelocity, Workspace
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.profile import Profile
from coopqp.scenario.loader import load
from coopqp.scenario.scenario import Scenario
from coopqp.task import Task
from coopqp.tasks import Orientation, Pointing, PointOnPlane, PointOnPoint

ROBOTS = {
    "NAO": "point_on_point",
    "planar pair": "planar_pair",
    "two Pandas": "two_pandas",
    "Baxter": "baxter_tray",
    "TIAGo": "tiago_torso",
    "three URs": "three_ur",
}
#: Of joints where there is an acceleration limit [rad/s2, m/s2].
ACCELERATION = 8.0
PROFILE = Profile(kind="quintic", duration=1.5)
DURATION = 3.0  # s
#: A walk along the loops: steps, and their size [rad, m].
STEPS, STEP = 40, 0.05
#: scipy counts a point as reached when it is nearer than this [m].
REACHED = 1e-3


@dataclass(frozen=True)
class Case:
    """A run and what is true of it."""

    robot: str
    scenario: Scenario


def base(name: str) -> Scenario:
    """A shipped scenario with nothing but limits of joints, and the law that is explained."""
    given = load(ROBOTS[name])
    own = tuple(k for k in given.limits if isinstance(k, JointPosition | JointVelocity))
    controllers = {"qp": given.controllers["qp"]}
    return replace(
        given, limits=own, controllers=controllers, duration=DURATION, source="", secondary=()
    )


def with_tasks(scenario: Scenario, *tasks: Task) -> Scenario:
    """The scenario with other tasks."""
    return replace(scenario, tasks=tasks)


# Blocked runs


def walked(chain: ClosedChain, rng: np.random.Generator) -> Array:
    """A configuration with closed loops, some way off the start, limits not heeded."""
    q, way = chain.q_start.copy(), rng.normal(size=chain.n)
    way /= np.linalg.norm(way)
    for _ in range(int(rng.integers(STEPS // 4, STEPS))):
        J = chain.loop_jacobian(q)
        free = np.eye(chain.n) - np.linalg.pinv(J, rcond=1e-8) @ J
        q = q + STEP * free @ way
        for _ in range(3):
            q = q - np.linalg.pinv(chain.loop_jacobian(q), rcond=1e-8) @ gap(chain, q)
    return q


def gap(chain: ClosedChain, q: Array) -> Array:
    """Loop error, from pinocchio's frames alone, shape (6 L,)."""
    data = chain.model.createData()
    pin.framesForwardKinematics(chain.model, data, q)
    X_0, *others = (data.oMf[frame] for frame in chain.frames[: chain.holding])
    return np.concatenate(
        [
            [*(X.translation - X_0.translation), *pin.log3(X.rotation @ X_0.rotation.T)]
            for X in others
        ]
    )


def blocked(seed: int) -> Iterator[Case]:
    """Goals that are reached outside the limits, endlessly; the caller sees which block."""
    rng = np.random.default_rng(seed)
    scenarios = {name: base(name) for name in ROBOTS}
    while True:
        for name, scenario in scenarios.items():
            chain = scenario.chain
            q = walked(chain, rng)
            if np.linalg.norm(gap(chain, q)) > 1e-9:
                continue
            x, y, z = chain.object_pose(q).translation.tolist()
            mode: Any = str(rng.choice(["soft", "soft", "hard", "scaled"]))
            task = PointOnPoint(name="reach", goal=(x, y, z), profile=PROFILE, mode=mode)
            made, dice = with_tasks(scenario, task), rng.random()
            if dice < 0.25:
                made = replace(made, limits=(*made.limits, wall(chain, np.array((x, y, z)))))
            elif dice < 0.5:
                made = replace(made, limits=(*made.limits, JointAcceleration(max=ACCELERATION)))
            yield Case(name, made)


def wall(chain: ClosedChain, goal: Array) -> Workspace:
    """A wall for the object's origin, half-way to the goal."""
    start = chain.start_position
    normal, middle = start - goal, 0.5 * (start + goal)
    nx, ny, nz = normal.tolist()
    mx, my, mz = middle.tolist()
    return Workspace(
        name="wall", normal=(nx, ny, nz), through=(mx, my, mz), points=((0.0, 0.0, 0.0),)
    )


# Unreachable goals


def scipy_distance(
    chain: ClosedChain,
    goal: Array,
    rng: np.random.Generator,
    starts: int,
    *,
    inside: bool = False,
) -> float:
    """How near the object comes to a point with closed loops, by scipy [m].

    Args:
        chain: whose.
        goal: the point.
        rng: of the beginnings.
        starts: how many.
        inside: whether joints keep their position limits.
    """
    ends = (chain.lower, chain.upper) if inside else (-np.inf, np.inf)
    model, data = chain.model, chain.model.createData()

    def residual(q: Array) -> Array:
        pin.framesForwardKinematics(model, data, q)
        at = chain.alpha[0] * data.oMf[chain.frames[0]].translation
        for weight, frame in zip(chain.alpha[1:], chain.frames[1:], strict=True):
            at = at + weight * data.oMf[frame].translation
        return np.concatenate([at - goal, 30.0 * gap(chain, q)])

    def slope(q: Array) -> Array:
        J = chain.object_jacobians(q)[: chain.holding]
        mean = np.tensordot(chain.alpha[: chain.holding], J, axes=1)[:3]
        return np.vstack([mean, 30.0 * (J[1:] - J[0]).reshape(-1, chain.n)])

    nearest = np.inf
    for i in range(starts):
        q = chain.q_start + (rng.normal(scale=0.7, size=chain.n) if i else 0.0)
        if inside:
            q = np.clip(q, chain.lower + 1e-6, chain.upper - 1e-6)
        answer = least_squares(residual, q, slope, bounds=ends, method="trf", max_nfev=300)
        if np.abs(gap(chain, answer.x)).max() < 2e-3:
            nearest = min(nearest, float(np.linalg.norm(answer.fun[:3])))
    return nearest


def far(seed: int) -> Iterator[Case]:
    """Points that no configuration reaches, endlessly."""
    rng = np.random.default_rng(seed)
    scenarios = {name: base(name) for name in ROBOTS}
    while True:
        for name, scenario in scenarios.items():
            chain = scenario.chain
            way = rng.normal(size=3)
            if name == "planar pair":
                way[2] = 0.0
            way /= np.linalg.norm(way)
            goal = chain.start_position + way * rng.uniform(0.2, 1.5) * chain.reach
            if scipy_distance(chain, goal, rng, 4) < 5.0 * REACHED:
                continue
            x, y, z = goal.tolist()
            task = PointOnPoint(name="reach", goal=(x, y, z), profile=PROFILE)
            yield Case(name, with_tasks(scenario, task))


# Tasks that contradict each other


def pairs(seed: int) -> Iterator[tuple[Case, set[str]]]:
    """Two tasks of one point or axis that want it in two places, and at times a third beside."""
    rng = np.random.default_rng(seed)
    scenarios = {name: base(name) for name in ROBOTS}
    kinds = (two_planes, two_points, two_axes, plane_and_point)
    while True:
        for name, scenario in scenarios.items():
            kind = kinds[int(rng.integers(len(kinds)))]
            if name == "planar pair":
                kind = two_points if kind is two_axes else kind
            two = kind(scenario.chain, rng)
            modes = rng.choice(["soft", "soft", "hard", "scaled"], size=2)
            two = [
                replace(task, mode=str(mode), priority=int(rng.integers(2)))
                for task, mode in zip(two, modes, strict=True)
            ]
            names = {task.name for task in two}
            if rng.random() < 0.5:
                two.insert(int(rng.integers(3)), bystander(scenario.chain))
            yield Case(name, with_tasks(scenario, *two)), names


def near(chain: ClosedChain, rng: np.random.Generator) -> Array:
    """A point a few centimetres from the start, in the plane of planar robots."""
    way = rng.normal(size=3) * (1.0, 1.0, 0.0 if "planar" in chain.robot.name else 1.0)
    return np.asarray(chain.start_position + rng.uniform(0.01, 0.03) * way / np.linalg.norm(way))


def two_planes(chain: ClosedChain, rng: np.random.Generator) -> list[Task]:
    """One height above the other."""
    x, y, z = near(chain, rng).tolist()
    axis = np.array((1.0, 0.0, 0.0)) if "planar" in chain.robot.name else rng.normal(size=3)
    axis /= np.linalg.norm(axis)
    other = np.array((x, y, z)) + rng.uniform(0.005, 0.03) * axis
    a, b, c = axis.tolist()
    return [
        PointOnPlane(name="low", normal=(a, b, c), through=(x, y, z), profile=PROFILE),
        PointOnPlane(name="high", normal=(a, b, c), through=tuple(other.tolist()), profile=PROFILE),
    ]


def two_points(chain: ClosedChain, rng: np.random.Generator) -> list[Task]:
    """The object's origin in two places."""
    return [
        PointOnPoint(name=name, goal=tuple(near(chain, rng).tolist()), profile=PROFILE)
        for name in ("here", "there")
    ]


def two_axes(chain: ClosedChain, rng: np.random.Generator) -> list[Task]:
    """One axis of the object along two directions."""
    R = chain.object_pose(chain.q_start).rotation
    tilted = [R @ pin.exp3(turn * np.array((0.0, 1.0, 0.0))) for turn in (0.15, -0.1)]
    return [
        Pointing(
            name=f"look{i}", axis=(1, 0, 0), direction=tuple(T[:, 0].tolist()), profile=PROFILE
        )
        for i, T in enumerate(tilted)
    ]


def plane_and_point(chain: ClosedChain, rng: np.random.Generator) -> list[Task]:
    """A point that does not lie on the plane."""
    plane, _ = two_planes(chain, rng)
    assert isinstance(plane, PointOnPlane)
    off = np.array(plane.through) - 0.02 * np.array(plane.normal)
    return [plane, PointOnPoint(name="point", goal=tuple(off.tolist()), profile=PROFILE)]


def bystander(chain: ClosedChain) -> Task:
    """A task that has no part in the contradiction: the object stays as it is turned."""
    rpy = pin.rpy.matrixToRpy(chain.object_pose(chain.q_start).rotation)
    if "planar" in chain.robot.name:
        return Orientation(name="turned", rpy=tuple(rpy.tolist()), profile=PROFILE, weight=1e-3)
    p = chain.object_pose(chain.q_start).act(np.array((0.0, 0.0, 0.5)))
    axis = (0.0, 1.0, 0.0)
    through = tuple((p + np.array((0.0, 0.5, 0.0))).tolist())
    return PointOnPlane(name="beside", normal=axis, through=through, point=(0.0, 0.5, 0.5))
