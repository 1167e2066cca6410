"""A random problem for a plant with masses, and what its controller is not told.

Everything is such that arms with masses can do it: references that move smoothly, moderate gains,
joints kept from their stops by a little more than the encoders' error.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from coopqp.checked import Array
from coopqp.closed_chain import ClosedChain
from coopqp.controller import ControlProblem
from coopqp.disturbance import Disturbance, Push, Slip
from coopqp.limits import JointPosition, JointVelocity
from coopqp.profile import Profile
from coopqp.solver import Solver
from coopqp.study.stress import arrangements, goals
from coopqp.study.stress.draw import DAQP, KAPPAS, PERIODS, Draw, walk
from coopqp.task import Task
from coopqp.tasks import JointCentering

#: Arrangements whose robots have masses, and hinges in the hands at most.
ROBOTS = ("nao_t14", "two_pandas", "baxter", "tiago", "three_ur")
GRASPS = ("rigid", "revolute", "revolute one")
#: A twist does not come to rest.
KINDS = [kind for kind in goals.BUILDERS if kind not in ("twist", "relative_motion")]
MARGIN = 0.006  # kept free before the stops; the encoders' error is 5 mrad [rad]
#: The paper's 0 lets the commanded loops drift up to the budget, which squeezes.
CORRECTED = [name for name, kappa in KAPPAS.items() if kappa]
GRAVITY = 9.81  # [m/s2]


@dataclass(frozen=True)
class DrawWithMasses(Draw):
    """A random problem for a plant with masses.

    Attributes:
        goal: "in reach" or "anywhere".
        disturbance: what the controller is not told.
    """

    goal: str
    disturbance: Disturbance

    @property
    def without_errors(self) -> Disturbance:
        """The same mass and push, with a perfect model and perfect sensors."""
        return Disturbance(object_mass=self.disturbance.object_mass, push=self.disturbance.push)

    @property
    def errors(self) -> str:
        """Whether there are errors, in a word."""
        return "none" if self.disturbance == self.without_errors else "some"


def draw_with_masses(seed: int, solver: Solver = DAQP) -> DrawWithMasses:
    """The problem that belongs to a seed, the same for every solver and plant."""
    rng = np.random.default_rng(seed)
    robot = goals.pick(rng, [name for name in ROBOTS if name in arrangements.names()])
    grasp = goals.pick(rng, GRASPS)
    first = arrangements.chain(robot, grasp)
    chain = first.moved(walk(rng, first))
    dt, kappa, reach = goals.pick(rng, PERIODS), goals.pick(rng, CORRECTED), rng.random() < 0.5
    X = chain.object_pose(walk(rng, chain, stay=not reach))
    tasks = tuple(
        _task(
            rng, goals.random_aim(rng, X if reach else goals.anywhere(rng, X, chain.reach)), f"t{i}"
        )
        for i in range(int(rng.integers(1, 4)))
    )
    problem = ControlProblem(
        chain=chain,
        tasks=tasks,
        secondary=(JointCentering(gain=0.5),) if rng.random() < 0.5 else (),
        limits=(JointPosition(margin=MARGIN), JointVelocity(scale=float(rng.uniform(0.2, 0.8)))),
        dt=dt,
        kappa=KAPPAS[kappa] / dt,
        solver=solver,
    )
    return DrawWithMasses(
        robot, grasp, "", "", kappa, tuple(f"{task.mode} {type(task).__name__}" for task in tasks),
        problem, "in reach" if reach else "anywhere", _disturbance(rng, chain),
    )  # fmt: skip


def _task(rng: np.random.Generator, aim: goals.Aim, name: str) -> Task:
    profile = Profile(
        kind="quintic" if rng.random() < 0.5 else "trapezoid", duration=float(rng.uniform(1.0, 2.0))
    )
    common: goals.Common = {
        "name": name,
        "mode": goals.pick(rng, ["soft", "soft", "hard", "scaled"]),
        "priority": int(rng.integers(0, 2)),
        "weight": float(10.0 ** rng.uniform(-1.0, 1.0)),
        "gain": float(rng.uniform(2.0, 10.0)),
        "profile": profile,
    }
    return goals.BUILDERS[goals.pick(rng, KINDS)](aim, common)


def _disturbance(rng: np.random.Generator, chain: ClosedChain) -> Disturbance:
    """Another mass, a push in a third, and errors in three quarters of the draws."""
    told = Disturbance(object_mass=float(2.0 ** rng.uniform(-1.0, 1.0)), push=_push(rng, chain))
    if rng.random() < 0.25:
        return told
    sizes: Array = rng.uniform(size=4) * (rng.random(4) < 2.0 / 3.0)
    length, encoder, offset, angle = (sizes * [2e-3, 5e-3, 2e-3, 5e-3]).tolist()
    slip = Slip(at=float(rng.uniform(0.2, 1.0)), by=float(rng.uniform(1e-3, 5e-3)))
    return replace(
        told,
        link_length=length,
        encoder_offset=encoder,
        grasp_offset=offset,
        grasp_offset_angle=angle,
        slip=slip if rng.random() < 0.25 else None,
        noise_position=1e-4 if rng.random() < 0.5 else 0.0,
        delay=int(rng.integers(0, 3)),
    )


def _push(rng: np.random.Generator, chain: ClosedChain) -> Push | None:
    """Half to twice the object's weight, while it moves."""
    force: Array = rng.normal(size=3)
    force *= rng.uniform(0.5, 2.0) * GRAVITY * chain.held.mass / np.linalg.norm(force)
    start, duration = rng.uniform([0.0, 0.2], [1.5, 0.5]).tolist()
    if rng.random() >= 1.0 / 3.0:
        return None
    return Push(force=goals.vector(force), start=start, duration=duration)
