"""A whole random problem from one seed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from walks import vector, walk

from coopqp.controller import ControlProblem, OnInfeasible
from coopqp.controllers import QPController
from coopqp.limit import Limit
from coopqp.limits import JointAcceleration, JointPosition, JointVelocity, ObjectSpeed, Workspace
from coopqp.model.closed_chain import ClosedChain
from coopqp.solver import Solver
from coopqp.solvers.daqp import Daqp
from coopqp.task import Task
from coopqp.tasks import JointCentering, Manipulability, MinimumVelocity, Posture

from . import arrangements, goals
from .goals import pick

PERIODS = (0.005, 0.01, 0.02)  # [s]
DAQP = Daqp()
LAW = QPController()  # what is tried out
KAPPAS = {"0": 0.0, "0.1/dt": 0.1, "1/dt": 1.0}  # times 1/dt


@dataclass(frozen=True)
class Draw:
    """A random problem, and what is drawn of it in words.

    The start is "inside" or "outside" the position limits, those are "tight" or "loose".
    """

    robot: str
    grasp: str
    start: str
    limits: str
    kappa: str
    tasks: tuple[str, ...]
    problem: ControlProblem


def draw(seed: int, solver: Solver = DAQP) -> Draw:
    """The problem that belongs to a seed, the same for every solver."""
    rng = np.random.default_rng(seed)
    robot = pick(rng, arrangements.names())
    grasp = pick(rng, arrangements.grasps_of(robot))
    outside, tight = bool(rng.random() < 0.3), bool(rng.random() < 0.5)
    first = arrangements.chain(robot, grasp)
    chain = first.moved(walk(rng, first, outside=outside))
    dt, kappa = pick(rng, PERIODS), pick(rng, tuple(KAPPAS))
    tasks = _tasks(rng, chain, dt)
    problem = ControlProblem(
        chain=chain,
        tasks=tasks,
        secondary=_secondary(rng, chain, planar=robot == arrangements.PLANAR),
        limits=_limits(rng, chain, dt, tight=tight),
        dt=dt,
        kappa=KAPPAS[kappa] / dt,
        solver=solver,
        on_infeasible=_on_infeasible(rng),
    )
    return Draw(
        robot,
        grasp,
        "inside" if chain.starts_inside else "outside",
        "tight" if tight else "loose",
        kappa,
        tuple(f"{task.mode} {type(task).__name__}" for task in tasks),
        problem,
    )


def _tasks(rng: np.random.Generator, chain: ClosedChain, dt: float) -> tuple[Task, ...]:
    """One to four; in half of the draws all belong to one pose that the arms reach."""
    kinds = [k for k in goals.BUILDERS if k != "relative_motion" or chain.holding < len(chain.arms)]
    reach = rng.random() < 0.5
    X = chain.object_pose(walk(rng, chain, stay=not reach))
    tasks = []
    for i in range(int(rng.integers(1, 5))):
        aim = goals.some_aim(rng, X, chain, reach=reach)
        build = goals.BUILDERS[pick(rng, kinds)]
        tasks.append(build(aim, goals.common(rng, dt, f"t{i}")))
    return tuple(tasks)


def _secondary(rng: np.random.Generator, chain: ClosedChain, *, planar: bool) -> tuple[Task, ...]:
    posture, profile = chain.sample(rng, 1)[0].tolist(), goals.profile(rng)
    level = int(rng.integers(0, 2))
    builders: list[Callable[[], Task]] = [
        lambda: JointCentering(gain=0.5),
        lambda: Posture(goal=posture, gain=1.0, profile=profile),
        lambda: MinimumVelocity(priority=level),
        lambda: Manipulability(axes=("x", "y") if planar else ("x", "y", "z"), gain=0.5),
    ]
    return tuple(build() for build in builders if rng.random() < 0.25)


def _limits(
    rng: np.random.Generator, chain: ClosedChain, dt: float, *, tight: bool
) -> tuple[Limit, ...]:
    margin = float(rng.uniform(0.0, 0.1)) if tight else 0.0
    limits: list[Limit] = [
        JointPosition(margin=margin),
        JointVelocity(scale=float(rng.uniform(0.1, 0.4)) if tight else 1.0),
    ]
    if rng.random() < 0.35:
        most = float(10.0 ** rng.uniform(0.7, 2.5))
        limits.append(JointAcceleration(max=most, margin=margin))
    if rng.random() < 0.25:
        linear, angular = rng.uniform([0.02, 0.1], [0.5, 2.0]).tolist()
        limits.append(ObjectSpeed(linear=linear, angular=angular))
    if rng.random() < 0.25:
        limits.append(_workspace(rng, chain, dt))
    return tuple(limits)


def _workspace(rng: np.random.Generator, chain: ClosedChain, dt: float) -> Workspace:
    """A wall up to 10 cm from the object."""
    normal = rng.normal(size=3)
    normal /= np.linalg.norm(normal)
    X = chain.object_pose(chain.q_start)
    size = np.array(chain.held.size)
    depth = float(np.abs(X.rotation.T @ normal) @ size) / 2.0
    through = X.translation - (depth + rng.uniform(0.0, 0.1)) * normal
    gain = float(rng.uniform(2.0, 1.0 / dt))
    return Workspace(normal=vector(normal), through=vector(through), gain=gain)


def _on_infeasible(rng: np.random.Generator) -> OnInfeasible:
    """Mostly scale."""
    x = rng.random()
    return "hold" if x < 0.1 else "stop" if x < 0.15 else "scale"
