"""How well a push is told from joints and torques, and what springs make of it.

python benchmarks/pushes.py      # the tables of docs/forces.md, some minutes

The box of the scenario impedance, pushed by 10 N. While the push is observed it goes round on a
circle of 5 cm, twice in 4 s; springs are looked at after 2.5 s of push. The last table has pads
instead of firm hands.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pinocchio as pin

import coopqp
from coopqp.base.spec import Array, Pose
from coopqp.closed_loop.dynamics import ClosedLoopDynamics
from coopqp.controllers import TorqueQp
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.state import Memory, State
from coopqp.plant import Disturbance, Plant, Push
from coopqp.plants import Mujoco, RigidBody
from coopqp.scenario.scenario import Scenario
from coopqp.signals.circle import Circle
from coopqp.tasks import Impedance, Orientation, PointOnPoint
from coopqp.torque_law.hand_wrenches import MomentumObserver
from coopqp.trace import Trace

FORCE, BEGIN = np.array([6.0, 8.0, 0.0]), 1.2  # [N], [s]
GAINS = (10.0, 25.0, 50.0, 100.0, 200.0)  # [1/s]
NOISE = 1e-3  # [rad/s]
#: Of the springs: who knows the push, and whether another mass is feigned.
MASSES = {"x": 6.0, "y": 6.0, "z": 6.0, "rot_x": 0.3, "rot_y": 0.3, "rot_z": 0.3}
SETTINGS = (("unknown", None), ("observed", None), ("observed", MASSES), ("measured", MASSES))


def circling(scenario: Scenario) -> Trace:
    """The box goes round and is pushed from some time on; the law is not told."""
    x, y, z = scenario.chain.start_position
    way = Circle(
        center=(x, y - 0.05, z), radius=0.05, normal=(1, 0, 0), begin=(0, 1, 0), period=2.0
    )
    goes = replace(
        scenario,
        tasks=(PointOnPoint(goal=way, gain=10.0), Orientation(rpy=(0.0, 0.0, 0.0), gain=10.0)),
        disturbance=Disturbance(push=Push(force=tuple(FORCE), start=BEGIN, duration=9.0)),
        duration=4.0,
        plant=RigidBody(),
    )
    return coopqp.run(goes, controller="torque_qp")


def with_masses(chain: ClosedChain, *, arms: float = 1.0, held: float = 1.0) -> ClosedChain:
    """The same chain by a model whose masses and inertias are so much of the real ones."""
    model = chain.robot.model.copy()
    for joint in range(1, model.njoints):
        body = model.inertias[joint]
        model.inertias[joint] = pin.Inertia(arms * body.mass, body.lever, arms * body.inertia)
    hold = chain.hold
    robot = replace(chain.robot, model=model)
    box = replace(chain.held, mass=held * chain.held.mass)
    return ClosedChain.attach(robot, chain.q_start, hold.grasps, box)


def told(chain: ClosedChain, trace: Trace, gain: float, noise: float = 0.0) -> Array:
    """The force that is told after each tick, shape (T, 3)."""
    rng = np.random.default_rng(0)
    dynamics = ClosedLoopDynamics(chain)
    observer = MomentumObserver(dynamics, gain=gain, dt=trace.dt)
    state, found = State(chain, memory=Memory(observer.memory_sizes)), []
    seen = [(trace.q[0], np.zeros(chain.n), np.zeros(chain.n))]
    seen += list(zip(trace.q[1:], trace.v, trace.signals["tau"], strict=True))
    for q, v, tau in seen:
        measured = v + noise * rng.standard_normal(len(v))
        dynamics.update(q, measured)
        state.q[:], state.v[:], state.memory["observer.tau"][:] = q, measured, tau
        found.append(observer.update(state)[:3].copy())
    return np.array(found[1:])


def line(what: str, found: Array, trace: Trace) -> str:
    """When it is within 5 % of the push for good, and how far off while and before it is there."""
    t = trace.t[1:]
    off = np.linalg.norm(found - np.where(t[:, None] > BEGIN, FORCE, 0.0), axis=1)
    before, after = off[(t > 0.2) & (t <= BEGIN)], off[t > BEGIN]
    outside = np.flatnonzero(after > 0.05 * np.linalg.norm(FORCE))
    within = f"{1e3 * trace.dt * (outside[-1] + 1):.0f}" if outside[-1] + 1 < len(after) else "-"
    late = after[round(0.5 / trace.dt) :]
    return f"| {what} | {within} | {before.max():.2f} | {late.max():.2f} |"


def observers() -> Iterator[str]:
    scenario = coopqp.load("impedance")
    chain, trace = scenario.chain, circling(scenario)
    yield "| model and gain [1/s] | within 5 % after [ms] | off before [N] | off later [N] |"
    yield "|---|---|---|---|"
    for gain in GAINS:
        yield line(f"exact, {gain:g}", told(chain, trace, gain), trace)
    for what, model in (
        ("object 2 % too light", with_masses(chain, held=0.98)),
        ("object 20 % too light", with_masses(chain, held=0.8)),
        ("arms 2 % too light", with_masses(chain, arms=0.98)),
        ("arms 2 % too heavy", with_masses(chain, arms=1.02)),
        ("arms 10 % too heavy", with_masses(chain, arms=1.1)),
    ):
        yield line(f"{what}, 50", told(model, trace, 50.0), trace)
    noisy = told(chain, trace, 50.0, NOISE)
    yield line(f"exact, noise {1e3 * NOISE:g} mrad/s, 50", noisy, trace)


def springs() -> Iterator[str]:
    scenario = coopqp.load("impedance")
    (task,) = scenario.tasks
    assert isinstance(task, Impedance)
    push = Push(force=tuple(FORCE), start=0.5, duration=9.0)
    wanted = FORCE[:2] / [task.stiffness["x"], task.stiffness["y"]]
    yield "| plant | law | mass | x [mm] | y [mm] | F/K - 1 [%] |\n|---|---|---|---|---|---|"
    plants: dict[str, Plant] = {"rigid_body": RigidBody(), "mujoco": Mujoco()}
    for name, plant in plants.items():
        for law, mass in SETTINGS:
            pushed = replace(
                scenario,
                tasks=(replace(task, mass=mass),),
                controllers={"law": TorqueQp(external_wrench=law)},
                plant=plant,
                duration=3.0,
                disturbance=Disturbance(push=push),
            )
            trace = coopqp.run(pushed, controller="law")
            gone = trace.e[-1, :2]
            off = 100.0 * np.abs(gone / wanted - 1.0).max()
            of, (x, y) = "6 kg" if mass else "as it is", 1e3 * gone
            yield f"| {name} | {law} | {of} | {x:.3f} | {y:.3f} | {off:.2f} |"


def pads() -> Iterator[str]:
    """The box of press_and_lift on springs of 2 kN/m, pushed down by 15 N, in MuJoCo."""
    scenario = coopqp.load("press_and_lift")
    at = Pose(position=tuple(scenario.chain.start_position))
    stiffness = {axis: 150.0 if axis.startswith("rot") else 2000.0 for axis in MASSES}
    push = Push(force=(0.0, 0.0, -15.0), start=0.5, duration=9.0)
    yield "| law | squeeze before [N] | pushed [N] | friction used [%] | down [mm] |"
    yield "|---|---|---|---|---|"
    for law in ("unknown", "observed", "measured"):
        pushed = replace(
            scenario,
            tasks=(Impedance(goal=at, stiffness=stiffness),),
            controllers={"law": TorqueQp(external_wrench=law)},
            duration=1.8,
            disturbance=Disturbance(push=push),
        )
        trace = coopqp.run(pushed, controller="law")
        normal = trace.signals["normal_force"].mean(axis=1)
        used, down = 100.0 * trace.signals["friction_use"][-1].max(), -1e3 * trace.e[-1, 2]
        yield f"| {law} | {normal[450]:.1f} | {normal[-1]:.1f} | {used:.0f} | {down:.2f} |"


def whole(chain: ClosedChain) -> str:
    """What object and arms weigh together along each axis, at rest at the start."""
    dynamics = ClosedLoopDynamics(chain)
    dynamics.update(chain.q_start, np.zeros(chain.n))
    still, J = dynamics.gravity(chain.q_start), dynamics.J_object
    at_rest = dynamics.direct(still).a.copy()
    by_force = [J[i] @ (dynamics.direct(still + J[i]).a - at_rest) for i in range(3)]
    return f"as it is: {', '.join(f'{1.0 / a:.1f}' for a in by_force)} kg along x, y, z"


def main() -> None:
    for row in (*observers(), "", *springs(), "", *pads(), whole(coopqp.load("impedance").chain)):
        print(row, flush=True)


if __name__ == "__main__":
    main()
