"""A session that belongs to a seed: robot, plant, motion, errors and fault, and what came of it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pinocchio as pin
from walks import vector, walk

import coopqp
from coopqp import OnlineLoop
from coopqp.base.spec import Array
from coopqp.base.spec import Pose as Place
from coopqp.closed_loop.admittance import Admittance
from coopqp.controller import Command
from coopqp.controllers import QPController
from coopqp.limits import JointPosition, JointVelocity
from coopqp.model.profile import Profile
from coopqp.online.simulated import SimulatedRobot
from coopqp.plant import FAULTS, Disturbance, Fault
from coopqp.plants import QuasiStatic, RigidBody
from coopqp.scenario.scenario import Scenario
from coopqp.solver import HALTS, Status
from coopqp.task import Task
from coopqp.tasks import InternalWrench, JointCentering, PointOnPoint, Pose

#: Shipped scenarios whose robots, objects and grasps are taken, and whether six joints hold a pose.
ROBOTS = {
    "point_on_point": False, "two_pandas": True, "three_ur": True, "baxter_tray": True,
    "two_so101": False,
}  # fmt: skip
#: Squeeze of hands whose force sensors are tried [N], and how stiff hands and servos are [N/m].
SQUEEZE, STIFFNESS = 10.0, 2e4
#: Kinds beside those of ``disturbance.faults``: a load 2 to 4 times as heavy as told.
HEAVIER = "load_heavier"
KINDS = (*(kind for kind in FAULTS if kind != "force_scaled"), HEAVIER)
MARGIN = 0.006  # kept free before the stops; the encoders' error is 5 mrad [rad]
DURATION = 4.0  # [s]
#: A fault has an effect from so much internal force on, above what is wanted, and from what the
#: same session has at most without the fault [N]; hands may be told to part or close so far [m].
EFFECT, OPENED = 10.0, 5e-3


@dataclass(frozen=True)
class Session:
    """What came of it.

    Attributes:
        robot, plant, fault, where: as drawn; no fault is "".
        effect: when the internal force exceeded ``EFFECT``, and what it is at most without the
            fault; NaN if it never did [s].
        named: when a fault was found; NaN if none was [s]. kind, found: which, and where.
        right: whether what was found is where the fault is.
        force_named: internal force when it could first be named; most: largest later [N].
        doubted: whether it braked before a fault was found, or where none was.
        overloaded: whether a motor was at its limit for a tenth of a second before.
        opened: how far the loop itself told the hands to part or close, beyond what an encoder's
            fault makes of it: a reading that is off by d moves its hand by J d unseen; where that
            is more than ``OPENED``, beyond what is told without the fault, too, since soft arms
            that squeeze close by as much [m].
        broken: promises that were not kept.
    """

    seed: int
    robot: str = ""
    plant: str = ""
    fault: str = ""
    where: tuple[str, ...] = ()
    effect: float = np.nan
    named: float = np.nan
    kind: str = ""
    found: tuple[str, ...] = ()
    right: bool = False
    force_named: float = 0.0
    most: float = 0.0
    doubted: bool = False
    overloaded: bool = False
    opened: float = 0.0
    stopped: str = ""
    broken: tuple[str, ...] = ()


@cache
def _base(robot: str) -> Scenario:
    return coopqp.load(robot)


def draw(seed: int, *, sound: bool) -> tuple[str, Scenario, Fault | None, str]:
    """Robot, scenario, its fault and the fault's kind."""
    rng = np.random.default_rng([seed, int(sound)])
    robot = list(ROBOTS)[seed % len(ROBOTS)]
    kind = "" if sound else KINDS[(seed // len(ROBOTS)) % len(KINDS)]
    base = _base(robot)
    chain = base.problem().chain
    X = chain.object_pose(walk(rng, chain))
    profile = Profile(
        kind="quintic" if rng.random() < 0.5 else "trapezoid", duration=float(rng.uniform(1.0, 2.5))
    )
    common = {"name": "carry", "gain": 5.0, "profile": profile}
    p = vector(X.translation)
    if ROBOTS[robot]:
        place = Place(position=p, rpy=vector(pin.rpy.matrixToRpy(X.rotation)))
        task: Task = Pose(goal=place, **common)
    else:
        task = PointOnPoint(goal=p, **common)
    tasks, controllers = (task,), {"qp": QPController()}
    if chain.holding == 2 and (kind.startswith("force") or rng.random() < 0.3):
        tasks = (task, InternalWrench(name="press", squeeze=SQUEEZE))
        controllers = {"qp": QPController(admittance=Admittance(stiffness=STIFFNESS))}
    sizes: Array = rng.uniform(size=4) * (rng.random(4) < 2.0 / 3.0)
    length, encoder, offset, angle = (sizes * [1e-3, 5e-3, 2e-3, 5e-3]).tolist()
    joints = [j for i, j in enumerate(chain.joint_names) if i not in set(chain.passive.tolist())]
    arms = [arm.name for arm in chain.robot.arms]
    fault = _fault(rng, kind, joints, arms)
    disturbance = Disturbance(
        object_mass=float(rng.uniform(2.0, 4.0)) if kind == HEAVIER else 1.0,
        link_length=length, encoder_offset=encoder, grasp_offset=offset, grasp_offset_angle=angle,
        noise_position=float(rng.uniform(0.0, 1e-3)), delay=int(rng.integers(0, 6)),
        faults=() if fault is None else (fault,),
    )  # fmt: skip
    plant = RigidBody() if rng.random() < 0.5 else QuasiStatic()
    scenario = replace(
        base, tasks=tasks, secondary=(JointCentering(gain=0.5),), controllers=controllers,
        limits=(JointPosition(margin=MARGIN), JointVelocity(scale=float(rng.uniform(0.2, 0.8)))),
        plant=plant, disturbance=disturbance, seed=seed, duration=DURATION,
    )  # fmt: skip
    return robot, scenario, fault, kind


def _fault(rng: np.random.Generator, kind: str, joints: list[str], arms: list[str]) -> Fault | None:
    start = float(rng.uniform(0.0, 0.8))
    if kind in ("", HEAVIER):
        return None
    keys: dict[str, object] = {}
    if "joint" in FAULTS[kind]:
        keys["joint"] = joints[rng.integers(len(joints))]
    if "joints" in FAULTS[kind]:
        own = len(joints) // len(arms)
        first = int(rng.integers(len(arms))) * own
        a, b = rng.choice(own, 2, replace=False) + first
        keys["joints"] = (joints[a], joints[b])
    if "arm" in FAULTS[kind]:
        keys["arm"] = arms[rng.integers(len(arms))]
    if "by" in FAULTS[kind]:
        keys["by"] = float(rng.choice([-1.0, 1.0]) * rng.uniform(5e-3, 0.1))
    return Fault(kind=kind, start=start, **keys)


def run(seed: int, *, sound: bool) -> Session:
    """Run the session of a seed."""
    robot, scenario, fault, kind = draw(seed, sound=sound)
    found = _ran(seed, robot, scenario, fault, kind)
    if sound or (found.opened <= OPENED and found.effect != found.effect):
        return found
    well = replace(scenario.disturbance, faults=(), object_mass=1.0)
    usual = _ran(seed, robot, replace(scenario, disturbance=well), None, kind)
    if usual.most > EFFECT:  # by noise, say
        found = _ran(seed, robot, scenario, fault, kind, usual.most)
    opened = found.opened - usual.opened if found.opened > OPENED else found.opened
    return replace(found, opened=max(0.0, opened))


def _ran(
    seed: int, robot: str, scenario: Scenario, fault: Fault | None, kind: str, usual: float = EFFECT
) -> Session:
    loop = OnlineLoop(scenario, clock=None)
    simulated = SimulatedRobot(loop)
    watch = _Watch(
        loop, simulated, SQUEEZE if len(scenario.tasks) > 1 else 0.0, fault.start if fault else 0.0
    )
    names = loop.problem.chain.joint_names
    if fault and kind.startswith("encoder"):
        wrong = fault.joints or ((fault.joint,) if fault.joint else names)
        watch.wrong = [names.index(name) for name in wrong]
    for _ in range(round(DURATION / scenario.dt)):
        inputs = {"hand_wrench": simulated.plant.hand_wrench}
        command = loop.tick(simulated.read(), inputs)
        watch.look(command)
        simulated.write(loop.setpoint, command.v)
        if loop.stopped and loop.at_rest and watch.ticks_at_rest > 50:
            break
    where = (
        () if fault is None else (*(fault.joints or ()), *filter(None, (fault.joint or fault.arm,)))
    )
    return watch.session(seed, robot, type(scenario.plant).__name__, kind, where, usual)


class _Watch:
    """What is promised of every tick, and what is measured."""

    def __init__(
        self, loop: OnlineLoop, robot: SimulatedRobot, squeeze: float, since: float
    ) -> None:
        self._since, self._loaded = since, np.zeros(1)
        self._loop, self._robot, self._squeeze = loop, robot, squeeze
        self._forces: list[float] = []
        self._opened, self._start, self._broken = 0.0, None, []
        self._named, self._doubted = -1, False
        self._misled = 0.0  # what the fault makes of the loop, at most so far [m]
        self.ticks_at_rest = 0
        self.wrong: list[int] = []  # joints whose readings are wrong

    def look(self, command: Command) -> None:
        loop, k = self._loop, len(self._forces)
        self.ticks_at_rest = self.ticks_at_rest + 1 if loop.at_rest else 0
        wrenches = self._robot.plant.signals["internal_wrench"].reshape(-1, 6)
        force = float(np.linalg.norm(wrenches[:, :3], axis=1).max())
        self._forces.append(max(0.0, force - self._squeeze))
        if self._named < 0 and "saturated" in self._robot.plant.signals:
            share = self._robot.plant.signals["saturated"]
            self._loaded = self._loaded + share * loop.problem.dt
        halts = HALTS & set(command.causes)
        self._doubted |= Status.JOINT_DOUBTED in halts
        told = loop.faults or loop.stopped or halts - {Status.JOINT_DOUBTED}
        if self._named < 0 and (told or Status.NOT_MEASURED in command.causes):
            self._named = k
        if not loop.begun:
            return
        chain = loop.problem.chain
        e = loop.state.loop_error
        if self._start is None:
            self._start = e.copy()
        if self.wrong:
            self._misled = max(self._misled, self._parted(self._unseen()))
        self._opened = max(self._opened, self._parted(e - self._start) - self._misled)
        beyond = max((chain.lower - loop.setpoint).max(), (loop.setpoint - chain.upper).max())
        fast = (np.abs(command.v) - chain.velocity * (1.0 + 1e-3)).max()
        if not np.isfinite(loop.setpoint).all():
            self._broken.append("a command is not finite")
        if beyond > 1e-4 and chain.starts_inside:
            self._broken.append(f"a command is {beyond:.2g} beyond its joint's range")
        if fast > 0.0:
            self._broken.append("a command is faster than its joint may be")

    def _unseen(self) -> Array:
        """What wrong readings hide of the loop error, to first order."""
        plant, state = self._robot.plant, self._loop.state
        d = np.zeros(len(state.q))
        d[self.wrong] = (plant.truth(state).q - plant.measured)[self.wrong]
        return np.asarray(state.J_rel @ d)

    def _parted(self, error: Array) -> float:
        holding = self._loop.problem.chain.holding
        parts = error.reshape(-1, 6)[: holding - 1, :3]
        return float(np.linalg.norm(parts, axis=1).max())

    def session(
        self, seed: int, robot: str, plant: str, kind: str, where: tuple[str, ...], usual: float
    ) -> Session:
        loop, dt = self._loop, self._loop.problem.dt
        F = np.array(self._forces)
        at = np.flatnonzero((usual < F) & (np.arange(len(F)) * dt >= self._since))
        named = self._named
        first = loop.faults[0] if loop.faults else None
        right = bool(first and (not where or set(first.where) & set(where)))
        return Session(
            seed, robot, plant, kind, where,
            effect=at[0] * dt if len(at) else np.nan,
            named=named * dt if named >= 0 else np.nan,
            kind=first.kind if first else loop.status.name if named >= 0 else "",
            found=first.where if first else (),
            right=right, stopped=loop.stopped, overloaded=bool(self._loaded.max() > 0.1),
            force_named=float(F[named]) if named >= 0 else 0.0,
            most=float(F[max(0, named) :].max(initial=0.0)), opened=self._opened,
            doubted=self._doubted, broken=tuple(dict.fromkeys(self._broken)),
        )  # fmt: skip
