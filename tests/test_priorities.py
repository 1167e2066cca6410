"""Strict priorities, weights within a level, hard and scaled tasks, against written-out optima."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
import qpsolvers
import scipy.linalg
from numpy.typing import NDArray
from scipy.optimize import linprog

from coopqp.checked import Pose as PoseValue
from coopqp.checked import spec
from coopqp.closed_chain import ClosedChain
from coopqp.controller import ControlProblem
from coopqp.controllers import QPController
from coopqp.qp_law.law import QPLaw
from coopqp.disturbance import Disturbance
from coopqp.grasps import Rigid
from coopqp.held_object import HeldObject
from coopqp.limits import JointPosition, JointVelocity
from coopqp.plants import Kinematic
from coopqp.profile import Profile
from coopqp.robot import Arm, RobotModel
from coopqp.robots import PlanarPair
from coopqp.rollout import rollout
from coopqp.scenario.loader import load
from coopqp.solver import Budget, Status
from coopqp.solvers import Daqp
from coopqp.state import State
from coopqp.task import Evaluate, Task, TaskRows
from coopqp.tasks import JointCentering, PointOnPlane, PointOnPoint, Pose, Posture
from coopqp.trace import Trace

Array = NDArray[np.float64]
Walk = Callable[[ClosedChain, int], list[Array]]
Point = tuple[float, float, float]

DT, GAIN, DAMPING = 0.01, 5.0, 1e-6
STEP = Profile(kind="step")
NEAR: Point = (0.19, 0.01, 0.06)
LOW: Point = (0.17, -0.01, 0.03)
ORIGIN: Point = (0.0, 0.0, 0.0)
FRONT: Point = (0.04, 0.0, -0.04)  # of the object [m]
LIMITS = (JointPosition(), JointVelocity())
#: For fast motions of one tick, where the optimum is looked at and not the step.
WIDE = Budget(accuracy=1e-2, loop_position=1.0, loop_orientation=1.0)
ARM_OUT = {"right": [0.6, -0.3, 1.0, 0.8, 0.0]}


def problem(chain: ClosedChain, *tasks: Task, **settings: Any) -> ControlProblem:
    given: dict[str, Any] = {
        "solver": Daqp(),
        "dt": DT,
        "kappa": 1 / DT,
        "budget": WIDE,
        **settings,
    }
    return ControlProblem(chain=chain, tasks=tasks, **given)


def build(problem: ControlProblem, damping: float = DAMPING) -> QPLaw:
    law = QPController(damping=damping, error_damping=0.0).build(problem)
    assert isinstance(law, QPLaw)
    return law


def answer(problem: ControlProblem, q: Array | None = None, damping: float = DAMPING) -> Array:
    """One tick's joint velocity."""
    law = build(problem, damping)
    command = law.tick(law.start(q))
    assert command.status is Status.OPTIMAL
    return command.v.copy()


def run(problem: ControlProblem, ticks: int = 300) -> Trace:
    plant = Kinematic().build(problem, 0, Disturbance())
    return rollout(build(problem), plant, ticks, controller="qp", solver="daqp")


def step(state: State, v: Array) -> None:
    state.q += DT * v
    state.v[:] = v
    state.t += DT


# Two strict levels.


SECONDARY: dict[str, Task] = {
    "centring": JointCentering(name="centre", gain=5.0),
    "posture": Posture(name="arm out", goal=ARM_OUT, gain=5.0, weight=10.0),
}
each_secondary = pytest.mark.parametrize("secondary", SECONDARY.values(), ids=SECONDARY.keys())


@each_secondary
@pytest.mark.parametrize("scenario", ["point_on_point", "joint_limit_stress"])
def test_secondary_objective_costs_the_main_task_nothing_in_any_tick(
    scenario: str, secondary: Task
) -> None:
    """Along a whole run, at its limits too: J v of the task is what it is without it."""
    given = replace(load(scenario).problem(), secondary=(secondary,))
    law, alone = (QPController().build(replace(given, secondary=k)) for k in ((secondary,), ()))
    state, moved = law.start(), 0.0
    for _ in range(300):
        state.update()
        v, without = law.tick(state).v, alone.tick(state).v
        assert law.command.status is alone.command.status is Status.OPTIMAL
        np.testing.assert_allclose(state.J_task[:3] @ v, state.J_task[:3] @ without, atol=1e-9)
        np.testing.assert_allclose(state.J_rel @ v, state.J_rel @ without, atol=1e-9)
        moved = max(moved, float(np.abs(v - without).max()))
        step(state, v)
    assert moved > 1e-2


@pytest.fixture(scope="module")
def gantry() -> ClosedChain:
    """Two gantries of four slides each: joint steps add up without linearisation error."""
    model, tips = pin.Model(), []
    kinds = (pin.JointModelPX, pin.JointModelPY, pin.JointModelPZ, pin.JointModelPX)
    for side, y in (("right", -0.2), ("left", 0.2)):
        place, parent = pin.SE3(np.eye(3), np.array([0.0, y, 0.0])), 0
        for i, kind in enumerate(kinds):
            one = np.ones(1)
            parent = model.addJoint(parent, kind(), place, f"{side}_{i}", one, 5 * one, -one, one)
            place = pin.SE3.Identity()
        tips.append(f"{side}_hand")
        model.addFrame(pin.Frame(tips[-1], parent, place, pin.FrameType.OP_FRAME))
    arms = tuple(Arm(name=s, tip=t) for s, t in zip(("right", "left"), tips, strict=True))
    robot = RobotModel(name="gantry", model=model, arms=arms)
    start = np.array([0.3, -0.1, 0.2, 0.0, -0.2, 0.1, 0.0, 0.1])
    return ClosedChain.take_hold(robot, start, Rigid(), HeldObject())


@pytest.mark.parametrize("secondary", [
    JointCentering(name="centre", gain=5.0),
    Posture(name="posture", goal=[0.2, 0.2, -0.1, -0.2, 0.1, 0.1, 0.3, 0.3], gain=5.0, weight=10.0),
], ids=["centring", "posture"])  # fmt: skip
def test_whole_run_of_the_main_task_is_the_same_to_a_nanometre(
    secondary: Task, gantry: ClosedChain
) -> None:
    """Over 300 ticks of linear kinematics error and object path do not see the secondary."""
    task = PointOnPoint(name="reach", goal=(0.3, 0.1, -0.2), profile=Profile(duration=2.0))
    without = run(problem(gantry, task, limits=LIMITS))
    with_it = run(problem(gantry, task, secondary=[secondary], limits=LIMITS))
    assert np.abs(with_it.q - without.q).max() > 1e-2
    np.testing.assert_allclose(with_it.task_error, without.task_error, atol=1e-9)
    np.testing.assert_allclose(with_it.position, without.position, atol=1e-9)


@each_secondary
def test_what_a_run_differs_by_is_the_curvature_of_a_step(secondary: Task) -> None:
    """On NAO the object path differs by the square of dt only: no first-order cost."""
    given = load("point_on_point").problem()
    task = replace(given.tasks[0], gain=5.0)
    off = []
    for dt in (0.02, 0.01, 0.005):
        both = [
            run(replace(given, tasks=(task,), secondary=s, dt=dt, kappa=1 / dt), round(2 / dt))
            for s in ((secondary,), ())
        ]
        k = round(1.0 / dt)
        off.append(np.abs(both[0].position[: k + 1] - both[1].position[: k + 1]).max())
    assert off[1] < 0.6 * off[0]
    assert off[2] < 0.6 * off[1]
    assert off[2] < 1e-4


SINGULAR_DEG: dict[str, list[float]] = {
    "all stretched": [0, 0, 0, 0, 0, 0],
    "stretched, spread": [-20, 0, 0, 20, 0, 0],
}


@pytest.mark.parametrize("start", SINGULAR_DEG.values(), ids=SINGULAR_DEG.keys())
def test_secondary_costs_nothing_after_a_singular_start(start: list[float]) -> None:
    """Stretched arms lose rank; some ticks later they have it back."""
    chain = ClosedChain.take_hold(PlanarPair().build(), np.radians(start), Rigid(), HeldObject())
    x, y, z = State(chain).p_WO.tolist()
    task = PointOnPoint(name="pull back", goal=(x - 0.1, y + 0.05, z))
    posture = Posture(name="posture", goal=[0.5, -0.3, 0.4, 0.2, 0.6, -0.3])
    given = problem(chain, task, secondary=[posture], limits=LIMITS)
    law, alone = build(given), build(replace(given, secondary=()))
    state = law.start()
    for _ in range(200):
        state.update()
        v, without = law.tick(state).v, alone.tick(state).v
        np.testing.assert_allclose(state.J_rel @ v, state.J_rel @ without, atol=1e-9)
        np.testing.assert_allclose(state.J_task[:3] @ v, state.J_task[:3] @ without, atol=1e-9)
        step(state, v)


# The lexicographic optimum, written out. A level is (J, wanted, weight).

Rows = tuple[Array, Array, float]


def height(state: State, goal: Point, point: Point) -> Rows:
    """A point of the object goes to a height."""
    lever = state.R_WO @ point
    J = state.J_task[:3] - pin.skew(lever) @ state.J_task[3:]
    return J[2:], -GAIN * (state.p_WO + lever - goal)[2:], 1.0


def reach(state: State, goal: Point, weight: float = 1.0) -> Rows:
    """The object's origin goes to a point."""
    return state.J_task[:3], -GAIN * (state.p_WO - goal), weight


def centre(state: State) -> Rows:
    chain = state.chain
    middle, span = 0.5 * (chain.lower + chain.upper), chain.upper - chain.lower
    return np.eye(chain.n), -GAIN * 2 * (state.q - middle) / span**2, 1.0


def stack_of(chain: ClosedChain, point: Point = ORIGIN, **settings: Any) -> ControlProblem:
    """Three levels; the first two disagree about the height if it is the origin's."""
    return problem(
        chain,
        PointOnPoint(name="reach", goal=NEAR, profile=STEP, priority=1),
        PointOnPlane(
            name="height", point=point, normal=(0, 0, 1), through=LOW, profile=STEP, priority=0
        ),
        secondary=[JointCentering(name="centre", gain=GAIN)],
        **settings,
    )


def levels_of(state: State, point: Point = ORIGIN) -> list[Rows]:
    return [height(state, LOW, point), reach(state, NEAR), centre(state)]


def lexicographic_by_projection(state: State, levels: Sequence[Rows], damping: float) -> Array:
    """Each level by least squares in the null space of all before it; no limits."""
    A = state.J_rel
    v = np.linalg.lstsq(A, -state.loop_error / DT)[0]
    for J, wanted, weight in levels:
        N = scipy.linalg.null_space(A, rcond=1e-9)
        rows = np.vstack([np.sqrt(weight) * J @ N, np.sqrt(damping) * N])
        aims = np.concatenate([np.sqrt(weight) * (wanted - J @ v), -np.sqrt(damping) * v])
        v = v + N @ np.linalg.lstsq(rows, aims)[0]
        A = np.vstack([A, J])
    return v


def lexicographic_by_quadprog(
    state: State, levels: Sequence[Rows], damping: float, lb: Array, ub: Array
) -> Array:
    """The same with bounds: a QP a level, in coordinates z of what is still free, v = v_0 + N z.

    Bounds give way by 1e-9 a level: standing on them must not be infeasible by rounding.
    """
    A, v = state.J_rel, np.linalg.lstsq(state.J_rel, -state.loop_error / DT)[0]
    for J, wanted, weight in levels:
        lb, ub = lb - 1e-9, ub + 1e-9
        N = scipy.linalg.null_space(A, rcond=1e-9)
        P = N.T @ (weight * J.T @ J + damping * np.eye(len(v))) @ N
        q = N.T @ (weight * J.T @ (J @ v - wanted) + damping * v)
        G, h = np.vstack([N, -N]), np.concatenate([ub - v, v - lb])
        z = qpsolvers.solve_qp(P, q, G, h, solver="quadprog")
        assert z is not None
        v, A = v + N @ z, np.vstack([A, J])
    return v


def test_three_levels_are_the_chain_of_null_space_projections(
    chain: ClosedChain, closed_loop_walk: Walk
) -> None:
    given = stack_of(chain)
    for q in closed_loop_walk(chain, 6):
        state = State(chain, q)
        levels = levels_of(state)
        expected = lexicographic_by_projection(state, levels, DAMPING)
        v = answer(given, q)
        np.testing.assert_allclose(v, expected, atol=1e-7 * max(1.0, np.abs(v).max()))
        # The levels matter: the other order is another motion.
        other = lexicographic_by_projection(state, [levels[1], levels[0], levels[2]], DAMPING)
        assert np.abs(other - expected).max() > 1e-2


def test_symmetric_start_does_not_decide_what_later_levels_may_change(
    chain: ClosedChain, closed_loop_walk: Walk
) -> None:
    """Height of the front and reach leave nothing free: the secondary must not be seen."""
    given = stack_of(chain, FRONT)
    for q in closed_loop_walk(chain, 4):
        both, alone = answer(given, q), answer(replace(given, secondary=()), q)
        state = State(chain, q)
        np.testing.assert_allclose(state.J_rel @ both, state.J_rel @ alone, atol=1e-7)
        for J, _, _ in levels_of(state, FRONT)[:2]:
            np.testing.assert_allclose(J @ both, J @ alone, atol=1e-7)


@pytest.mark.parametrize("share", [0.02, 0.05, 0.2])
def test_three_levels_within_limits_are_a_chain_of_qps(
    share: float, chain: ClosedChain, closed_loop_walk: Walk
) -> None:
    """Against quadprog, level after level, with bounds written out here."""
    given = stack_of(chain, limits=(JointPosition(), JointVelocity(scale=share)))
    bounded = 0
    for q in closed_loop_walk(chain, 6):
        state = State(chain, q)
        lb = np.maximum((chain.lower - q) / DT, -share * chain.velocity)
        ub = np.minimum((chain.upper - q) / DT, share * chain.velocity)
        v = answer(given, q)
        expected = lexicographic_by_quadprog(state, levels_of(state), DAMPING, lb, ub)
        np.testing.assert_allclose(v, expected, atol=1e-6)
        bounded += int((np.minimum(v - lb, ub - v) < 1e-8).any())
    assert bounded >= (4 if share < 0.1 else 1)


def test_three_levels_at_position_limits_are_a_chain_of_qps(chain: ClosedChain) -> None:
    """Where joint_limit_stress ends: three joints rest at their position limits."""
    stress = load("joint_limit_stress").problem()
    q = run(stress).q[-1]
    chain = stress.chain
    state = State(chain, q)
    lb = np.maximum((chain.lower - q) / DT, -chain.velocity)
    ub = np.minimum((chain.upper - q) / DT, chain.velocity)
    assert (np.minimum(-lb, ub) < 1e-6).sum() >= 3
    v = answer(stack_of(chain, limits=LIMITS), q)
    expected = lexicographic_by_quadprog(state, levels_of(state), DAMPING, lb, ub)
    np.testing.assert_allclose(v, expected, atol=1e-6)


def test_no_weight_of_a_later_level_disturbs_an_earlier_one(
    chain: ClosedChain, closed_loop_walk: Walk
) -> None:
    """A feather on level 0 against a ton on level 1."""
    first = PointOnPlane(name="height", normal=(0, 0, 1), through=LOW, profile=STEP, weight=1e-2)
    later = PointOnPoint(name="reach", goal=NEAR, profile=STEP, weight=1e3, priority=3)
    for q in closed_loop_walk(chain, 5):
        J = State(chain, q).J_task
        both, alone = (
            answer(problem(chain, *t, limits=LIMITS), q) for t in ((first, later), (first,))
        )
        assert np.abs(J @ (both - alone)).max() > 1e-3
        assert J[2] @ both == pytest.approx(J[2] @ alone, abs=1e-9)


def test_priorities_count_by_their_order_alone(chain: ClosedChain) -> None:
    """Levels 0 and 1 are levels 4 and 9, in whatever order the tasks are listed."""
    plane = PointOnPlane(name="height", normal=(0, 0, 1), through=LOW, profile=STEP)
    point = PointOnPoint(name="reach", goal=NEAR, profile=STEP)
    near = answer(problem(chain, plane, replace(point, priority=1)))
    far = answer(problem(chain, replace(point, priority=9), replace(plane, priority=4)))
    np.testing.assert_allclose(near, far, atol=1e-12)


@pytest.mark.parametrize("weights", [(1.0, 1.0), (1.0, 3.0), (10.0, 0.5)])
def test_tasks_of_one_level_share_by_weight(
    weights: tuple[float, float], chain: ClosedChain, closed_loop_walk: Walk
) -> None:
    """Two goals for one point are one goal at their weighted mean."""
    tasks = [
        PointOnPoint(name=str(i), goal=goal, profile=STEP, weight=w, priority=2)
        for i, (goal, w) in enumerate(zip((NEAR, LOW), weights, strict=True))
    ]
    mean = np.average([NEAR, LOW], axis=0, weights=weights)
    one = PointOnPoint(goal=tuple(mean.tolist()), profile=STEP, weight=sum(weights))
    for q in closed_loop_walk(chain, 3):
        np.testing.assert_allclose(
            answer(problem(chain, *tasks), q), answer(problem(chain, one), q), atol=1e-7
        )


@spec
class Breaks(Task):
    """A measurement whose Jacobian is not a number after the start."""

    def rows(self, chain: ClosedChain) -> tuple[str, ...]:
        return ("height",)

    def bind(self, start: State) -> Evaluate:
        def evaluate(state: State, rows: TaskRows) -> None:
            rows.e[0], rows.J[0] = 0.0, state.J_task[2] if state.t == 0.0 else np.nan

        return evaluate


def test_later_level_that_is_not_a_number_spoils_nothing(chain: ClosedChain) -> None:
    """Level 1 breaks: level 0 goes on, nothing is raised."""
    reach = PointOnPoint(name="reach", goal=NEAR, profile=STEP)
    given = problem(
        chain, reach, Breaks(name="b", priority=1), secondary=[JointCentering(name="c")]
    )
    law = build(given)
    state = law.start()
    assert law.tick(state).status is Status.OPTIMAL
    state.t = DT
    command = law.tick(state)
    assert np.isfinite(command.v).all()
    assert command.status is Status.INACCURATE


# Hard tasks.


def test_hard_task_is_met_exactly(chain: ClosedChain, closed_loop_walk: Walk) -> None:
    """Where soft ones pull elsewhere."""
    hard = PointOnPoint(name="reach", goal=NEAR, profile=STEP, mode="hard")
    pull = PointOnPoint(name="pull", goal=LOW, profile=STEP, weight=1e4)
    for q in closed_loop_walk(chain, 5):
        J, wanted, _ = reach(State(chain, q), NEAR)
        np.testing.assert_allclose(J @ answer(problem(chain, hard, pull), q), wanted, atol=1e-9)


def test_hard_task_is_the_limit_of_a_growing_weight(chain: ClosedChain) -> None:
    """The distance falls as 1/weight."""
    settings: dict[str, Any] = {"limits": LIMITS, "secondary": [JointCentering(name="centre")]}
    point = PointOnPoint(name="reach", goal=NEAR, profile=STEP)
    pull = PointOnPoint(name="pull", goal=LOW, profile=STEP, point=FRONT)
    exact = answer(problem(chain, replace(point, mode="hard"), pull, **settings))
    off = [
        np.abs(answer(problem(chain, replace(point, weight=w), pull, **settings)) - exact).max()
        for w in (1e2, 1e3, 1e4)
    ]
    assert off[0] / off[1] == pytest.approx(10.0, rel=0.15)
    assert off[1] / off[2] == pytest.approx(10.0, rel=0.15)


def test_hard_task_follows_its_reference_over_a_run(chain: ClosedChain) -> None:
    """After each of 200 ticks the residual of the rows is rounding."""
    task = PointOnPoint(
        name="reach", goal=NEAR, profile=Profile(duration=1.0), mode="hard", gain=1 / DT
    )
    law = build(problem(chain, task, limits=LIMITS, secondary=[JointCentering(name="centre")]))
    state = law.start()
    start = state.p_WO.copy()
    for _ in range(200):
        state.update()
        share, speed = Profile(duration=1.0).at(state.t)
        way = np.array(NEAR) - start
        wanted = speed * way - (state.p_WO - start - share * way) / DT
        v = law.tick(state).v
        assert law.command.status is Status.OPTIMAL
        np.testing.assert_allclose(state.J_task[:3] @ v, wanted, atol=1e-9)
        step(state, v)


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
    law, shares = build(given), []
    for q in closed_loop_walk(chain, 8):
        state = law.start(q)
        command = law.tick(state)
        assert command.status is Status.OPTIMAL
        J, wanted, _ = reach(state, NEAR)
        np.testing.assert_allclose(J @ command.v, command.scale * wanted, atol=1e-8)
        lb = np.maximum((chain.lower - q) / DT, -share * chain.velocity)
        ub = np.minimum((chain.upper - q) / DT, share * chain.velocity)
        assert command.scale == pytest.approx(fastest_share(state, wanted, lb, ub), abs=1e-6)
        assert -1e-9 <= command.scale <= 1 + 1e-9
        shares.append(command.scale)
    assert min(shares) < 0.9 or share > 0.1


def test_scaled_task_with_room_runs_at_full_speed(chain: ClosedChain) -> None:
    task = PointOnPoint(name="reach", goal=NEAR, profile=STEP, mode="scaled")
    law = build(problem(chain, task, limits=LIMITS))
    state = law.start()
    J, wanted, _ = reach(state, NEAR)
    command = law.tick(state)
    assert command.scale == pytest.approx(1.0, abs=1e-8)
    np.testing.assert_allclose(J @ command.v, wanted, atol=1e-8)


def test_trace_records_the_share_of_each_tick(chain: ClosedChain) -> None:
    """On a way so fast that joints saturate, and then not; the path is straight."""
    task = PointOnPoint(name="reach", goal=NEAR, profile=STEP, mode="scaled", gain=20.0)
    given = problem(chain, task, limits=(JointPosition(), JointVelocity(scale=0.03)))
    trace = run(given, 100)
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


def test_scaled_task_stops_where_a_limit_lets_it_no_further() -> None:
    """The goal of joint_limit_stress: NAO stops on the straight way and stays there."""
    given = load("joint_limit_stress").problem()
    goal = np.array([0.10, -0.05, 0.04])
    task = PointOnPoint(name="reach", goal=tuple(goal.tolist()), profile=STEP, mode="scaled")
    trace = run(replace(given, tasks=(task,)))
    assert set(trace.status) <= {"OPTIMAL"}
    assert trace.scale[-1] < 1e-6
    assert np.abs(trace.v[-100:]).max() < 1e-6
    chain = given.chain
    assert np.maximum(chain.lower - trace.q, trace.q - chain.upper).max() <= 1e-9


def test_soft_task_does_not_slow_a_scaled_one(chain: ClosedChain) -> None:
    """Objectives are given up before scaled tasks, whatever their weight."""
    task = PointOnPoint(name="reach", goal=NEAR, profile=STEP, mode="scaled")
    pull = PointOnPoint(name="pull", goal=(0.15, -0.03, 0.02), profile=STEP, weight=1e4)
    law = build(problem(chain, task, pull, limits=LIMITS))
    assert law.tick(law.start()).scale == pytest.approx(1.0, abs=1e-6)


def test_copy_of_a_command_keeps_its_share(chain: ClosedChain) -> None:
    task = PointOnPoint(name="reach", goal=NEAR, profile=STEP, mode="scaled", gain=20.0)
    law = build(problem(chain, task, limits=(JointVelocity(scale=0.03),)))
    command = law.tick(law.start())
    assert command.scale < 0.5
    assert command.copy().scale == command.scale


# Rows that say the same twice.


@pytest.fixture(scope="module")
def planar() -> ClosedChain:
    q = np.radians([-20, 70, -50, 20, -70, 50])
    return ClosedChain.take_hold(PlanarPair().build(), q, Rigid(), HeldObject())


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
        problem(planar, *tasks, secondary=[JointCentering(name="centre")], limits=LIMITS), 250
    )
    assert set(trace.status) == {"OPTIMAL"}
    np.testing.assert_allclose(trace.position[-1], goal, atol=1e-5)


def test_pose_that_leaves_no_freedom_silences_the_secondary(planar: ClosedChain) -> None:
    """Three loop rows and three of the pose's six rows fix all six joints."""
    goal = PoseValue(position=(0.4, 0.02, 0.0), rpy_deg=(0, 0, 5))
    pose = Pose(name="pose", goal=goal, profile=STEP)
    posture = Posture(name="posture", goal=[0.5, -0.3, 0.4, 0.2, 0.6, -0.3])
    both, alone = (
        answer(problem(planar, pose, secondary=s, limits=LIMITS)) for s in ([posture], [])
    )
    np.testing.assert_allclose(both, alone, atol=1e-9)
