"""Hard tasks, scaled tasks, and rows that say the same twice."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any, Literal

import laws
import numpy as np
import pytest
from chains import Walk
from laws import DT, LIMITS, NEAR, PLAIN, STEP, WIDE, answer, reach, run, ticks
from scipy.optimize import linprog

from coopqp.base.errors import InvalidValueError
from coopqp.base.spec import Array
from coopqp.base.spec import Pose as PoseValue
from coopqp.controllers import QPController
from coopqp.grasps import Rigid
from coopqp.limits import JointPosition, JointVelocity
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.grasp_configuration import HeldObject
from coopqp.model.profile import Profile
from coopqp.model.state import State
from coopqp.robots import PlanarPair
from coopqp.scenario.loader import load
from coopqp.signals import Waypoints
from coopqp.solver import Status
from coopqp.task import TaskStack
from coopqp.tasks import JointCentering, PointOnPoint, Pose, Posture

Point = tuple[float, float, float]
LOW: Point = (0.17, -0.01, 0.03)
FRONT: Point = (0.04, 0.0, -0.04)  # of the object [m]
problem = partial(laws.problem, budget=WIDE)


# Hard tasks.


def test_hard_task_is_met_exactly(chain: ClosedChain, closed_loop_walk: Walk) -> None:
    """Where soft ones pull elsewhere."""
    hard = PointOnPoint(name="reach", goal=NEAR, profile=STEP, mode="hard")
    pull = PointOnPoint(name="pull", goal=LOW, profile=STEP, weight=1e4)
    for q in closed_loop_walk(chain, 5):
        J, wanted = reach(State(chain, q), NEAR)
        np.testing.assert_allclose(
            J @ answer(PLAIN, problem(chain, hard, pull), q), wanted, atol=1e-9
        )


@pytest.mark.parametrize("engine", ["auto", "python"])
@pytest.mark.parametrize("mode", ["hard", "scaled"])
def test_task_whose_goal_leaves_the_reach_and_comes_back_follows_it_again(
    mode: Literal["hard", "scaled"], engine: Literal["auto", "python"]
) -> None:
    """Exact rows drove NAO's stretched arms through the singularity, where they stayed."""
    near, far = (0.18, 0.0, 0.0857), (0.225, 0.0, 0.0857)
    goal = Waypoints(values=(near, far, near), times=(0.0, 3.0, 6.0))
    task = PointOnPoint(name="follow", mode=mode, gain=5.0, goal=goal)
    asked = replace(load("point_on_point").problem(), tasks=(task,), secondary=())
    law = QPController(engine=engine).build(asked)
    state, commands, relaxed = law.start(), [], 0
    for _ in range(1000):
        command = law.step(state)
        commands.append(command.v.copy())
        relaxed += command.status is Status.TASKS_RELAXED
    stack = TaskStack([task], state)
    stack.update(state)
    assert np.linalg.norm(stack.e) < 1e-6
    assert relaxed > 200
    assert np.abs(np.diff(commands, axis=0)).max() < 2.0  # was 7.9 rad/s


def test_hard_task_is_the_limit_of_a_growing_weight(chain: ClosedChain) -> None:
    """The distance falls as 1/weight."""
    settings: dict[str, Any] = {"limits": LIMITS, "secondary": [JointCentering(name="centre")]}
    point = PointOnPoint(name="reach", goal=NEAR, profile=STEP)
    pull = PointOnPoint(name="pull", goal=LOW, profile=STEP, point=FRONT)
    exact = answer(PLAIN, problem(chain, replace(point, mode="hard"), pull, **settings))
    off = [
        np.abs(
            answer(PLAIN, problem(chain, replace(point, weight=w), pull, **settings)) - exact
        ).max()
        for w in (1e2, 1e3, 1e4)
    ]
    assert off[0] / off[1] == pytest.approx(10.0, rel=0.15)
    assert off[1] / off[2] == pytest.approx(10.0, rel=0.15)


def test_hard_task_follows_its_reference_over_a_run(chain: ClosedChain) -> None:
    """After each of 200 ticks the residual of the rows is rounding."""
    task = PointOnPoint(
        name="reach", goal=NEAR, profile=Profile(duration=1.0), mode="hard", gain=1 / DT
    )
    law = PLAIN.build(
        problem(chain, task, limits=LIMITS, secondary=[JointCentering(name="centre")])
    )
    state = law.start()
    start = state.p_WO.copy()
    for command in ticks(law, state, 200):
        share, speed = Profile(duration=1.0).at(state.t)
        way = np.array(NEAR) - start
        wanted = speed * way - (state.p_WO - start - share * way) / DT
        assert command.status is Status.OPTIMAL
        np.testing.assert_allclose(state.J_task[:3] @ command.v, wanted, atol=1e-9)


# Scaled tasks.


def fastest_share(state: State, wanted: Array, lb: Array, ub: Array) -> float:
    """Largest s in [0, 1] with J v = s wanted within loops and bounds, by a linear program."""
    n = len(state.q)
    J = state.J_task[:3]
    equal = np.block([[state.J_rel, np.zeros((6, 1))], [J, -wanted[:, None]]])
    found = linprog(
        np.append(np.zeros(n), -1.0),
        A_eq=equal,
        b_eq=np.concatenate([-state.loop_error / DT, np.zeros(3)]),
        bounds=[*zip(lb, ub, strict=True), (0.0, 1.0)],
    )
    assert found.success
    return float(found.x[-1])


@pytest.mark.parametrize("share", [0.01, 0.03, 0.1, 1.0])
def test_scaled_task_keeps_its_direction_and_goes_as_fast_as_limits_let_it(
    share: float, chain: ClosedChain, closed_loop_walk: Walk
) -> None:
    task = PointOnPoint(name="reach", goal=NEAR, profile=STEP, mode="scaled")
    given = problem(
        chain,
        task,
        secondary=[JointCentering(name="centre")],
        limits=(JointPosition(), JointVelocity(scale=share)),
    )
    law, shares = PLAIN.build(given), []
    for q in closed_loop_walk(chain, 8):
        state = law.start(q)
        command = law.tick(state)
        assert command.status is Status.OPTIMAL
        J, wanted = reach(state, NEAR)
        np.testing.assert_allclose(J @ command.v, command.scale * wanted, atol=1e-8)
        lb = np.maximum((chain.lower - q) / DT, -share * chain.velocity)
        ub = np.minimum((chain.upper - q) / DT, share * chain.velocity)
        assert command.scale == pytest.approx(fastest_share(state, wanted, lb, ub), abs=1e-6)
        assert -1e-9 <= command.scale <= 1 + 1e-9
        shares.append(command.scale)
    assert min(shares) < 0.9 or share > 0.1


def test_scaled_task_with_room_runs_at_full_speed(chain: ClosedChain) -> None:
    task = PointOnPoint(name="reach", goal=NEAR, profile=STEP, mode="scaled")
    law = PLAIN.build(problem(chain, task, limits=LIMITS))
    state = law.start()
    J, wanted = reach(state, NEAR)
    command = law.tick(state)
    assert command.scale == pytest.approx(1.0, abs=1e-8)
    np.testing.assert_allclose(J @ command.v, wanted, atol=1e-8)


def test_trace_records_the_share_of_each_tick(chain: ClosedChain) -> None:
    """On a way so fast that joints saturate, and then not; the path is straight."""
    task = PointOnPoint(name="reach", goal=NEAR, profile=STEP, mode="scaled", gain=20.0)
    given = problem(chain, task, limits=(JointPosition(), JointVelocity(scale=0.03)))
    trace = run(PLAIN, given, 100)
    for k in range(0, 100, 5):
        state = State(chain, trace.q[k])
        J, wanted = state.J_task[:3], -20.0 * (state.p_WO - NEAR)
        if np.linalg.norm(wanted) > 1e-3:
            assert J @ trace.v[k] @ wanted / (wanted @ wanted) == pytest.approx(
                trace.scale[k], abs=1e-6
            )
    assert trace.scale[0] < 0.5
    assert trace.scale[-1] == pytest.approx(1.0, abs=1e-6)
    way = (trace.position - trace.position[0]) @ np.eye(3)
    along = (np.array(NEAR) - trace.position[0]) / np.linalg.norm(NEAR - trace.position[0])
    assert np.linalg.norm(way - np.outer(way @ along, along), axis=1).max() < 1e-4


def test_scaled_task_leaves_a_blocked_direction_for_the_nearest_motion() -> None:
    """The goal of joint_limit_stress: a limit ends the straight way; it rests where soft does."""
    given = load("joint_limit_stress").problem()
    goal = np.array([0.10, -0.05, 0.04])
    scaled = PointOnPoint(name="reach", goal=tuple(goal.tolist()), profile=STEP, mode="scaled")
    trace, soft = (
        run(PLAIN, replace(given, tasks=(replace(scaled, mode=mode),)), 600)  # type: ignore[arg-type]
        for mode in ("scaled", "soft")
    )
    assert set(trace.status) == {"OPTIMAL", "TASKS_RELAXED"}
    assert trace.status[-1] == "TASKS_RELAXED"
    assert trace.scale[-1] < 1e-3
    assert trace.task_error[-1] <= soft.task_error[-1] + 2e-4
    assert np.abs(trace.v[-100:]).max() < 1e-3
    chain = given.chain
    assert np.maximum(chain.lower - trace.q, trace.q - chain.upper).max() <= 1e-9
    for k in np.flatnonzero(np.array(trace.status) == "TASKS_RELAXED")[:100:10]:
        J, wanted = reach(State(chain, trace.q[k]), goal)
        lacks = np.linalg.norm(J @ trace.v[k] - wanted) / np.linalg.norm(wanted)
        assert trace.scale[k] == pytest.approx(max(1.0 - lacks, 0.0), abs=1e-4)


@pytest.mark.parametrize("mode", ["hard", "scaled"])
def test_hard_and_scaled_tasks_have_a_weight(mode: Literal["hard", "scaled"]) -> None:
    """Their nearest motion would not see them."""
    with pytest.raises(InvalidValueError, match="needs a weight above 0"):
        PointOnPoint(goal=NEAR, mode=mode, weight=0.0)


def test_soft_task_does_not_slow_a_scaled_one(chain: ClosedChain) -> None:
    """Objectives are given up before scaled tasks, whatever their weight."""
    task = PointOnPoint(name="reach", goal=NEAR, profile=STEP, mode="scaled")
    pull = PointOnPoint(name="pull", goal=(0.15, -0.03, 0.02), profile=STEP, weight=1e4)
    law = PLAIN.build(problem(chain, task, pull, limits=LIMITS))
    assert law.tick(law.start()).scale == pytest.approx(1.0, abs=1e-6)


def test_copy_of_a_command_keeps_its_share(chain: ClosedChain) -> None:
    task = PointOnPoint(name="reach", goal=NEAR, profile=STEP, mode="scaled", gain=20.0)
    law = PLAIN.build(problem(chain, task, limits=(JointVelocity(scale=0.03),)))
    command = law.tick(law.start())
    assert command.scale < 0.5
    assert command.copy().scale == command.scale


# Rows that say the same twice.


@pytest.fixture(scope="module")
def planar() -> ClosedChain:
    q = np.radians([-20, 70, -50, 20, -70, 50])
    return ClosedChain.attach(PlanarPair().build(), q, Rigid(), HeldObject())


STACKS: dict[str, tuple[str, ...]] = {
    "soft": ("soft",),
    "hard": ("hard",),
    "scaled": ("scaled",),
    "the same twice, hard": ("hard", "hard"),
    "the same twice, scaled": ("scaled", "scaled"),
    "hard and soft": ("hard", "soft"),
    "hard and scaled": ("hard", "scaled"),
}


@pytest.mark.parametrize("modes", STACKS.values(), ids=STACKS.keys())
def test_redundant_rows_are_no_obstacle(modes: tuple[str, ...], planar: ClosedChain) -> None:
    """In the plane the z row of a point is zero, and tasks may repeat each other."""
    goal = (0.36, 0.10, 0.0)
    tasks = [
        PointOnPoint(name=f"slide {i}", goal=goal, mode=mode)  # type: ignore[arg-type]
        for i, mode in enumerate(modes)
    ]
    trace = run(
        PLAIN,
        problem(planar, *tasks, secondary=[JointCentering(name="centre")], limits=LIMITS),
        250,
    )
    assert set(trace.status) == {"OPTIMAL"}
    np.testing.assert_allclose(trace.position[-1], goal, atol=1e-5)


def test_pose_that_leaves_no_freedom_silences_the_secondary(planar: ClosedChain) -> None:
    """Three loop rows and three of the pose's six rows fix all six joints."""
    goal = PoseValue(position=(0.4, 0.02, 0.0), rpy_deg=(0, 0, 5))
    pose = Pose(name="pose", goal=goal, profile=STEP)
    posture = Posture(name="posture", goal=[0.5, -0.3, 0.4, 0.2, 0.6, -0.3])
    both, alone = (
        answer(PLAIN, problem(planar, pose, secondary=s, limits=LIMITS)) for s in ([posture], [])
    )
    np.testing.assert_allclose(both, alone, atol=1e-9)
