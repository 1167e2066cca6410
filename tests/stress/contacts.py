"""Random rollouts of hands that press, on rigid bodies: what the torque QP says it keeps, it keeps.

A loss is named after what the law gave up, or after the errors without which the draw is held.
What is lost without errors, though the law gave nothing up, breaks the promise: a pad that tips
over its edge, or what has no name.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field, replace

import numpy as np
import pinocchio as pin
from pads import friction_for
from walks import vector, walk

from coopqp.base.errors import CoopqpError
from coopqp.base.spec import Array
from coopqp.closed_loop.hands import into_contacts
from coopqp.controller import Command, ControlProblem
from coopqp.controllers import TorqueQp
from coopqp.controllers.torque_qp import TorqueQpLaw
from coopqp.execution.rollout import drive
from coopqp.grasp import NO_CONTACT, Grasp
from coopqp.grasps import PointContact, SurfaceContact
from coopqp.limits import JointPosition, JointVelocity
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.profile import Profile
from coopqp.model.state import State
from coopqp.plant import Disturbance, Push
from coopqp.plants.rigid_body import RigidBody
from coopqp.solver import Solver, Status
from coopqp.task import Task
from coopqp.tasks import InternalWrench

from . import arrangements, goals
from .draw import DAQP
from .goals import pick
from .masses import GRAVITY, random_force
from .trial import tried

#: Two hands that can press from both sides, and the heaviest object [kg].
HEAVIEST = {"nao_t14": 0.3, "two_pandas": 3.0, "baxter": 2.0}
KINDS = ("point_on_point", "pose", "orientation")
#: What the controller is not told, besides nothing.
ERRORS = ("none", "none", "push", "friction", "mass", "all")
DT = 0.002  # [s]
NOTHING = Disturbance()

TICKS = 300
EVERY = 10  # ticks in which round cones are asked as well
KEPT = 1e-6  # a row may be left by rounding [N, N m]
ROUND = 1.01  # friction of round cones is told to half a percent
SOLD = 1e-9  # a motor may be beyond its limit by rounding [N m]
OUTCOMES = ("held", "lost", "refused")
BODIES = RigidBody()


@dataclass(frozen=True)
class PressingDraw:
    """A random problem of "pads", or of a "fingertip" in the first hand.

    Attributes:
        errors, disturbance: what the controller is not told, in a word and in numbers.
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
    robot = pick(rng, [name for name in HEAVIEST if name in arrangements.names()])
    grasp, errors = pick(rng, ["pads", "pads", "fingertip"]), pick(rng, ERRORS)
    firm = arrangements.chain(robot, "rigid")
    chain = _pressing(rng, firm, walk(rng, firm), grasp, HEAVIEST[robot])
    tasks, wrenches = _tasks(rng, chain), _wrenches(rng, chain)
    problem = ControlProblem(
        chain=chain,
        tasks=tasks,
        wrenches=wrenches,
        limits=(JointPosition(), JointVelocity()),
        dt=DT,
        kappa=pick(rng, [0.02, 0.1]) / DT,
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
        normal = vector(tip.rotation.T @ (sign * e))
        along = vector(tip.rotation.T[:, 2])
        if kind is PointContact:
            grasps[arm.name] = PointContact(normal=normal, along=along, friction=mu)
        else:
            grasps[arm.name] = SurfaceContact(
                normal=normal, along=along, friction=mu, half_lengths=(half[0], half[1])
            )
    mass = float(heaviest * rng.uniform(0.1, 1.0))
    return ClosedChain.attach(firm.robot, q, grasps, replace(firm.held, mass=mass, pose=None))


def _tasks(rng: np.random.Generator, chain: ClosedChain) -> tuple[Task, ...]:
    """One that the arms can do, soft or hard, gentle or not."""
    aim = goals.random_aim(rng, chain.object_pose(walk(rng, chain)))
    common: goals.Common = {
        "name": "move",
        "mode": pick(rng, ["soft", "soft", "soft", "hard"]),
        "priority": 0,
        "weight": float(10.0 ** rng.uniform(-1.0, 1.0)),
        "gain": float(rng.uniform(2.0, 20.0)),
        "profile": Profile(kind="quintic", duration=float(rng.uniform(0.3, 1.5))),
    }
    return (goals.BUILDERS[pick(rng, KINDS)](aim, common),)


def _wrenches(rng: np.random.Generator, chain: ClosedChain) -> tuple[Task, ...]:
    """A squeeze in a third of the draws: once to four times the weight."""
    newtons = float(rng.uniform(1.0, 4.0)) * GRAVITY * chain.held.mass
    return (InternalWrench(squeeze=newtons),) if rng.random() < 1.0 / 3.0 else ()


def _disturbance(rng: np.random.Generator, chain: ClosedChain, errors: str) -> Disturbance:
    force = random_force(rng, chain, 0.2)
    push = Push(force=force, start=float(rng.uniform(0.0, 0.3)), duration=0.2)
    friction, mass = rng.uniform([0.4, 0.7], [1.0, 2.0]).tolist()
    com = vector(rng.uniform(-0.02, 0.02, 3))
    told = {
        "push": {"push": push},
        "friction": {"friction": friction},
        "mass": {"object_mass": mass, "object_com": com},
    }
    which = list(told) if errors == "all" else [errors] if errors in told else []
    return replace(NOTHING, **{key: value for name in which for key, value in told[name].items()})


@dataclass(frozen=True)
class ContactRollout:
    """How one rollout went.

    Attributes:
        outcome: one of ``OUTCOMES``; empty when it raised.
        reason: why it was lost or refused.
        cause: what a loss is named after: what gave up, or the errors; empty where nothing does.
        broken: promises that were broken, in words.
        given_up: ticks in which a cone was given up, or there was no answer.
        cone, torque: how far a cone that was kept, or a motor's limit, was left [N], [N m].
    """

    seed: int
    robot: str = ""
    grasp: str = ""
    errors: str = ""
    tasks: tuple[str, ...] = ()
    outcome: str = ""
    reason: str = ""
    cause: str = ""
    broken: tuple[str, ...] = ()
    ticks: int = 0
    given_up: int = 0
    cone: float = 0.0
    torque: float = 0.0


@dataclass
class Seen:
    """What a run shows.

    Attributes:
        ticks, given_up, cone, torque: as in :class:`ContactRollout`.
        round_left: whether round cones did not bear what the law said to keep.
        lost: why; empty while held.
        tipped: whether a pad's pressure was beyond its edge then.
    """

    ticks: int = 0
    given_up: Counter[str] = field(default_factory=Counter)
    cone: float = 0.0
    torque: float = 0.0
    round_left: bool = False
    lost: str = ""
    tipped: bool = False

    @property
    def broken(self) -> tuple[str, ...]:
        """Promises that were broken, in words."""
        said = {
            f"left a cone that it kept by {self.cone:.2g}": self.cone > KEPT,
            "left a round cone that it kept": self.round_left,
            f"exceeded a torque limit by {self.torque:.2g} N m": self.torque > SOLD,
        }
        return tuple(words for words, true in said.items() if true)


def contact_rollout(seed: int, solver: Solver = DAQP) -> ContactRollout:
    """Draw a rollout from a seed and run it."""
    return tried(_judged, ContactRollout, seed, solver)


def _judged(seed: int, solver: Solver) -> ContactRollout:
    drawn = draw_pressing(seed, solver)
    begun = ContactRollout(seed, drawn.robot, drawn.grasp, drawn.errors, drawn.tasks)
    try:
        drawn.controller.build(drawn.problem)
    except CoopqpError as error:
        return replace(begun, outcome="refused", reason=str(error))
    seen = watched(drawn, seed, drawn.disturbance)
    cause, unnamed = _named(drawn, seed, seen)
    return replace(
        begun,
        outcome="lost" if seen.lost else "held",
        reason=seen.lost,
        cause=cause,
        broken=(*seen.broken, *unnamed),
        ticks=seen.ticks,
        given_up=seen.given_up.total(),
        cone=seen.cone,
        torque=seen.torque,
    )


def _named(drawn: PressingDraw, seed: int, seen: Seen) -> tuple[str, tuple[str, ...]]:
    """What a loss is named after, and in words that it has no name."""
    if not seen.lost:
        return "", ()
    if seen.given_up:
        return "given up", ()
    exact = seen
    if drawn.disturbance != NOTHING:
        exact = watched(drawn, seed, NOTHING)
        if not exact.lost:
            return drawn.errors, ()
        if exact.given_up:
            return "given up", ()
    if exact.tipped:
        return "edge", (f"tips over a pad's edge that it kept: {exact.lost}",)
    return "", (f"lost without a name: {exact.lost}",)


def watched(drawn: PressingDraw, seed: int, disturbance: Disturbance) -> Seen:
    """Run a draw on rigid bodies, and look at every tick until the object is lost."""
    law = drawn.controller.build(drawn.problem)
    assert isinstance(law, TorqueQpLaw)
    plant = BODIES.build(drawn.problem, seed, disturbance)
    state, seen = law.start(), Seen()
    for command, _ in drive(law, plant, state, TICKS):
        if plant.lost:
            break
        look(law, state, command, seen)
    seen.lost = plant.lost
    seen.tipped = bool(plant.lost) and _tipped(
        law, plant.signals["hand_wrench"], plant.truth(state)
    )
    return seen


def _tipped(law: TorqueQpLaw, told: Array, true: State) -> bool:
    """Whether a hand presses, but no friction at all would bear what it does."""
    robot = [arm.name for arm in law.problem.chain.robot.arms]
    by_arm, turned = told.reshape(-1, 6), into_contacts(law.hands.hands, true.R_WO)
    for hand, R in zip(law.hands.hands, turned, strict=True):
        did = by_arm[robot.index(hand.arm)]
        w = np.concatenate([R @ did[:3], R @ did[3:]])
        assert hand.contact
        if w[2] > NO_CONTACT and np.isinf(friction_for(hand.contact, w)):
            return True
    return False


def look(law: TorqueQpLaw, state: State, command: Command, seen: Seen) -> None:
    """Check what a tick has commanded, and what it says that it keeps; write it into seen."""
    assert command.tau is not None
    seen.ticks += 1
    effort = law.problem.chain.model.effortLimit
    seen.torque = max(seen.torque, float((np.abs(command.tau) - effort).max()))
    for status in command.causes:
        if status is Status.CONTACT_GIVEN_UP or not status.usable:
            seen.given_up[status.name] += 1
            return
    h = law.programs[-1].solution.v[law.layout.h]
    left = (law.hands.cones @ h - law.hands.upper).max()
    seen.cone = max(seen.cone, float(left))
    if seen.ticks % EVERY == 1:
        seen.round_left |= not _borne(law, h, state)


def _borne(law: TorqueQpLaw, h: Array, state: State) -> bool:
    """Whether round cones bear what each hand does, with the friction that is counted on."""
    turned = into_contacts(law.hands.hands, state.R_WO)
    for hand, did, R in zip(law.hands.hands, h.reshape(-1, 6), turned, strict=True):
        assert hand.contact
        needed = friction_for(hand.contact, np.concatenate([R @ did[:3], R @ did[3:]]))
        if needed > ROUND * hand.contact.friction / law.settings.safety:
            return False
    return True
