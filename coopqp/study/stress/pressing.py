"""A random problem for hands that press, and what its controller is not told."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin

from coopqp.checked import Array
from coopqp.closed_chain import ClosedChain
from coopqp.controller import ControlProblem
from coopqp.controllers import TorqueQp
from coopqp.disturbance import Disturbance, Push
from coopqp.grasp import Grasp
from coopqp.grasps import PointContact, SurfaceContact
from coopqp.limits import JointPosition, JointVelocity
from coopqp.profile import Profile
from coopqp.solver import Solver
from coopqp.study.stress import arrangements, goals
from coopqp.study.stress.draw import DAQP, walk
from coopqp.study.stress.masses import GRAVITY
from coopqp.task import Task
from coopqp.tasks import InternalWrench

#: Two hands that can press from both sides, and the heaviest object [kg].
HEAVIEST = {"nao_t14": 0.3, "two_pandas": 3.0, "baxter": 2.0}
KINDS = ("point_on_point", "pose", "orientation")
#: What the controller is not told, besides nothing.
ERRORS = ("none", "none", "push", "friction", "mass", "all")
DT = 0.002  # [s]
NOTHING = Disturbance()


@dataclass(frozen=True)
class PressingDraw:
    """A random problem.

    Attributes:
        robot: of the arrangement.
        grasp: "pads", or "fingertip" where the first hand is one.
        errors: what the controller is not told, in a word.
        tasks: their types and modes.
        problem: all of it.
        controller: with a random safety.
        disturbance: what the controller is not told.
    """

    robot: str
    grasp: str
    errors: str
    tasks: tuple[str, ...]
    problem: ControlProblem
    controller: TorqueQp
    disturbance: Disturbance


def draw_pressing(seed: int, solver: Solver = DAQP) -> PressingDraw:
    """The problem that belongs to a seed, the same for every solver.

    Raises:
        CoopqpError: the draw is one that nobody can hold.
    """
    rng = np.random.default_rng(seed)
    robot = goals.pick(rng, [name for name in HEAVIEST if name in arrangements.names()])
    grasp, errors = goals.pick(rng, ["pads", "pads", "fingertip"]), goals.pick(rng, ERRORS)
    firm = arrangements.chain(robot, "rigid")
    chain = _pressing(rng, firm, walk(rng, firm), grasp, HEAVIEST[robot])
    tasks, wrenches = _tasks(rng, chain), _wrenches(rng, chain)
    problem = ControlProblem(
        chain=chain,
        tasks=tasks,
        wrenches=wrenches,
        limits=(JointPosition(), JointVelocity()),
        dt=DT,
        kappa=goals.pick(rng, [0.02, 0.1]) / DT,
        solver=solver,
    )
    return PressingDraw(
        robot, grasp, errors, tuple(f"{t.mode} {type(t).__name__}" for t in (*tasks, *wrenches)),
        problem, TorqueQp(safety=float(rng.uniform(1.0, 2.0))), _disturbance(rng, chain, errors),
    )  # fmt: skip


def _pressing(
    rng: np.random.Generator, firm: ClosedChain, q: Array, grasp: str, heaviest: float
) -> ClosedChain:
    """Pads, and perhaps a fingertip, at the tips of two hands; their x axis points up."""
    data = firm.model.createData()
    pin.framesForwardKinematics(firm.model, data, q)
    tips = [data.oMf[firm.model.getFrameId(arm.tip)] for arm in firm.arms]
    e = tips[1].translation - tips[0].translation
    half, mu = rng.uniform(0.01, 0.04, 2).tolist(), float(rng.uniform(0.2, 1.0))
    kinds = [PointContact if grasp == "fingertip" else SurfaceContact, SurfaceContact]
    grasps: dict[str, Grasp] = {}
    for arm, tip, kind, sign in zip(firm.arms, tips, kinds, (1.0, -1.0), strict=True):
        normal = goals.vector(tip.rotation.T @ (sign * e))
        along = goals.vector(tip.rotation.T[:, 2])
        if kind is PointContact:
            grasps[arm.name] = PointContact(normal=normal, along=along, friction=mu)
        else:
            grasps[arm.name] = SurfaceContact(
                normal=normal, along=along, friction=mu, half_lengths=(half[0], half[1])
            )
    mass = float(heaviest * rng.uniform(0.1, 1.0))
    return ClosedChain.take_hold(firm.robot, q, grasps, replace(firm.held, mass=mass, pose=None))


def _tasks(rng: np.random.Generator, chain: ClosedChain) -> tuple[Task, ...]:
    """One that the arms can do, soft or hard, gentle or not."""
    aim = goals.random_aim(rng, chain.object_pose(walk(rng, chain)))
    common: goals.Common = {
        "name": "move",
        "mode": goals.pick(rng, ["soft", "soft", "soft", "hard"]),
        "priority": 0,
        "weight": float(10.0 ** rng.uniform(-1.0, 1.0)),
        "gain": float(rng.uniform(2.0, 20.0)),
        "profile": Profile(kind="quintic", duration=float(rng.uniform(0.3, 1.5))),
    }
    return (goals.BUILDERS[goals.pick(rng, KINDS)](aim, common),)


def _wrenches(rng: np.random.Generator, chain: ClosedChain) -> tuple[Task, ...]:
    """A squeeze in a third of the draws: once to four times the weight."""
    newtons = float(rng.uniform(1.0, 4.0)) * GRAVITY * chain.held.mass
    return (InternalWrench(squeeze=newtons),) if rng.random() < 1.0 / 3.0 else ()


def _disturbance(rng: np.random.Generator, chain: ClosedChain, errors: str) -> Disturbance:
    force: Array = rng.normal(size=3)
    force *= rng.uniform(0.2, 2.0) * GRAVITY * chain.held.mass / np.linalg.norm(force)
    push = Push(force=goals.vector(force), start=float(rng.uniform(0.0, 0.3)), duration=0.2)
    friction, mass = rng.uniform([0.4, 0.7], [1.0, 2.0]).tolist()
    com = goals.vector(rng.uniform(-0.02, 0.02, 3))
    told = {
        "push": {"push": push},
        "friction": {"friction": friction},
        "mass": {"object_mass": mass, "object_com": com},
    }
    which = list(told) if errors == "all" else [errors] if errors in told else []
    return replace(NOTHING, **{key: value for name in which for key, value in told[name].items()})
