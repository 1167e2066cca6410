"""Controllers: where QP and pseudoinverse must agree, and what only the QP can hold."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from numpy.typing import NDArray

import coopqp.controllers
from coopqp.checked import spec
from coopqp.closed_chain import ClosedChain
from coopqp.closed_loop.dynamics import ClosedLoopDynamics
from coopqp.controller import Controller, ControlProblem
from coopqp.controllers import (
    DampedPseudoinverse,
    Pseudoinverse,
    PseudoinverseNullSpace,
    QPController,
)
from coopqp.controllers.qp import QPLaw
from coopqp.errors import InvalidValueError
from coopqp.limits import JointPosition, JointVelocity
from coopqp.profile import Profile
from coopqp.qp import QP
from coopqp.solver import Budget, Solution, Solve, Solver, Status
from coopqp.solvers import Daqp, Osqp, Proxqp
from coopqp.state import State
from coopqp.task import Evaluate, Task, TaskRows, TaskStack
from coopqp.tasks import JointCentering, MinimumKineticEnergy, PointOnPlane, PointOnPoint

Array = NDArray[np.float64]
Walk = Callable[[ClosedChain, int], list[Array]]

DT = 0.01
STEP = Profile(kind="step")
NEAR, UNREACHABLE = (0.19, 0.01, 0.06), (0.19, 0.1, 0.25)
BEHIND = (0.1, 0.05, -0.05)  # reachable, 13 cm away
LIMITS = (JointPosition(), JointVelocity())
CONTROLLERS: dict[str, Controller] = {
    "qp": QPController(),
    "pseudoinverse": Pseudoinverse(),
    "null space": PseudoinverseNullSpace(),
    "damped": DampedPseudoinverse(),
}
each_controller = pytest.mark.parametrize(
    "controller", CONTROLLERS.values(), ids=CONTROLLERS.keys()
)


def problem(chain: ClosedChain, *tasks: Task, **settings: Any) -> ControlProblem:
    given: dict[str, Any] = {"solver": Daqp(), "dt": DT, **settings}
    return ControlProblem(chain=chain, tasks=tasks, **given)


def command(controller: Controller, problem: ControlProblem, q: Array | None = None) -> Array:
    """One tick's joint velocity, at the chain's start or at q."""
    law = controller.build(problem)
    answer = law.tick(law.start(q))
    assert answer.status is Status.OPTIMAL
    return answer.v.copy()


@dataclass(frozen=True)
class Run:
    """Ticks of perfect joint servos, shapes (T + 1, n), (T, n), (T + 1,), (T + 1,)."""

    q: Array
    v: Array
    gap: Array
    distance: Array
    statuses: set[Status]


def run(
    controller: Controller, problem: ControlProblem, ticks: int, goal: tuple[float, float, float]
) -> Run:
    law = controller.build(problem)
    state = law.start()
    q, v, gap, distance, statuses = [], [], [], [], set()

    def note() -> None:
        state.update()
        q.append(state.q.copy())
        gap.append(state.loop_position_error)
        distance.append(float(np.linalg.norm(state.p_WO - goal)))

    for _ in range(ticks):
        note()
        answer = law.tick(state)
        v.append(answer.v.copy())
        statuses.add(answer.status)
        state.q += problem.dt * answer.v
        state.t += problem.dt
    note()
    return Run(np.array(q), np.array(v), np.array(gap), np.array(distance), statuses)


def overrun(chain: ClosedChain, q: Array) -> float:
    """How far outside the position limits [rad]; negative inside."""
    return float(np.max([chain.lower - q, q - chain.upper]))


def test_every_controller_of_the_collection_is_tested_here() -> None:
    plugins = (getattr(coopqp.controllers, name) for name in coopqp.controllers.__all__)
    velocity = {plugin.__name__ for plugin in plugins if not plugin().commands_torques}
    assert {type(c).__name__ for c in CONTROLLERS.values()} == velocity


# Where the two laws must agree.


@pytest.mark.parametrize(
    "task",
    [
        pytest.param(PointOnPoint(goal=NEAR, profile=STEP), id="point"),
        pytest.param(PointOnPlane(normal=(0, 1, 2), through=NEAR, profile=STEP), id="plane"),
    ],
)
def test_without_limits_qp_and_pseudoinverse_move_the_object_alike(
    task: Task, chain: ClosedChain
) -> None:
    """With little damping both give the least joint speed that does the task: one twist."""
    given, J = problem(chain, task), State(chain).J_task
    twist = J @ command(Pseudoinverse(), given)
    assert np.linalg.norm(twist) > 0.1
    np.testing.assert_allclose(
        J @ command(QPController(damping=1e-9, error_damping=0.0), given), twist, atol=1e-6
    )


def test_qp_tends_to_the_pseudoinverse_in_proportion_to_its_damping(chain: ClosedChain) -> None:
    given = problem(chain, PointOnPoint(goal=NEAR, profile=STEP))
    exact = command(Pseudoinverse(), given)
    off = [
        np.abs(command(QPController(damping=d, error_damping=0.0), given) - exact).max()
        for d in (1e-5, 1e-7)
    ]
    assert off[0] / off[1] == pytest.approx(100, rel=0.05)


def test_qp_with_a_strictly_secondary_objective_is_the_null_space_law(
    chain: ClosedChain, closed_loop_walk: Walk
) -> None:
    """With strict levels only the damping, far below both weights, tells them apart."""
    task = PointOnPoint(goal=NEAR, profile=STEP, weight=1e3)
    budget = Budget(accuracy=1e-2)  # what residuals prove at this weight; the answer is nearer
    given = problem(chain, task, secondary=[JointCentering()], budget=budget)
    for q in closed_loop_walk(chain, 5):
        null_space = command(PseudoinverseNullSpace(), given, q)
        assert np.abs(null_space - command(Pseudoinverse(), given, q)).max() > 1e-2
        qp = command(QPController(damping=1e-10, error_damping=0.0), given, q)
        assert np.abs(qp - null_space).max() < 1e-6 * max(1.0, np.abs(null_space).max())


def test_least_kinetic_energy_as_a_secondary_objective_is_the_inertia_weighted_inverse(
    chain: ClosedChain, closed_loop_walk: Walk
) -> None:
    """The closed form, v = A^-1 H' (H A^-1 H')^-1 b, Khatib's generalised inverse."""
    task = PointOnPoint(goal=NEAR, profile=STEP, weight=1e3)
    given = problem(
        chain, task, secondary=[MinimumKineticEnergy(weight=1e4)], budget=Budget(accuracy=1e-2)
    )
    model = ClosedLoopDynamics(chain).model
    for q in closed_loop_walk(chain, 5):
        state = State(chain, q)
        tasks = TaskStack([task], State(chain))
        tasks.update(state)
        H, b = np.vstack([tasks.J, state.J_loop]), np.concatenate([tasks.wanted, np.zeros(6)])
        A_H = np.linalg.solve(pin.crba(model, model.createData(), q), H.T)
        expected = A_H @ np.linalg.solve(H @ A_H, b)
        assert np.abs(expected - command(Pseudoinverse(), given, q)).max() > 1e-2
        qp = command(QPController(damping=1e-9, error_damping=0.0), given, q)
        np.testing.assert_allclose(qp, expected, atol=1e-4)
        # Resting is what this objective asks for by itself, so that Z = 0.
        plain = command(Pseudoinverse(), given, q)
        np.testing.assert_allclose(command(PseudoinverseNullSpace(), given, q), plain, atol=1e-9)


def test_an_objective_of_the_object_moves_it_where_the_tasks_leave_it_free(
    chain: ClosedChain,
) -> None:
    """Z = pinv(J) wanted, projected, closes in on the second point as far as the plane allows."""
    plane = PointOnPlane(normal=(0, 0, 1), through=(0.18, 0, 0.06), profile=STEP)
    given = problem(chain, plane, secondary=[PointOnPoint(goal=NEAR, profile=STEP)])
    state = State(chain)
    for law in (PseudoinverseNullSpace(), QPController(damping=1e-9, error_damping=0.0)):
        v = command(law, given)
        alone = command(Pseudoinverse(), given)
        np.testing.assert_allclose(state.J_task[2] @ v, state.J_task[2] @ alone, atol=1e-6)
        way = np.array(NEAR) - state.p_WO
        assert (state.J_task[:2] @ v) @ way[:2] > (state.J_task[:2] @ alone) @ way[:2] + 1e-4


def test_null_space_motion_does_not_disturb_task_or_loop(
    chain: ClosedChain, closed_loop_walk: Walk
) -> None:
    given = problem(
        chain, PointOnPoint(goal=NEAR, profile=STEP), secondary=[JointCentering(gain=50.0)]
    )
    for q in closed_loop_walk(chain, 5):
        with_centering = command(PseudoinverseNullSpace(), given, q)
        self_motion, state = with_centering - command(Pseudoinverse(), given, q), State(chain, q)
        assert np.linalg.norm(self_motion) > 0.1
        np.testing.assert_allclose(state.J_task[:3] @ self_motion, 0, atol=1e-12)
        np.testing.assert_allclose(state.J_rel @ self_motion, 0, atol=1e-12)


def test_symmetric_pose_has_no_self_motion_that_centering_could_use(chain: ClosedChain) -> None:
    """Holding a point leaves one antisymmetric self-motion; the pull to the middle is symmetric."""
    given = problem(chain, PointOnPoint(goal=NEAR, profile=STEP), secondary=[JointCentering()])
    pseudo, null_space = (command(k, given) for k in (Pseudoinverse(), PseudoinverseNullSpace()))
    np.testing.assert_allclose(null_space, pseudo, atol=1e-12)


def test_pseudoinverse_is_the_least_joint_speed_for_the_task(chain: ClosedChain) -> None:
    """Against numpy's least-norm solution of the task and loop rows, eq. (33)."""
    given, state = problem(chain, PointOnPoint(goal=NEAR, profile=STEP)), State(chain)
    rows = np.vstack([state.J_task[:3], state.J_rel])
    wanted = np.concatenate([-5.0 * (state.p_WO - NEAR), np.zeros(6)])
    least = np.linalg.lstsq(rows, wanted)[0]
    np.testing.assert_allclose(command(Pseudoinverse(), given), least, atol=1e-12)


def test_damped_pseudoinverse_bounds_the_speed_in_every_pose(
    chain: ClosedChain, rng: np.random.Generator
) -> None:
    """|J^#| <= 1 / (2 damping), however singular the pose."""
    given, damping = problem(chain, PointOnPoint(goal=UNREACHABLE, profile=STEP)), 0.02
    for q in [np.zeros(chain.n), *chain.sample(rng, 20)]:
        wanted = 5.0 * np.linalg.norm(State(chain, q).p_WO - UNREACHABLE)
        v = command(DampedPseudoinverse(damping=damping), given, q)
        assert np.linalg.norm(v) <= wanted / (2 * damping)


@each_controller
def test_object_nears_the_goal_at_the_tasks_gain(
    controller: Controller, chain: ClosedChain
) -> None:
    """The error shrinks by (1 - gain dt) a tick; damped least squares may lag."""
    given = problem(chain, PointOnPoint(goal=NEAR, profile=STEP, gain=5.0), kappa=1 / DT)
    distance = run(controller, given, 60, NEAR).distance
    slack = 0.25 if isinstance(controller, DampedPseudoinverse) else 0.01
    np.testing.assert_allclose(
        distance, distance[0] * 0.95 ** np.arange(61), atol=slack * distance[0]
    )


def test_joints_drift_to_the_middle_where_the_task_leaves_them_free(chain: ClosedChain) -> None:
    """Keeping one height leaves three self-motions; they lower the paper's criterion."""
    middle, span = 0.5 * (chain.lower + chain.upper), chain.upper - chain.lower
    here = tuple(State(chain).p_WO.tolist())
    task = PointOnPlane(normal=(0, 0, 1), through=here, profile=STEP, weight=1e3)
    centre = JointCentering(gain=20.0)
    given = problem(chain, task, secondary=[centre], limits=LIMITS, kappa=1 / DT)
    for controller in (QPController(), PseudoinverseNullSpace()):
        q = run(controller, given, 100, here).q
        phi = np.sum(((q - middle) / span) ** 2, axis=1)
        assert phi[-1] < 0.9 * phi[0]
        assert (np.diff(phi) < 0).all()
        assert State(chain, q[-1]).p_WO[2] == pytest.approx(here[2], abs=1e-5)


# What only the QP holds.


@pytest.fixture(scope="module")
def reach_too_far(chain: ClosedChain) -> ControlProblem:
    return problem(chain, PointOnPoint(goal=UNREACHABLE), limits=LIMITS, kappa=1 / DT)


def test_qp_stays_within_all_limits_on_the_way_to_a_goal_out_of_reach(
    reach_too_far: ControlProblem, chain: ClosedChain
) -> None:
    result = run(QPController(), reach_too_far, 200, UNREACHABLE)
    assert all(status.usable for status in result.statuses)
    assert overrun(chain, result.q) <= 1e-9
    assert (np.abs(result.v) <= chain.velocity + 1e-9).all()
    # The limits were needed, and the object has come nearer and stopped.
    assert overrun(chain, result.q) > -1e-6
    assert result.distance[-1] < 0.3 * result.distance[0]
    assert np.abs(np.diff(result.distance[-20:])).max() < 1e-3


def test_exact_answers_at_the_limits_count_as_optimal(reach_too_far: ControlProblem) -> None:
    """DAQP's answers lie within 3e-10 of the optimum of its active set in every such tick."""
    statuses = run(QPController(), reach_too_far, 200, UNREACHABLE).statuses
    assert statuses <= {Status.OPTIMAL, Status.STEP_SHORTENED}


@pytest.mark.parametrize("controller", [Pseudoinverse(), PseudoinverseNullSpace()], ids=str)
def test_classical_laws_leave_the_limits_on_the_same_way(
    controller: Controller, reach_too_far: ControlProblem, chain: ClosedChain
) -> None:
    result = run(controller, reach_too_far, 200, UNREACHABLE)
    assert overrun(chain, result.q) > 0.3
    assert (np.abs(result.v) - chain.velocity).max() > 1.0


def test_position_margin_and_velocity_share_are_kept(chain: ClosedChain) -> None:
    limits = (JointPosition(margin=0.05), JointVelocity(scale=0.1))
    given = problem(chain, PointOnPoint(goal=UNREACHABLE), limits=limits, kappa=1 / DT)
    result = run(QPController(), given, 200, UNREACHABLE)
    assert overrun(chain, result.q) <= -0.05 + 1e-9
    assert np.abs(result.v / chain.velocity).max() == pytest.approx(0.1, abs=1e-9)


@each_controller
def test_drift_correction_keeps_the_loop_closed(controller: Controller, chain: ClosedChain) -> None:
    """Within 0.1 mm, over 13 cm of object motion; the damped law pays with its loop."""
    given = problem(chain, PointOnPoint(goal=BEHIND), limits=LIMITS, kappa=1 / DT)
    gap = run(controller, given, 200, BEHIND).gap.max()
    assert gap < (1e-3 if isinstance(controller, DampedPseudoinverse) else 1e-4)


def test_without_drift_correction_the_loop_opens_further(chain: ClosedChain) -> None:
    task = PointOnPoint(goal=BEHIND)
    gaps = [
        run(QPController(), problem(chain, task, kappa=k), 200, BEHIND).gap.max()
        for k in (0.0, 0.1 / DT, 1.0 / DT)
    ]
    assert gaps[0] > 2 * gaps[1] > 4 * gaps[2]


def test_drift_of_a_step_shrinks_with_its_square(chain: ClosedChain) -> None:
    """What kappa = 1/dt leaves is one step's linearisation error."""
    task = PointOnPoint(goal=BEHIND)
    coarse, fine = (
        run(QPController(), problem(chain, task, dt=dt, kappa=1 / dt), round(2 / dt), BEHIND)
        for dt in (0.02, 0.01)
    )
    assert coarse.gap.max() / fine.gap.max() == pytest.approx(4.0, rel=0.2)


@pytest.mark.parametrize("controller", [QPController(), Pseudoinverse()], ids=str)
@pytest.mark.parametrize("share", [0.0, 0.5, 1.0])
def test_open_loop_closes_by_kappa_dt_a_tick(
    controller: Controller, share: float, chain: ClosedChain, rng: np.random.Generator
) -> None:
    """Set out from a loop that gapes by a tenth of a millimetre."""
    q = chain.q_start + 1e-4 * rng.normal(size=chain.n)
    here = tuple(State(chain, q).p_WO.tolist())
    given = problem(chain, PointOnPoint(goal=here, profile=STEP), kappa=share / DT)
    before = State(chain, q).loop_error
    after = State(chain, q + DT * command(controller, given, q)).loop_error
    assert np.abs(before).max() > 1e-5
    np.testing.assert_allclose(after, (1 - share) * before, atol=1e-6)


def test_qp_holds_the_loop_exactly_also_at_its_limits(
    reach_too_far: ControlProblem, chain: ClosedChain
) -> None:
    """J_c v = -kappa e is a hard row: tasks give way, the grasp does not."""
    result = run(QPController(), reach_too_far, 200, UNREACHABLE)
    for q, v in zip(result.q[:-1:10], result.v[::10], strict=True):
        state = State(chain, q)
        np.testing.assert_allclose(state.J_rel @ v, -state.loop_error / DT, atol=1e-7)


# What the QP states.


def test_qp_minimises_what_its_docstring_says(
    chain: ClosedChain, closed_loop_walk: Walk, rng: np.random.Generator
) -> None:
    """The QP's cost is half the sum of the weighted squares, up to a constant."""
    reach = PointOnPoint(goal=NEAR, weight=3.0, gain=4.0, profile=STEP)
    centre = JointCentering(weight=0.2, gain=7.0)
    law = QPController(damping=0.01, error_damping=0.0).build(
        problem(chain, reach, secondary=[centre])
    )
    assert isinstance(law, QPLaw)
    span = chain.upper - chain.lower

    def task_cost(state: State, v: Array) -> float:
        missed = state.J_task[:3] @ v + 4.0 * (state.p_WO - NEAR)
        return float(3.0 * missed @ missed + 0.01 * v @ v)

    def centring_cost(state: State, v: Array) -> float:
        slope = 2 * (state.q - 0.5 * (chain.lower + chain.upper)) / span**2
        pull = v + 7.0 * slope
        return float(0.2 * pull @ pull + 0.01 * v @ v)

    for q in closed_loop_walk(chain, 3):
        state = State(chain, q)
        law.tick(state)
        for level, cost in zip(law.levels, (task_cost, centring_cost), strict=True):
            qp = level.qp
            for v in rng.normal(size=(5, chain.n)):
                stated = 0.5 * v @ qp.P @ v + qp.q @ v
                assert 2 * stated == pytest.approx(cost(state, v) - cost(state, np.zeros(chain.n)))
            np.testing.assert_allclose(qp.P, qp.P.T, atol=1e-16)


def test_qp_names_its_variables_and_rows(reach_too_far: ControlProblem, chain: ClosedChain) -> None:
    law = QPController().build(reach_too_far)
    assert isinstance(law, QPLaw)
    assert law.qp.names.variables == chain.joint_names
    assert law.qp.names.equalities == chain.loops.names
    assert law.qp.names.inequalities == ()


# When things go wrong.


@spec
class GivesUp(Solver):
    """Answers with a status, and with a motion that must not be used."""

    status: Status

    def open(self, qp: QP, solution: Solution) -> Solve:
        def solve() -> None:
            solution.v[:], solution.status = 1.0, self.status

        return solve


@spec
class Lies(Solver):
    """Calls one and the same motion optimal, whatever is asked."""

    speed: float | None
    """NaN when omitted."""

    def open(self, qp: QP, solution: Solution) -> Solve:
        def solve() -> None:
            solution.v[:] = np.nan if self.speed is None else self.speed
            solution.status = Status.OPTIMAL

        return solve


@spec
class NotANumber(Task):
    """A task whose measurement is broken."""

    def rows(self, chain: ClosedChain) -> tuple[str, ...]:
        return ("height",)

    def bind(self, start: State) -> Evaluate:
        def evaluate(state: State, rows: TaskRows) -> None:
            rows.e[0], rows.J[0] = np.nan, state.J_task[2]

        return evaluate


@pytest.mark.parametrize("status", [status for status in Status if not status.usable])
def test_robot_holds_still_when_the_solver_gives_up(status: Status, chain: ClosedChain) -> None:
    law = QPController().build(
        problem(chain, PointOnPoint(goal=NEAR), solver=GivesUp(status=status))
    )
    answer = law.tick(law.start())
    assert answer.status is status
    np.testing.assert_array_equal(answer.v, np.zeros(chain.n))


@pytest.mark.parametrize(
    ("speed", "status"),
    [
        (None, Status.NOT_FINITE),
        (1.0, Status.EQUALITY_RESIDUAL),
        (100.0, Status.BOUND_RESIDUAL),
    ],
)
def test_robot_holds_still_when_the_solver_lies(
    speed: float | None, status: Status, chain: ClosedChain
) -> None:
    given = problem(chain, PointOnPoint(goal=NEAR), solver=Lies(speed=speed), limits=LIMITS)
    law = QPController().build(given)
    answer = law.tick(law.start())
    assert answer.status is status
    np.testing.assert_array_equal(answer.v, np.zeros(chain.n))


def test_standing_still_while_the_goal_is_away_is_no_optimum(chain: ClosedChain) -> None:
    given = problem(chain, PointOnPoint(goal=NEAR, profile=STEP), solver=Lies(speed=0.0))
    law = QPController().build(given)
    assert law.tick(law.start()).status is Status.INACCURATE


def test_law_stops_for_a_tick_that_fails_and_then_goes_on_as_before(chain: ClosedChain) -> None:
    law = QPController().build(problem(chain, PointOnPoint(goal=NEAR, profile=STEP), limits=LIMITS))
    good, bad = law.start(), law.start(np.full(chain.n, np.nan))
    before = law.tick(good).v.copy()
    assert not law.tick(bad).status.usable
    np.testing.assert_array_equal(law.command.v, np.zeros(chain.n))
    assert law.tick(good).status is Status.OPTIMAL
    np.testing.assert_array_equal(law.command.v, before)


WEIRD: dict[str, Callable[[ClosedChain], Array]] = {
    "not a number": lambda chain: np.full(chain.n, np.nan),
    "infinite": lambda chain: np.full(chain.n, np.inf),
    "stretched out": lambda chain: np.zeros(chain.n),
    "outside the limits": lambda chain: chain.upper + 2.0,
    "far outside": lambda chain: np.full(chain.n, 1e9),
}


@each_controller
@pytest.mark.parametrize("where", WEIRD.values(), ids=WEIRD.keys())
def test_tick_raises_nothing_and_commands_only_numbers(
    controller: Controller, where: Callable[[ClosedChain], Array], chain: ClosedChain
) -> None:
    """Warnings count as errors here, so numpy is quiet too."""
    given = problem(
        chain,
        PointOnPoint(goal=NEAR),
        secondary=[JointCentering()],
        limits=LIMITS,
        kappa=1 / DT,
    )
    law = controller.build(given)
    answer = law.tick(law.start(where(chain)))
    assert np.isfinite(answer.v).all()
    assert answer.status.usable or not answer.v.any()


@pytest.mark.parametrize("solver", [Daqp(), Osqp(max_iter=1000), Proxqp(max_iter=10)], ids=str)
def test_robot_holds_still_when_a_task_is_not_a_number(solver: Solver, chain: ClosedChain) -> None:
    law = QPController().build(problem(chain, NotANumber(), solver=solver))
    answer = law.tick(law.start())
    assert not answer.status.usable
    np.testing.assert_array_equal(answer.v, np.zeros(chain.n))


@each_controller
def test_tick_leaves_the_state_alone_and_answers_alike_twice(
    controller: Controller, chain: ClosedChain
) -> None:
    law = controller.build(problem(chain, PointOnPoint(goal=NEAR, profile=STEP), limits=LIMITS))
    state = law.start()
    arrays = (state.q, state.v, state.J_ext, state.loop_error, state.p_WO, state.R_WO)
    before = [a.copy() for a in arrays]
    first = law.tick(state).v.copy()
    np.testing.assert_array_equal(law.tick(state).v, first)
    for a, b in zip(arrays, before, strict=True):
        np.testing.assert_array_equal(a, b)


# What cannot be asked.


@pytest.mark.parametrize(
    ("settings", "named"),
    [
        ({"dt": 0.0}, "dt"),
        ({"dt": np.nan}, "dt"),
        ({"kappa": -1.0}, "kappa"),
        ({"kappa": 1.1 / DT}, "kappa"),
        (
            {"secondary": [JointCentering(name="centre", mode="hard")]},
            "'centre' is hard, secondary",
        ),
        ({"secondary": [JointCentering(name="centre", gain=101.0)]}, "centre"),
    ],
)
def test_problem_that_makes_no_sense_is_refused(
    settings: dict[str, Any], named: str, chain: ClosedChain
) -> None:
    with pytest.raises(InvalidValueError, match=named):
        problem(chain, PointOnPoint(goal=NEAR), **settings)


def test_gain_that_overshoots_in_one_tick_is_refused(chain: ClosedChain) -> None:
    with pytest.raises(InvalidValueError, match="reach"):
        problem(chain, PointOnPoint(goal=NEAR, name="reach", gain=101.0))
