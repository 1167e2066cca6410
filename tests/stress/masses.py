"""Random problems on plants with masses, run without and with errors of the model, and compared.

All is drawn so that arms with masses can do it: references that move smoothly, moderate gains,
joints kept from their stops by a little more than the encoders' error.

What squeezes and loads the arms where they rest is compared with what the statics tell. With
delta = q_c - q, from where the joints are to where they were told to be, servos of stiffness K and
feed-forward F hold arms of weight Gamma against the wrench lambda between the hands, while the
observer has brought the commanded loops to where the measured ones are:

    K delta + J' lambda = Gamma(q) - F(q),     J delta = J n

Without noise n all that squeezes is the feed-forward's error Gamma - F: of the object's mass, and
of the model. Each measurement has noise of deviation sigma; of it the observer's first-order filter
with share s lets sigma sqrt(s / (2 - s)) through. Nothing of this knows the QP law.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from walks import vector, walk

from coopqp.base.spec import Array
from coopqp.closed_loop.dynamics import ClosedLoopDynamics
from coopqp.controller import ControlProblem, Law
from coopqp.execution.rollout import drive
from coopqp.limits import JointPosition, JointVelocity
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.loop_observer import TICKS, TIME
from coopqp.model.profile import Profile
from coopqp.model.state import State
from coopqp.plant import Disturbance, Plant, PlantModel, Push, Slip
from coopqp.plants._dynamic import DynamicModel
from coopqp.solver import Solver
from coopqp.task import Task
from coopqp.tasks import JointCentering

from . import arrangements, goals
from .draw import DAQP, KAPPAS, LAW, PERIODS, Draw
from .driving import note_loops, record_of
from .ending import PartErrors
from .goals import pick
from .judgement import Rollout, judged
from .signs import Flags, Record

#: Arrangements whose robots have masses, and hinges in the hands at most.
ROBOTS = ("nao_t14", "two_pandas", "baxter", "tiago", "three_ur")
GRASPS = ("rigid", "revolute", "revolute one")
#: A twist does not come to rest.
KINDS = [kind for kind in goals.BUILDERS if kind not in ("twist", "relative_motion")]
MARGIN = 0.006  # kept free before the stops; the encoders' error is 5 mrad [rad]
#: The paper's 0 lets the commanded loops drift up to the budget, which squeezes.
CORRECTED = [name for name, kappa in KAPPAS.items() if kappa]
GRAVITY = 9.81  # [m/s2]

DURATION, END = 4.0, 0.5  # of a rollout, and of what counts as its end [s]
FOR_GOOD = 0.1  # share of the ticks of the last quarter in which a motor is at its limit
RESTS = 0.01  # slower than this share of the speed limits all through the end
MORE = 1.1  # what the force may be times more than it is without errors, or explained
DEVIATIONS = 3.0  # of noise
LEAST = 0.02  # a difference that says nothing [N]


@dataclass(frozen=True)
class DrawWithMasses(Draw):
    """A random problem for a plant with masses, and what its controller is not told."""

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
    robot = pick(rng, [name for name in ROBOTS if name in arrangements.names()])
    grasp = pick(rng, GRASPS)
    first = arrangements.chain(robot, grasp)
    chain = first.moved(walk(rng, first))
    dt, kappa, reach = pick(rng, PERIODS), pick(rng, CORRECTED), rng.random() < 0.5
    X = chain.object_pose(walk(rng, chain, stay=not reach))
    tasks = tuple(
        _task(rng, goals.some_aim(rng, X, chain, reach=reach), f"t{i}")
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
        "mode": pick(rng, ["soft", "soft", "hard", "scaled"]),
        "priority": int(rng.integers(0, 2)),
        "weight": float(10.0 ** rng.uniform(-1.0, 1.0)),
        "gain": float(rng.uniform(2.0, 10.0)),
        "profile": profile,
    }
    return goals.BUILDERS[pick(rng, KINDS)](aim, common)


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
    force = random_force(rng, chain, 0.5)
    start, duration = rng.uniform([0.0, 0.2], [1.5, 0.5]).tolist()
    if rng.random() >= 1.0 / 3.0:
        return None
    return Push(force=force, start=start, duration=duration)


def random_force(rng: np.random.Generator, chain: ClosedChain, least: float) -> goals.Vector:
    """Of so many times to twice the object's weight [N]."""
    force: Array = rng.normal(size=3)
    force *= rng.uniform(least, 2.0) * GRAVITY * chain.held.mass / np.linalg.norm(force)
    return vector(force)


@dataclass(frozen=True)
class Squeeze:
    """Largest internal force of a hand by the feed-forward's error, and what noise adds [N].

    And the motors' torques K delta + F, were they strong enough, shape (n,) [N m].
    """

    weight: float
    noise: float
    tau: Array


def squeeze(plant: DynamicModel, dt: float) -> Squeeze:
    """What the statics say where a plant is that rests."""
    true, disturbance = plant.true, plant.disturbance
    chain, servo = true.chain, plant.servo
    dynamics = ClosedLoopDynamics(chain, shares=chain.alpha, mass_scale=disturbance.object_mass)
    rest, n = np.zeros(chain.n), chain.n
    dynamics.update(true.q, rest)
    true.update()
    J = true.J_rel[: chain.loops.closed]
    forward = servo.weight(true.q)
    matrix = np.block([[np.diag(servo.stiffness), J.T], [J, np.zeros((len(J),) * 2)]])
    rhs = np.zeros((n + len(J), n + 1))
    rhs[:n, 0], rhs[n:, 1:] = dynamics.gravity(true.q) - forward, J
    found = np.linalg.lstsq(matrix, rhs, rcond=None)[0]
    wrenches: Array = np.zeros((len(true.J_rel), n + 1))
    wrenches[: len(J)] = found[n:]
    # What the hands do to the object is linear in the wrenches but for its weight, which cancels.
    forces = np.stack(
        [dynamics.object_wrenches(rest, column).internal[:, :3] for column in wrenches.T], axis=2
    )
    share = dt / max(TIME, TICKS * dt)
    passed = disturbance.noise_position * np.sqrt(share / (2.0 - share))
    return Squeeze(
        weight=float(np.linalg.norm(forces[:, :, 0], axis=1).max()),
        noise=float(passed * np.sqrt((forces[:, :, 1:] ** 2).sum(axis=(1, 2)).max())),
        tau=servo.stiffness * found[:n, 0] + forward,
    )


@dataclass(frozen=True)
class Run:
    """One of the two, judged as on joints that do as told.

    Attributes:
        force: in the mean of the end [N].
        rests: whether the commands do, all through the end.
        saturated, overloaded: motors that are at their limit for good, and of which the statics
            ask for more than they have, shape (n,).
    """

    rollout: Rollout
    force: float
    rests: bool
    squeeze: Squeeze
    saturated: Flags
    overloaded: Flags


def run_pair(drawn: DrawWithMasses, plant: Plant, seed: int) -> Rollout:
    """The run of a draw with its errors, if any, and what that or the one without them broke."""
    clean = run = _run(drawn, plant, seed, drawn.without_errors)
    broken: tuple[str, ...] = ()
    if drawn.errors != "none":
        run = _run(drawn, plant, seed, drawn.disturbance)
        broken = tuple(f"without errors: {words}" for words in clean.rollout.broken)
    # Who moves may need all of its torque, and lags behind.
    rests = run.rests or clean.rests
    motors = saturates(drawn, run, clean) if rests else ()
    much = squeezes(run, clean) if rests else ()
    return replace(
        run.rollout,
        goal=drawn.goal,
        errors=drawn.errors,
        broken=(*broken, *run.rollout.broken, *motors, *much),
        saturated=bool(motors),
        squeezed=bool(much),
        force=run.force,
        explained=run.squeeze.weight,
    )


def saturates(drawn: DrawWithMasses, run: Run, clean: Run) -> tuple[str, ...]:
    """Motors at their limits by the errors' doing, in words: the statics do not ask for it."""
    which = np.flatnonzero(run.saturated & ~run.overloaded & ~clean.saturated)
    names = [drawn.problem.chain.joint_names[i] for i in which.tolist()]
    return (f"saturated for good: {', '.join(names)}",) if names else ()


def squeezes(run: Run, clean: Run) -> tuple[str, ...]:
    """More internal force than without errors and than the statics explain, in words."""
    most = MORE * max(clean.force, run.squeeze.weight) + DEVIATIONS * run.squeeze.noise + LEAST
    if run is clean or run.force <= most:
        return ()
    words = "" if run.rests else " and does not rest"
    return (f"squeezes with {run.force:.3g} N, more than {most:.3g} N{words}",)


def _run(drawn: DrawWithMasses, plant: Plant, seed: int, disturbance: Disturbance) -> Run:
    problem = drawn.problem
    model = plant.build(problem, seed, disturbance)
    assert isinstance(model, DynamicModel)
    law, record = LAW.build(problem), record_of(problem)
    state = law.start(q_measured=model.measured)
    _drive(round(DURATION / problem.dt), law, model, state, record)
    noise = disturbance.noise_position
    rollout = judged(seed, drawn, law, state, record, PartErrors(problem), noise)
    last, limit = round(END / problem.dt), model.servo.effort
    found = squeeze(model, problem.dt)
    return Run(
        rollout=rollout,
        force=float(np.mean(record.forces[-last:])),
        rests=bool((np.abs(record.v[-last:]) < RESTS * record.scale).all()),
        squeeze=found,
        saturated=np.mean(record.saturated[-(len(record.saturated) // 4) :], axis=0) > FOR_GOOD,
        overloaded=np.abs(found.tau) > limit,
    )


def _drive(ticks: int, law: Law, plant: PlantModel, state: State, record: Record) -> None:
    """Run so many ticks, or until one commands NaN."""
    q, v = [], []
    for command, _ in drive(law, plant, state, ticks):
        q.append(state.q.copy())
        v.append(command.v.copy())
        record.causes.append(command.causes)
        record.plain += not law.compiled
        _note(record, plant, state)
        if not np.isfinite(command.v).all():
            break
    _note(record, plant, state)
    record.q, record.v = np.array([*q, state.q]), np.array(v)


def _note(record: Record, plant: PlantModel, state: State) -> None:
    """Keep how far the loops are open, and what the plant tells of the last step."""
    note_loops(record, state.loop_position_error, state.loop_orientation_error)
    forces = plant.signals["internal_wrench"].reshape(-1, 6)[:, :3]
    record.forces.append(float(np.linalg.norm(forces, axis=1).max()))
    record.saturated.append(plant.signals["saturated"] > 0.0)
