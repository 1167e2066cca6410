"""The object as a mass on springs and dampers: springs' laws, swings, who pushes, what is refused.

Two small arms of six joints each hold a box firmly, on rigid bodies and on MuJoCo, which have
masses of their own; what comes of it is compared with closed forms.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
import scipy.linalg
from chains import ring
from laws import problem

from coopqp.base.errors import CoopqpError, InvalidValueError
from coopqp.base.spec import Array, Pose
from coopqp.closed_loop.dynamics import ClosedLoopDynamics
from coopqp.controllers import PassiveGraspPid, QPController, TorqueQp, WrenchSplit
from coopqp.controllers.torque_qp import TorqueQpLaw
from coopqp.execution.rollout import rollout
from coopqp.model.closed_chain import AXES, ClosedChain
from coopqp.model.profile import Profile
from coopqp.model.state import State
from coopqp.plant import Disturbance, Plant, Push
from coopqp.plants import Mujoco, RigidBody
from coopqp.solver import Status
from coopqp.task import Task, TaskStack
from coopqp.tasks import Impedance, Orientation, PointOnLine, PointOnPlane, RelativeMotion
from coopqp.tasks import Pose as PoseTask
from coopqp.torque_law.task_dynamics import leaks
from coopqp.trace import Trace

FORCE, TORQUE = np.array([2.0, -1.5, 2.5]), np.array([0.05, 0.1, -0.08])  # [N], [N m]
PUSHED = np.concatenate([FORCE, TORQUE])
K = {"x": 600.0, "y": 800.0, "z": 1000.0, "rot_x": 10.0, "rot_y": 12.0, "rot_z": 15.0}
STIFF = np.array(list(K.values()))
M = {"x": 1.5, "y": 1.5, "z": 1.5, "rot_x": 0.03, "rot_y": 0.03, "rot_z": 0.03}
UNKNOWN, OBSERVED, MEASURED = (
    TorqueQp(external_wrench=knows) for knows in ("unknown", "observed", "measured")
)
NOBODY = Disturbance()
#: Of the push, and how far away it is let go [m]: little, so that the arms' inertia stays.
SHARE, OFF = 0.1, 0.002
#: What counts as off by one where it is that far away: positions, and angles at 10 cm.
FAR = np.repeat([OFF, OFF / 0.1], 3)
STEP = Profile(kind="step")


@cache
def small_pair() -> ClosedChain:
    return ring(2, 6)


def here(*away: float) -> Pose:
    """The box's place at the start, or a place so far from it [m]."""
    x, y, z = np.array(small_pair().start_position) + np.array(away or (0.0, 0.0, 0.0))
    return Pose(position=(x, y, z), rpy=rpy(small_pair()))


def rpy(chain: ClosedChain) -> tuple[float, float, float]:
    """How the box is turned at the start, by angles about fixed axes."""
    R = State(chain).R_WO
    return (
        float(np.arctan2(R[2, 1], R[2, 2])),
        float(-np.arcsin(R[2, 0])),
        float(np.arctan2(R[1, 0], R[0, 0])),
    )


def push_by(share: float) -> Disturbance:
    force, torque = (tuple(share * part) for part in (FORCE, TORQUE))
    return Disturbance(push=Push(force=force, torque=torque, start=0.0, duration=9.0))


def ran(
    task: Task,
    law: TorqueQp,
    duration: float,
    *others: Task,
    dt: float = 0.001,
    plant: str = "rigid_body",
    disturbance: Disturbance | None = None,
) -> Trace:
    """The box is pushed from the beginning, unless told otherwise."""
    asked = problem(small_pair(), task, *others, dt=dt, kappa=100.0)
    bodies: Plant = Mujoco() if plant == "mujoco" else RigidBody(time_step=dt)
    model = bodies.build(asked, 0, disturbance or push_by(1.0))
    ticks = round(duration / asked.dt)
    trace = rollout(law.build(asked), model, ticks, controller="torque_qp", solver="daqp")
    assert set(trace.status) == {"OPTIMAL"}
    return trace


@pytest.mark.few(2)
@pytest.mark.parametrize(
    ("plant", "law"),
    [
        ("rigid_body", UNKNOWN), ("rigid_body", OBSERVED),
        ("mujoco", UNKNOWN), ("mujoco", OBSERVED), ("mujoco", MEASURED),
    ],
    ids=lambda value: value if isinstance(value, str) else value.external_wrench,
)  # fmt: skip
def test_a_steady_push_moves_it_by_force_over_stiffness(plant: str, law: TorqueQp) -> None:
    """Along and about every axis, whether the arms count or another mass is feigned."""
    mass = None if law is UNKNOWN else M
    trace = ran(Impedance(goal=here(), stiffness=K, mass=mass), law, 0.6, dt=0.002, plant=plant)
    np.testing.assert_allclose(trace.e[-1], PUSHED / STIFF, rtol=0.02)


@pytest.mark.few(1)
@pytest.mark.parametrize("settings", [{"mode": "hard"}, {"priority": 1}], ids=["hard", "later"])
def test_one_axis_gives_way_beside_other_tasks(settings: dict[str, Any]) -> None:
    """The box stays on a line and level, and moves along it by the push along it over K."""
    line = PointOnLine(direction=(0, 1, 0), through=here().position, gain=20.0)
    level = Orientation(rpy=here().rpy, gain=20.0)
    springs = Impedance(goal=here(), stiffness={"y": K["y"]}, **settings)
    trace = ran(springs, OBSERVED, 0.6, line, level, dt=0.002)
    assert trace.e[-1, 0] == pytest.approx(FORCE[1] / K["y"], rel=0.02)
    assert np.abs(trace.e[-1, 1:3]).max() < 0.02 * abs(FORCE[1] / K["y"])


def test_without_knowing_who_pushes_a_step_swings_as_masses_on_springs_do() -> None:
    """M of the whole by the direct model, which agrees with pinocchio's own."""
    ratio = 0.2
    task = Impedance(goal=here(), stiffness=K, damping_ratio=ratio)
    trace = ran(task, UNKNOWN, 0.3, disturbance=push_by(SHARE))
    # Modes of M e_ddot + K e = w, each damped by the ratio, with w switched on at once.
    S = np.sqrt(STIFF)
    squares, U = np.linalg.eigh(S[:, None] * mobility(small_pair()) * S)
    omega = np.sqrt(squares)
    bent = omega * np.sqrt(1.0 - ratio**2)
    t = trace.t[:, None]
    swing = np.cos(bent * t) + ratio / np.sqrt(1.0 - ratio**2) * np.sin(bent * t)
    gone = (1.0 - np.exp(-ratio * omega * t) * swing) * (U.T @ (SHARE * PUSHED / S))
    wanted = gone @ U.T / S
    off = np.abs(trace.e - wanted).max(axis=0) / np.abs(wanted).max(axis=0)
    assert off.max() < 0.05


def mobility(chain: ClosedChain) -> Array:
    """Acceleration of the object by unit wrenches on it at rest, shape (6, 6)."""
    dynamics = ClosedLoopDynamics(chain)
    dynamics.update(chain.q_start, np.zeros(chain.n))
    still = dynamics.gravity(chain.q_start)
    at_rest = dynamics.direct(still).a.copy()
    J = dynamics.J_object
    return np.array([J @ (dynamics.direct(still + J.T @ w).a - at_rest) for w in np.eye(6)]).T


def test_a_feigned_mass_swings_at_its_frequency_and_damping() -> None:
    """Let go 2 mm off, nobody pushes: e_0 exp(-z w t) (cos + z/sqrt(1-z^2) sin), w = sqrt(K/M)."""
    ratio = 0.3
    task = Impedance(
        goal=here(-OFF, 0.0, 0.0), stiffness=K, mass=M, damping_ratio=ratio, profile=STEP
    )
    trace = ran(task, OBSERVED, 0.3, disturbance=NOBODY)
    t, w = trace.t, np.sqrt(K["x"] / M["x"])
    bent = w * np.sqrt(1.0 - ratio**2)
    wanted = OFF * np.exp(-ratio * w * t) * (np.cos(bent * t) + ratio * w / bent * np.sin(bent * t))
    np.testing.assert_allclose(trace.e[:, 0], wanted, atol=0.02 * OFF)
    assert np.abs(trace.e[:, 1:3]).max() < 0.02 * OFF


@pytest.mark.parametrize("law", [UNKNOWN, OBSERVED], ids=["unknown", "observed"])
def test_damping_can_be_stated(law: TorqueQp) -> None:
    """M e_ddot + D e_dot + K e = 0, let go 2 mm off, by the matrix exponential."""
    mass = M if law is OBSERVED else None
    at = {axis: 0.5 * np.sqrt(K[axis] * M[axis]) for axis in K}
    goal = here(-OFF, 0.5 * OFF, 0.0)
    task = Impedance(goal=goal, stiffness=K, mass=mass, damping=at, profile=STEP)
    trace = ran(task, law, 0.2, disturbance=NOBODY)
    W = np.diag(1.0 / np.array(list(M.values()))) if mass else mobility(small_pair())
    rates = np.block(
        [[np.zeros((6, 6)), np.eye(6)], [-W * STIFF, -W * np.array(list(at.values()))]]
    )
    first = np.concatenate([trace.e[0], np.zeros(6)])
    wanted = np.array([(scipy.linalg.expm(rates * t) @ first)[:6] for t in trace.t[::10]])
    # A command that holds for a millisecond is late by half of it: 2 % of a swing at 40 rad/s.
    assert (np.abs(trace.e[::10] - wanted) / FAR).max() < 0.03


def test_a_reference_that_moves_is_followed_without_a_push() -> None:
    way = Profile(kind="quintic", duration=0.5)
    task = Impedance(goal=here(-OFF, 0.0, OFF), stiffness=K, profile=way)
    trace = ran(task, UNKNOWN, 0.5, dt=0.002, disturbance=NOBODY)
    assert np.abs(trace.e[:, :3]).max() < 0.02 * OFF


def test_hands_bear_an_observed_push_and_other_tasks_stay() -> None:
    """Without an integral a push moves the box unless it is known."""
    stay = PoseTask(goal=here(), gain=15.0)
    gone = [
        np.linalg.norm(ran(stay, replace(law, integral=0.0), 0.4, dt=0.002).e[-1, :3])
        for law in (UNKNOWN, OBSERVED, MEASURED)
    ]
    assert max(gone[1:]) < 0.02 * gone[0]


@pytest.mark.parametrize(
    "controller", [QPController(), PassiveGraspPid(), PassiveGraspPid(level="kinematic"),
                   WrenchSplit()], ids=lambda c: c.name,
)  # fmt: skip
def test_other_laws_refuse_it(controller: Any, chain: ClosedChain) -> None:
    task = Impedance(goal=Pose(position=(0.2, 0.0, 0.05)), stiffness={"x": 100.0})
    with pytest.raises(InvalidValueError, match="task 'impedance' asks for an impedance, which"):
        controller.build(problem(chain, task, dt=0.002))
    with pytest.raises(InvalidValueError, match=r"secondary\[0\].*put it under tasks"):
        problem(chain, secondary=[task])


@pytest.mark.parametrize(
    ("law", "settings", "words"),
    [
        (TorqueQp(), {"mass": {"x": 1.0}}, "states a mass, which needs the external wrench"),
        (
            TorqueQp(),
            {"stiffness": {"x": 1e6}},
            "oscillates at dt 2 ms",
        ),
        (replace(OBSERVED, observer_gain=900.0), {}, "observer_gain: found 900 1/s, needs more"),
        (OBSERVED, {"mass": {"x": 1e-4}}, "state more mass"),
    ],
)
def test_what_cannot_be_is_refused_before_the_run(
    law: TorqueQp, settings: dict[str, Any], words: str
) -> None:
    given = {"goal": here(), "stiffness": {"x": 100.0}}
    with pytest.raises(CoopqpError, match=words):
        law.build(problem(small_pair(), Impedance(**(given | settings)), dt=0.002, kappa=50.0))


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"stiffness": {"x": 0.0}}, "greater than 0"),
        ({"stiffness": {"x": -5.0}}, "greater than 0"),
        ({"stiffness": {}}, "at least 1"),
        ({"stiffness": {"rotx": 5.0}}, "rot_x"),
        ({"mass": {"x": 0.0}}, "greater than 0"),
        ({"mass": {"y": 1.0}}, "mass: needs the axes of stiffness, x"),
        ({"damping": {"x": 1.0, "y": 1.0}}, "damping: needs the axes of stiffness, x"),
        ({"damping": {"x": -1.0}}, "greater than or equal to 0"),
        ({"mode": "scaled"}, "soft or hard"),
    ],
)
def test_numbers_that_are_none_are_refused(settings: dict[str, Any], words: str) -> None:
    given = {"goal": Pose(position=(0.2, 0.0, 0.05)), "stiffness": {"x": 100.0}}
    with pytest.raises(ValueError, match=words):
        Impedance(**(given | settings))


@pytest.mark.full
def test_what_is_felt_of_a_push_along_an_axis_without_a_spring_is_as_foretold() -> None:
    """A torque about z, which nobody knows of, on a box that is kept level by another task."""
    springs = Impedance(goal=here(), stiffness={axis: K[axis] for axis in ("x", "y", "z")})
    level = Orientation(rpy=here().rpy, gain=20.0)
    found = leaks(problem(small_pair(), springs, level, dt=0.002, kappa=100.0))
    assert found
    felt, pushed, share = found
    size = 0.2 / (1.0 if pushed.startswith("rot") else 0.1)
    wrench = np.zeros(6)
    wrench[AXES.index(pushed)] = size
    push = Push(force=tuple(wrench[:3]), torque=tuple(wrench[3:]), start=0.0, duration=9.0)
    trace = ran(springs, UNKNOWN, 1.0, level, dt=0.002, disturbance=Disturbance(push=push))
    row = ("x", "y", "z").index(felt)
    assert K[felt] * trace.e[-1, row] == pytest.approx(size * share, rel=0.1)


@pytest.mark.parametrize(
    ("found", "words"),
    [
        (None, "no hand_wrench has come"),
        (np.full(12, np.nan), "no finite number"),
        (np.full(12, 1e9), "found 1e+09"),
        (np.zeros((2, 6)), "found shape (2, 6)"),
    ],
)
def test_who_goes_by_sensors_says_that_they_are_silent(found: Any, words: str) -> None:
    asked = problem(small_pair(), Impedance(goal=here(), stiffness={"x": 300.0}))
    law = TorqueQp(external_wrench="measured").build(asked)
    state = law.start()
    state.hand_wrench = found
    for _ in range(2):
        assert law.tick(state).causes == (Status.FORCE_NOT_MEASURED,)
        assert words in law.command.note
    state.hand_wrench = np.zeros(12)
    assert law.tick(state).causes == (Status.OPTIMAL,)


def test_rows_of_all_priorities_together_have_to_be_independent() -> None:
    plane = PointOnPlane(normal=(0, 0, 1), through=here().position, mode="hard")
    level = Orientation(rpy=here().rpy, gain=20.0)
    across = Impedance(goal=here(), stiffness={"x": 300.0, "y": 300.0}, priority=1)
    asked = problem(small_pair(), plane, across, level, dt=0.002, kappa=100.0)
    assert TorqueQp().build(asked)
    whole = Impedance(goal=here(), stiffness=K, priority=1)
    with pytest.raises(CoopqpError, match=r"only 6 of the rows are.*whatever priority"):
        TorqueQp().build(problem(small_pair(), plane, whole, dt=0.002, kappa=100.0))


def test_an_arm_that_has_let_go_is_named_with_the_task_that_moves_it() -> None:
    pair = small_pair()
    last = pair.arms[-1].name
    chain = pair.handed_over(pair.q_start, (last,))
    reach = RelativeMotion(arm=last, goal={"position": (0.0, 0.0, 0.01)})
    asked = problem(chain, PoseTask(goal=here(), gain=10.0), reach, dt=0.002, kappa=100.0)
    with pytest.raises(CoopqpError, match="'relative_motion' moves an arm that does not hold"):
        PassiveGraspPid(level="torque").build(asked)


def test_an_arm_that_has_let_go_moves_by_torques_as_its_task_says() -> None:
    pair = small_pair()
    last = pair.arms[-1].name
    chain = pair.handed_over(pair.q_start, (last,))
    far, step = {"position": (0.0, 0.0, 0.01)}, Profile(kind="step")
    reach = RelativeMotion(arm=last, goal=far, gain=10.0, profile=step)
    asked = problem(chain, PoseTask(goal=here(), gain=10.0), reach, dt=0.002, kappa=100.0)
    law = TorqueQp(integral=0.0).build(asked)
    assert isinstance(law, TorqueQpLaw)
    state = law.start()
    assert law.tick(state).causes == (Status.OPTIMAL,)
    # At rest e_ddot = -g^2 e, of the free hand and of the object alike, but for effort and damping.
    stack = TaskStack(asked.tasks, State(chain))
    stack.update(state)
    a = law.solution.v[law.layout.a]
    assert np.linalg.norm(stack.e[6:9]) == pytest.approx(0.01)
    assert stack.J @ a == pytest.approx(-100.0 * stack.e, abs=0.01)
